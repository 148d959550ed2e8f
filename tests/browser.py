"""One headless browser for the pages of many tests: starting one takes four processor seconds.

It is told what to do over a pipe, by the debugging protocol of Chromium
(https://chromedevtools.github.io/devtools-protocol/). Each page has a context, hence storage, of its own.
"""

import contextlib
import fcntl
import json
import os
import select
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

FLAGS = (
    "--headless=new",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-extensions",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--remote-debugging-pipe",
)
SECONDS = 300
"""Of waiting for an answer, after which the browser is given up."""


class Browser:
    """A browser that opens pages one after the other.

    Parameters
    ----------
    program : str
    folder : Path
        For its profile and what it says.
    more : strings, optional
        Flags.
    """

    def __init__(self, program: str, folder: Path, more: Sequence[str] = ()) -> None:
        self._number, self._unread, self._folder = 0, b"", folder
        theirs_in, self._to = os.pipe()
        self._from, theirs_out = os.pipe()
        # The browser reads from 3 and writes to 4: numbers that these may have here.
        pair = [fcntl.fcntl(one, fcntl.F_DUPFD, 10) for one in (theirs_in, theirs_out)]
        self._log: IO[bytes] = (folder / "log").open("w+b")
        root = ["--no-sandbox"] if os.geteuid() == 0 else []
        self._process = subprocess.Popen(
            [program, *FLAGS, *more, *root, f"--user-data-dir={folder / 'profile'}", "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=self._log,
            preexec_fn=lambda: [os.dup2(one, number) for one, number in zip(pair, (3, 4), strict=True)],
            pass_fds=(3, 4),
        )
        for one in (theirs_in, theirs_out, *pair):
            os.close(one)

    def run(self, path: Path, script: str, query: str = "", size: tuple[int, int] = (800, 600)) -> Any:
        """Open the file at `path`, and return the JSON that a script makes in it, the body of a function."""
        context = self._ask("Target.createBrowserContext")["browserContextId"]
        target = self._ask("Target.createTarget", url="about:blank", browserContextId=context)["targetId"]
        page = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        width, height = size
        self._ask(
            "Emulation.setDeviceMetricsOverride", page,
            width=width, height=height, deviceScaleFactor=1, mobile=False,
        )  # fmt: skip
        self._ask("Page.navigate", page, url=f"{path.as_uri()}{query}")
        loaded = (
            "new Promise((done) => document.readyState === 'complete' ? done()"
            " : addEventListener('load', () => done()))"
        )
        found = self._ask(
            "Runtime.evaluate", page, awaitPromise=True, returnByValue=True,
            expression=f"{loaded}.then(async () => {{ {script} }})",
        )  # fmt: skip
        self._ask("Target.disposeBrowserContext", browserContextId=context)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def show(self, page: bytes, script: str, query: str = "", size: tuple[int, int] = (800, 600)) -> Any:
        """As `run`, of a page that is not in a file yet."""
        path = self._folder / "page.html"
        path.write_bytes(page)
        return self.run(path, script, query, size)

    def close(self) -> None:
        """End it, and the processes that it has started."""
        with contextlib.suppress(AssertionError, OSError, subprocess.TimeoutExpired):
            self._ask("Browser.close")
            self._process.wait(30)
        self._process.kill()
        self._process.wait()
        self._log.close()
        for one in (self._to, self._from):
            os.close(one)

    def _ask(self, method: str, session: str | None = None, **parameters: Any) -> dict[str, Any]:
        self._number += 1
        told = {"id": self._number, "method": method, "params": parameters}
        line = json.dumps(told if session is None else {**told, "sessionId": session}).encode() + b"\0"
        while line:
            line = line[os.write(self._to, line) :]
        until = time.monotonic() + SECONDS
        while True:
            answer = json.loads(self._message(until))
            if answer.get("id") == self._number:  # others tell of what happens
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]

    def _message(self, until: float) -> bytes:
        pieces = [self._unread]
        while b"\0" not in pieces[-1]:
            ready, _, _ = select.select([self._from], [], [], max(0.0, until - time.monotonic()))
            piece = os.read(self._from, 1 << 20) if ready else b""
            assert piece, f"the browser does not answer: {self._last_words()}"
            pieces.append(piece)
        message, _, self._unread = b"".join(pieces).partition(b"\0")
        return message

    def _last_words(self) -> str:
        self._log.seek(0)
        return self._log.read()[-2000:].decode("utf-8", "replace")

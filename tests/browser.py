"""A headless browser that many tests share, because its start takes four seconds of processor time.

A pipe and the debugging protocol of Chromium control it
(https://chromedevtools.github.io/devtools-protocol/). Each page has a separate context, so that pages share
no storage.
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
"""Time limit for an answer of the browser, in seconds."""


class Browser:
    """A browser that opens one page at a time.

    Parameters
    ----------
    program : str
        Path of Chromium.
    folder : Path
        Folder for its profile and its log.
    more : sequence of str, optional
        Further flags.
    """

    def __init__(self, program: str, folder: Path, more: Sequence[str] = ()) -> None:
        self._number, self._unread, self._folder = 0, b"", folder
        browser_in, self._to = os.pipe()
        self._from, browser_out = os.pipe()
        # The browser reads from file descriptor 3 and writes to 4. Duplicate our descriptors to numbers from
        # 10, so that dup2 below cannot overwrite them.
        pair = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (browser_in, browser_out)]
        self._log: IO[bytes] = (folder / "log").open("w+b")
        root = ["--no-sandbox"] if os.geteuid() == 0 else []
        self._process = subprocess.Popen(
            [program, *FLAGS, *more, *root, f"--user-data-dir={folder / 'profile'}", "about:blank"],
            stdin=subprocess.DEVNULL,
            stdout=self._log,
            stderr=self._log,
            preexec_fn=lambda: [os.dup2(end, number) for end, number in zip(pair, (3, 4), strict=True)],
            pass_fds=(3, 4),
        )
        for end in (browser_in, browser_out, *pair):
            os.close(end)

    def run(self, path: Path, script: str, query: str = "", size: tuple[int, int] = (800, 600)) -> Any:
        """Open a file, run `script` (the body of a function) in it, and return its result as JSON."""
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
        answer = self._ask(
            "Runtime.evaluate", page, awaitPromise=True, returnByValue=True,
            expression=f"{loaded}.then(async () => {{ {script} }})",
        )  # fmt: skip
        self._ask("Target.disposeBrowserContext", browserContextId=context)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def show(self, page: bytes, script: str, query: str = "", size: tuple[int, int] = (800, 600)) -> Any:
        """Do the same as `run` for a page that is given as bytes."""
        path = self._folder / "page.html"
        path.write_bytes(page)
        return self.run(path, script, query, size)

    def close(self) -> None:
        """End the browser and its child processes."""
        with contextlib.suppress(AssertionError, OSError, subprocess.TimeoutExpired):
            self._ask("Browser.close")
            self._process.wait(30)
        self._process.kill()
        self._process.wait()
        self._log.close()
        for end in (self._to, self._from):
            os.close(end)

    def _ask(self, method: str, session: str | None = None, **parameters: Any) -> dict[str, Any]:
        """Send a request and return its answer."""
        self._number += 1
        request = {"id": self._number, "method": method, "params": parameters}
        line = json.dumps(request if session is None else {**request, "sessionId": session}).encode() + b"\0"
        while line:
            line = line[os.write(self._to, line) :]
        until = time.monotonic() + SECONDS
        while True:
            answer = json.loads(self._message(until))
            if answer.get("id") == self._number:  # other messages are events
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]

    def _message(self, until: float) -> bytes:
        """Return the next message of the browser. Messages end with a NUL."""
        pieces = [self._unread]
        while b"\0" not in pieces[-1]:
            ready, _, _ = select.select([self._from], [], [], max(0.0, until - time.monotonic()))
            piece = os.read(self._from, 1 << 20) if ready else b""
            assert piece, f"the browser does not answer: {self._end_of_log()}"
            pieces.append(piece)
        message, _, self._unread = b"".join(pieces).partition(b"\0")
        return message

    def _end_of_log(self) -> str:
        self._log.seek(0)
        return self._log.read()[-2000:].decode("utf-8", "replace")

"""A headless browser that shows our page and draws what it is told, over HTTP on this machine alone.

The page asks for the next task and posts what it drew (web/remote.js); nothing but the browser itself is
needed, no driver and no debugging protocol. The address holds a secret, so that other users of the machine
can neither read the asset nor answer in the page's place. The browser is told another address, which leads to
it once: every user can see what a program was started with.
"""

import contextlib
import json
import os
import queue
import secrets
import shutil
import subprocess
import tempfile
import threading
import time
import weakref
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import IO, Any, NamedTuple

from msb.base.children import apart
from msb.errors import DeviceError, shorten

# The environment variable that names the browser to use.
VARIABLE = "MSB_BROWSER"
_NAMES = (
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
    "chrome",
    "msedge",
    "microsoft-edge",
)
_PLACES = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "C:/Program Files/Google/Chrome/Application/chrome.exe",
    "C:/Program Files (x86)/Microsoft/Edge/Application/msedge.exe",
)
_FLAGS = (
    "--headless=new",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-extensions",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--mute-audio",
    "--hide-scrollbars",
    "--window-size=800,600",
    "--blink-settings=allowScriptsToCloseWindows=true",  # the page ends its browser when its server has gone
)
_SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
_ANY = ("--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
_WEBGPU = ("--enable-unsafe-webgpu",)
_WEBGPU_SOFTWARE = (
    "--use-webgpu-adapter=swiftshader",
    # A canvas can take what WebGPU draws only if the browser's own compositor has Vulkan, too.
    "--enable-features=Vulkan",
    "--use-vulkan=swiftshader",
    # It ends what takes long, as shaders do on a busy machine.
    "--disable-gpu-watchdog",
)
# What a browser must be told of a file, to run it; by its suffix.
_KINDS = {"html": "text/html", "js": "text/javascript", "mjs": "text/javascript", "wasm": "application/wasm"}
_START_SECONDS = 120
_LONGEST_SECONDS = 600
_MAX_ANSWER = 1 << 31


class Answer(NamedTuple):
    """What the page said: a JSON object, and the bytes after it."""

    head: dict[str, Any]
    body: memoryview


def find_browser() -> str | None:
    """Return the browser to start: MSB_BROWSER, else the first of Chromium, Chrome and Edge."""
    named = os.environ.get(VARIABLE)
    if named:
        return shutil.which(named)
    on_path = next((path for path in map(shutil.which, _NAMES) if path), None)
    return on_path or next((place for place in _PLACES if Path(place).exists()), None)


def browser_name(agent: str) -> str:
    """Return "Chrome 150" or the like of a user-agent text."""
    for word in agent.split():
        name, slash, version = word.partition("/")
        if slash and name.removeprefix("Headless") in ("Chrome", "Edg", "Firefox"):
            return f"{name.removeprefix('Headless')} {version.partition('.')[0]}"
    return "a browser"


def dated(browser: str) -> str:
    """Return the program's name and date, which an update changes; asking for its version would start it."""
    path = Path(browser).resolve()
    return f"{path.name} of {time.strftime('%Y-%m-%d %H:%M', time.gmtime(path.stat().st_mtime))}"


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing, because a browser that is ended always drops its connections."""


class Page:
    """A page that draws in a browser of its own.

    `content` are the files of its server: "page.html", and those it loads; `query` stands behind the question
    mark of its address. With `software` it draws on the CPU; otherwise the browser takes a GPU if it finds
    one. A page that needs WebGPU must say so, because browsers leave it off in software.
    """

    def __init__(
        self,
        browser: str,
        content: Mapping[str, bytes],
        query: str,
        *,
        software: bool = False,
        webgpu: bool = False,
    ) -> None:
        self._tasks: queue.Queue[bytes] = queue.Queue()
        self._answers: queue.Queue[bytes] = queue.Queue()
        root, once = (f"/{secrets.token_urlsafe(16)}/" for _ in range(2))
        lead = {once: f"{root}page.html?{query}"}
        handler = _handler(root, lead, content, self._tasks, self._answers)
        self._server = _Server(("127.0.0.1", 0), handler)
        threading.Thread(target=self._server.serve_forever, daemon=True, name="page").start()
        self._folder = tempfile.TemporaryDirectory(prefix="msb-browser-", ignore_cleanup_errors=True)
        self._log: IO[bytes] = (Path(self._folder.name) / "log").open("w+b")
        address = f"http://127.0.0.1:{self._server.server_address[1]}{once}"
        command = [browser, *_FLAGS, *(_SOFTWARE if software else _ANY)]
        if webgpu:
            command += [*_WEBGPU, *(_WEBGPU_SOFTWARE if software else ())]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")  # Chromium refuses to start as root with one
        command += [f"--user-data-dir={self._folder.name}/profile", address]
        try:
            self._process = subprocess.Popen(
                command,
                # It does not start where TMPDIR cannot be written, which Python passes over.
                env={**os.environ, "TMPDIR": self._folder.name},
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
                **apart(),
            )
        except OSError as error:
            _end(None, self._server, self._tasks, self._log, self._folder)
            raise DeviceError("ENGINE_FAILED", f"{browser} does not start: {error.strerror}") from error
        # Also when nobody closes this before the program ends.
        parts = self._process, self._server, self._tasks, self._log, self._folder
        self.close = weakref.finalize(self, _end, *parts)
        try:
            self.about = self._wait(_LONGEST_SECONDS if webgpu else _START_SECONDS).head
        except BaseException:
            self.close()
            raise

    def ask(self, task: Mapping[str, Any]) -> Answer:
        """Return the page's answer to `task`."""
        self._tasks.put(json.dumps(task).encode())
        return self._wait(_LONGEST_SECONDS)

    def _wait(self, seconds: float) -> Answer:
        end = time.monotonic() + seconds
        while True:
            try:
                answer = self._answers.get(timeout=0.2)
                break
            except queue.Empty:
                pass
            if self._process.poll() is not None:
                text = f"the browser ended with status {self._process.returncode}: {self._last_words()}"
                raise DeviceError("ENGINE_FAILED", text)
            if time.monotonic() > end:
                text = f"the browser does not answer within {seconds:.0f} s: {self._last_words()}"
                raise DeviceError("ENGINE_FAILED", text)
        line, _, _ = answer.partition(b"\n")
        head: dict[str, Any] = json.loads(line)
        if "error" in head:
            raise DeviceError("ENGINE_FAILED", f"the page in the browser: {shorten(str(head['error']), 200)}")
        return Answer(head, memoryview(answer)[len(line) + 1 :])

    def _last_words(self) -> str:
        self._log.flush()
        self._log.seek(0)
        lines = [line.strip() for line in self._log.read().decode("utf-8", "replace").splitlines()]
        return shorten(next((line for line in reversed(lines) if line), "it said nothing"), 200)


def _end(
    process: subprocess.Popen[bytes] | None,
    server: ThreadingHTTPServer,
    tasks: queue.Queue[bytes],
    log: IO[bytes],
    folder: tempfile.TemporaryDirectory[str],
) -> None:
    """End the browser, and what served it."""
    if process is not None and process.poll() is None:
        process.terminate()
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    tasks.put(b"")  # whoever waits for one in a thread holds the whole content
    server.shutdown()
    server.server_close()
    log.close()
    folder.cleanup()


def _handler(
    root: str,
    lead: dict[str, str],
    content: Mapping[str, bytes],
    tasks: queue.Queue[bytes],
    answers: queue.Queue[bytes],
) -> type[BaseHTTPRequestHandler]:
    """Return what serves `content` and the tasks below `root`, and each redirect of `lead` once."""

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            if path == f"{root}next":
                self._send(tasks.get(), "application/json")
            elif (place := lead.pop(path, None)) is not None:
                self.send_response(302)
                self.send_header("Location", place)
                self.send_header("Content-Length", "0")
                self.end_headers()
            elif path.startswith(root) and path[len(root) :] in content:
                kind = _KINDS.get(path.rpartition(".")[2], "application/octet-stream")
                self._send(content[path[len(root) :]], kind)
            else:
                self.send_error(404)

        def do_POST(self) -> None:
            length = int(self.headers.get("Content-Length", 0))
            if self.path != f"{root}answer" or not 0 < length < _MAX_ANSWER:
                self.send_error(404)
                return
            answers.put(self.rfile.read(length))
            self._send(b"{}", "application/json")

        def _send(self, body: bytes, kind: str) -> None:
            with contextlib.suppress(ConnectionError):
                self.send_response(200)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            """Say nothing."""

    return Handler

"""A headless browser that shows one of our pages and executes drawing tasks.

A local HTTP server sends tasks to the page and receives answers (web/remote.js). No driver and no debugging
protocol is needed. The page's address contains a secret. Other users who do not know the secret can neither
read the asset nor send false answers. Other users of the machine can see the browser's command line. The
command line therefore shows a temporary address, which redirects to the page only once.
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

from msb.base.children import detached_options
from msb.errors import DeviceError, shorten

# The environment variable with the path of the browser to use.
VARIABLE = "MSB_BROWSER"
# If the variable is not set, msb searches PATH for these names. On macOS and Windows, msb also searches the
# usual installation paths.
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
    # This flag lets the page close its window when our server ends. Closing the window ends the browser.
    "--blink-settings=allowScriptsToCloseWindows=true",
)
# Browser flags for four cases: software WebGL, WebGL on a GPU if possible, WebGPU, and software WebGPU.
_SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
_ANY = ("--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
_WEBGPU = ("--enable-unsafe-webgpu",)
_WEBGPU_SOFTWARE = (
    "--use-webgpu-adapter=swiftshader",
    # A canvas can show WebGPU output only if the browser's compositor uses Vulkan as well.
    "--enable-features=Vulkan",
    "--use-vulkan=swiftshader",
    # The watchdog of the browser would end slow GPU work, such as shaders on a busy machine.
    "--disable-gpu-watchdog",
)
# The MIME type of each file suffix. Browsers only execute scripts with the correct MIME type.
_MIME_TYPES = {
    "html": "text/html",
    "js": "text/javascript",
    "mjs": "text/javascript",
    "wasm": "application/wasm",
}
# Seconds to wait for the page to load, and seconds to wait for an answer. The time limits are long, because
# software rendering on a busy machine is slow, and compiling WebGPU shaders there takes minutes.
_START_SECONDS = 120
_ANSWER_SECONDS = 600
# Maximum size of an answer in bytes: a frame of 89 megapixels, at 24 bytes per pixel.
_MAX_ANSWER = 1 << 31


class Answer(NamedTuple):
    """An answer of the page: a JSON object, and binary data."""

    head: dict[str, Any]
    body: memoryview


def find_browser() -> str | None:
    """Return the path in MSB_BROWSER, or the path of an installed browser, or None."""
    named = os.environ.get(VARIABLE)
    if named:
        return shutil.which(named)
    on_path = next((path for path in map(shutil.which, _NAMES) if path), None)
    return on_path or next((place for place in _PLACES if Path(place).exists()), None)


def parse_browser_name(agent: str) -> str:
    """Return the browser's name and major version, such as "Chrome 150", from a user-agent string."""
    for word in agent.split():
        name, slash, version = word.partition("/")
        if slash and name.removeprefix("Headless") in ("Chrome", "Edg", "Firefox"):
            return f"{name.removeprefix('Headless')} {version.partition('.')[0]}"
    return "a browser"


def identify_browser(browser: str) -> str:
    """Return the file name and date of a browser, which identify its version without starting it."""
    path = Path(browser).resolve()
    return f"{path.name} of {time.strftime('%Y-%m-%d %H:%M', time.gmtime(path.stat().st_mtime))}"


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore the error, because a browser always drops its connections when it ends."""


class Page:
    """A page in a headless browser. The browser is started only for this page.

    `content` has the files of the server by name: "page.html", and the files that this page loads. `query` is
    the part of the address after the question mark. With `software` the page draws on the CPU, otherwise on a
    GPU if possible. `webgpu` enables WebGPU, which browsers disable by default when they draw in software.
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
        redirects = {once: f"{root}page.html?{query}"}
        handler = _handler(root, redirects, content, self._tasks, self._answers)
        self._server = _Server(("127.0.0.1", 0), handler)
        threading.Thread(target=self._server.serve_forever, daemon=True, name="page").start()
        self._folder = tempfile.TemporaryDirectory(prefix="msb-browser-", ignore_cleanup_errors=True)
        self._log: IO[bytes] = (Path(self._folder.name) / "log").open("w+b")
        address = f"http://127.0.0.1:{self._server.server_address[1]}{once}"
        command = [browser, *_FLAGS, *(_SOFTWARE if software else _ANY)]
        if webgpu:
            command += [*_WEBGPU, *(_WEBGPU_SOFTWARE if software else ())]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")  # Chromium cannot use its sandbox when it runs as root
        command += [f"--user-data-dir={self._folder.name}/profile", address]
        try:
            self._process = subprocess.Popen(
                command,
                # The browser does not start if TMPDIR is not writable, so pass the folder that Python chose.
                env={**os.environ, "TMPDIR": self._folder.name},
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
                **detached_options(),
            )
        except OSError as error:
            _end(None, self._server, self._tasks, self._log, self._folder)
            raise DeviceError("ENGINE_FAILED", f"{browser} cannot be started: {error.strerror}") from error
        # The finalizer also runs at the end of the program if `close` was not called.
        parts = self._process, self._server, self._tasks, self._log, self._folder
        self.close = weakref.finalize(self, _end, *parts)
        try:
            self.about = self._wait(_ANSWER_SECONDS if webgpu else _START_SECONDS).head
        except BaseException:
            self.close()
            raise

    def ask(self, task: Mapping[str, Any]) -> Answer:
        """Send a task as JSON, and return the page's answer."""
        self._tasks.put(json.dumps(task).encode())
        return self._wait(_ANSWER_SECONDS)

    def _wait(self, seconds: float) -> Answer:
        """Return the next answer of the page. Raise ENGINE_FAILED if no answer arrives within `seconds`."""
        end = time.monotonic() + seconds
        while True:
            try:
                answer = self._answers.get(timeout=0.2)
                break
            except queue.Empty:
                pass
            if self._process.poll() is not None:
                text = f"the browser ended with status {self._process.returncode}: {self._last_log_line()}"
                raise DeviceError("ENGINE_FAILED", text)
            if time.monotonic() > end:
                text = f"the browser did not answer within {seconds:.0f} s: {self._last_log_line()}"
                raise DeviceError("ENGINE_FAILED", text)
        line, _, _ = answer.partition(b"\n")
        head: dict[str, Any] = json.loads(line)
        if "error" in head:
            raise DeviceError("ENGINE_FAILED", f"the page in the browser: {shorten(str(head['error']), 200)}")
        return Answer(head, memoryview(answer)[len(line) + 1 :])

    def _last_log_line(self) -> str:
        self._log.flush()
        self._log.seek(0)
        lines = [line.strip() for line in self._log.read().decode("utf-8", "replace").splitlines()]
        return shorten(
            next((line for line in reversed(lines) if line), "the log of the browser is empty"), 200
        )


def _end(
    process: subprocess.Popen[bytes] | None,
    server: ThreadingHTTPServer,
    tasks: queue.Queue[bytes],
    log: IO[bytes],
    folder: tempfile.TemporaryDirectory[str],
) -> None:
    """End the browser and its server."""
    if process is not None and process.poll() is None:
        process.terminate()
        try:
            process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    tasks.put(b"")  # stop a server thread that waits for a task
    server.shutdown()
    server.server_close()
    log.close()
    folder.cleanup()


def _handler(
    root: str,
    redirects: dict[str, str],
    content: Mapping[str, bytes],
    tasks: queue.Queue[bytes],
    answers: queue.Queue[bytes],
) -> type[BaseHTTPRequestHandler]:
    """Return a request handler that serves the files in `content` and the tasks below the path `root`.

    `redirects` maps a path to an address. Each redirect works only once.
    """

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            if path == f"{root}next":
                self._send(tasks.get(), "application/json")
            elif (address := redirects.pop(path, None)) is not None:
                self.send_response(302)
                self.send_header("Location", address)
                self.send_header("Content-Length", "0")
                self.end_headers()
            elif path.startswith(root) and path[len(root) :] in content:
                mime_type = _MIME_TYPES.get(path.rpartition(".")[2], "application/octet-stream")
                self._send(content[path[len(root) :]], mime_type)
            else:
                self.send_error(404)

        def do_POST(self) -> None:
            length = int(self.headers.get("Content-Length", 0))
            if self.path != f"{root}answer" or not 0 < length < _MAX_ANSWER:
                self.send_error(404)
                return
            answers.put(self.rfile.read(length))
            self._send(b"{}", "application/json")

        def _send(self, body: bytes, mime_type: str) -> None:
            with contextlib.suppress(ConnectionError):
                self.send_response(200)
                self.send_header("Content-Type", mime_type)
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:
            """Log no requests."""

    return Handler

"""Lines that report the progress of long work. The lines are written if standard error is not a terminal."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator

# Seconds between two progress lines, and before the first line. A run of ten hours writes about 600 lines.
INTERVAL = 60.0


class ProgressLines:
    """Writes the state of the current work once per `INTERVAL`. A caller can also request a line at once."""

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._last = time.monotonic()
        self._wrote = False
        # The state of each nested activity; the innermost state is reported.
        self._states: list[Callable[[], str]] = []
        self._lock = threading.Lock()

    def write_first(self, state: str) -> None:
        """Write `state` unless a line was written already. The log then soon shows that the command runs."""
        with self._lock:
            if not self._wrote:
                self._put(state)

    @contextlib.contextmanager
    def watch(self, state: Callable[[], str]) -> Iterator[None]:
        """Report ``state()`` during the block, even while a single step takes minutes."""
        self._states.append(state)
        ended = threading.Event()
        if len(self._states) == 1:
            threading.Thread(target=self._report, args=(ended,), daemon=True).start()
        try:
            yield
        finally:
            ended.set()
            with self._lock:
                self._states.remove(state)

    def _report(self, ended: threading.Event) -> None:
        while not ended.wait(max(0.0, self._last + INTERVAL - time.monotonic())):
            with self._lock:
                if self._states and time.monotonic() >= self._last + INTERVAL:
                    self._put(self._states[-1]())

    def _put(self, state: str) -> None:
        self._last, self._wrote = time.monotonic(), True
        self._write(state)


def format_duration(seconds: float) -> str:
    """Return a duration in seconds, minutes or hours."""
    minutes = round(seconds / 60)
    if seconds < 90:
        return f"{max(round(seconds), 1)} s"
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"

"""Progress reports of long tasks."""

from collections.abc import Callable

# A function that is called as ``progress(stage, done, total)``, with bytes. The function is called often,
# so it must be fast.
Progress = Callable[[str, int, int], None]


class Meter:
    """Count the processed bytes of one stage."""

    def __init__(self, stage: str, total: int, progress: Progress | None) -> None:
        self._stage, self._total, self._progress = stage, total, progress
        self._done = 0

    def advance(self, count: int) -> None:
        """Report `count` more processed bytes."""
        self._done += count
        if self._progress is not None:
            self._progress(self._stage, self._done, self._total)

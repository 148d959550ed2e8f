"""The progress of a stage of a run: its present tasks, and an estimate of the remaining time."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple


class Left(NamedTuple):
    """An estimate of the remaining time."""

    seconds: float
    # Whether the true time is probably longer: no task of one of the remaining kinds has ended yet, or a
    # task already takes longer than the average of its kind.
    at_least: bool


class Stage:
    """One stage of a run; `end` is called after each task.

    Workers take tasks in order, `at_once` at a time, so the present tasks are the first ones that have not
    ended. Each task has a kind, and the remaining time is estimated from finished tasks of the same kind. It
    does not include the stages `then` that follow.
    """

    def __init__(
        self,
        title: str,
        names: Sequence[str],
        kinds: Sequence[str],
        *,
        at_once: int = 1,
        then: Sequence[str] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.title, self.names, self.then = title, tuple(names), tuple(then)
        self._kinds, self._at_once, self._clock = tuple(kinds), at_once, clock
        self._waiting = list(range(len(self.names)))
        self._began: dict[int, float] = {}
        self._took: dict[str, list[float]] = {}
        self._begin()

    @property
    def done(self) -> int:
        """The number of finished tasks."""
        return len(self.names) - len(self._waiting)

    @property
    def now(self) -> tuple[str, ...]:
        """The names of the present tasks."""
        return tuple(self.names[number] for number in self._waiting[: self._at_once])

    def end(self, number: int, seconds: float | None = None, *, failed: bool = False) -> None:
        """Record the end of the task with index `number`.

        `seconds` is the duration of the task; by default, it is the time since the task became a present one.
        Durations of failed tasks are not used for estimates.
        """
        took = self._clock() - self._began.get(number, self._clock()) if seconds is None else seconds
        self._waiting.remove(number)
        if not failed:
            self._took.setdefault(self._kinds[number], []).append(took)
        self._begin()

    def left(self) -> Left | None:
        """Return the estimated time of the remaining tasks, from the average time of each kind.

        The result is None if no task of any remaining kind has ended.
        """
        # The progress bar calls this in another thread, so lists that may change are copied.
        means = {kind: statistics.fmean(took) for kind, took in list(self._took.items())}
        now = self._clock()
        known: list[float] = []
        for number in tuple(self._waiting):
            mean = means.get(self._kinds[number])
            if mean is not None and (rest := mean - (now - self._began.get(number, now))) > 0:
                known.append(rest)
        if not known:
            return None
        return Left(max(sum(known) / self._at_once, *known), len(known) < len(self._waiting))

    def _begin(self) -> None:
        """Record the start of tasks that have become present ones."""
        for number in self._waiting[: self._at_once]:
            self._began.setdefault(number, self._clock())

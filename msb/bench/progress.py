"""The progress of one stage of a run: its current tasks and its estimated remaining time."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple


class RemainingTime(NamedTuple):
    """An estimate of the remaining time."""

    seconds: float
    # Whether the estimate is a lower bound. The estimate is a lower bound if a kind of task has no finished
    # task yet. The estimate is also a lower bound if a task takes longer than the average of its kind.
    at_least: bool


class Stage:
    """One stage of a run. Call `end` after each task.

    Workers take the tasks in order, and compute `at_once` tasks at the same time. Therefore the current tasks
    are the first unfinished tasks. The remaining time is estimated from finished tasks of the same kind.
    `then` lists the following stages. The estimate does not include the following stages.
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
        self._starts: dict[int, float] = {}
        self._durations: dict[str, list[float]] = {}
        self._record_starts()

    @property
    def done(self) -> int:
        """The number of finished tasks."""
        return len(self.names) - len(self._waiting)

    @property
    def current(self) -> tuple[str, ...]:
        """The names of the current tasks."""
        return tuple(self.names[number] for number in self._waiting[: self._at_once])

    def end(self, number: int, seconds: float | None = None, *, failed: bool = False) -> None:
        """Record the end of the task with index `number`.

        `seconds` is the duration of the task. By default, the duration is measured from the start of the
        task. Durations of failed tasks are not used for estimates.
        """
        duration = self._clock() - self._starts.get(number, self._clock()) if seconds is None else seconds
        self._waiting.remove(number)
        if not failed:
            self._durations.setdefault(self._kinds[number], []).append(duration)
        self._record_starts()

    def estimate_rest(self) -> RemainingTime | None:
        """Return the estimated time of the remaining tasks. The estimate uses the average time of each kind
        of task.

        If no task of the remaining kinds has finished, the result is None.
        """
        # The progress bar calls this function in another thread, so lists that may change are copied.
        means = {kind: statistics.fmean(durations) for kind, durations in list(self._durations.items())}
        now = self._clock()
        known: list[float] = []
        for number in tuple(self._waiting):
            mean = means.get(self._kinds[number])
            if mean is not None and (rest := mean - (now - self._starts.get(number, now))) > 0:
                known.append(rest)
        if not known:
            return None
        return RemainingTime(max(sum(known) / self._at_once, *known), len(known) < len(self._waiting))

    def _record_starts(self) -> None:
        """Record the start time of tasks that have just started."""
        for number in self._waiting[: self._at_once]:
            self._starts.setdefault(number, self._clock())

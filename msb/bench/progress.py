"""How far a stage of a run is: what is being computed, and how long the rest will take."""

import statistics
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple


class Left(NamedTuple):
    """An estimate of the time that is left."""

    seconds: float
    # Whether more than this is to be expected: some of what is left is of a kind of which nothing has been
    # finished, or takes longer than what was.
    at_least: bool


class Stage:
    """One stage of a run, kept up to date while its tasks end.

    Workers take tasks in their order, `at_once` at a time, so those being computed are the first ones that
    have not ended. What a task takes says something about others of its kind only. Of the time of the stages
    that come `then` nothing is known yet.
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
        """The number of tasks that have ended."""
        return len(self.names) - len(self._waiting)

    @property
    def now(self) -> tuple[str, ...]:
        """The names of the tasks that are being computed."""
        return tuple(self.names[number] for number in self._waiting[: self._at_once])

    def end(self, number: int, seconds: float | None = None, *, failed: bool = False) -> None:
        """Note that a task, by its place among them, has ended.

        `seconds` is the time it took, where that is known better than from when it was begun and ended; how
        long a failure took says nothing about others.
        """
        took = self._clock() - self._began.get(number, self._clock()) if seconds is None else seconds
        self._waiting.remove(number)
        if not failed:
            self._took.setdefault(self._kinds[number], []).append(took)
        self._begin()

    def left(self) -> Left | None:
        """Return the time that the tasks left will take, by the mean of what tasks of their kind took.

        None is returned where nothing is known of any of them.
        """
        # A bar asks in a thread of its own, so what changes meanwhile is copied.
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
        for number in self._waiting[: self._at_once]:
            self._began.setdefault(number, self._clock())

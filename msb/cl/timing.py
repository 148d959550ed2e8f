"""Device time by stage, measured with the events of the commands."""

import contextlib
from collections.abc import Iterator
from functools import cached_property
from typing import Any

UNSTAGED = "other"
# Milliseconds per nanosecond, the unit of event times (OpenCL 1.2 specification, section 5.12).
_MS = 1e-6


class Timing:
    """The commands of a ``with`` block, grouped by stage.

    `Device.timing` creates it. Read the results of this object after its block has ended.
    """

    def __init__(self) -> None:
        self._stage = UNSTAGED
        self._events: list[tuple[str, Any]] = []

    @contextlib.contextmanager
    def as_stage(self, name: str) -> Iterator[None]:
        """Assign the commands of the ``with`` block to the stage `name`. Stages may be nested."""
        outer, self._stage = self._stage, name
        try:
            yield
        finally:
            self._stage = outer

    def note(self, event: Any) -> None:
        """Add the event of a command to the current stage."""
        self._events.append((self._stage, event))

    def milliseconds(self) -> dict[str, float]:
        """Return the milliseconds of device time that the commands of each stage took.

        Stages are in the order of their first command. The result excludes the time between commands, which
        `span` includes.
        """
        total: dict[str, float] = {}
        for (stage, _), (start, end) in zip(self._events, self._intervals, strict=True):
            total[stage] = total.get(stage, 0.0) + (end - start) * _MS
        return total

    def span(self) -> float:
        """Return the milliseconds from the start of the first command to the end of the last command."""
        return self._measure_until_end(min((start for start, _ in self._intervals), default=0))

    def since_queued(self) -> float:
        """Return the milliseconds from queueing the first command to the end of the last command.

        The result includes compilation at a first launch, and any delay before the device starts.
        """
        return self._measure_until_end(min((event.profile.queued for _, event in self._events), default=0))

    @cached_property
    def _intervals(self) -> list[tuple[int, int]]:
        """Start and end of each command in nanoseconds. The times are read from the platform once."""
        return [(event.profile.start, event.profile.end) for _, event in self._events]

    def _measure_until_end(self, start: int) -> float:
        return float(max((end for _, end in self._intervals), default=0) - start) * _MS

    def __len__(self) -> int:
        return len(self._events)

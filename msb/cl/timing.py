"""Device time by stage, from the events of the commands themselves."""

import contextlib
from collections.abc import Iterator
from functools import cached_property
from typing import Any

UNSTAGED = "other"
# Milliseconds per unit of event times, which are nanoseconds (OpenCL 1.2 specification, section 5.12).
_MS = 1e-6


class Timing:
    """The commands of one stretch of work, by stage.

    `Device.timing` makes it. Read its results after the block has ended.
    """

    def __init__(self) -> None:
        self._stage = UNSTAGED
        self._events: list[tuple[str, Any]] = []

    @contextlib.contextmanager
    def as_stage(self, name: str) -> Iterator[None]:
        """Count the commands of the block to stage `name`, whatever stage is around it."""
        outer, self._stage = self._stage, name
        try:
            yield
        finally:
            self._stage = outer

    def note(self, event: Any) -> None:
        """Add the event of a command to the current stage."""
        self._events.append((self._stage, event))

    def milliseconds(self) -> dict[str, float]:
        """Return stage -> milliseconds for which its commands ran, in order of first appearance.

        Time between commands is not included; `span` includes it.
        """
        total: dict[str, float] = {}
        for (stage, _), (start, end) in zip(self._events, self._ran, strict=True):
            total[stage] = total.get(stage, 0.0) + (end - start) * _MS
        return total

    def span(self) -> float:
        """Return the milliseconds from the start of the first command to the end of the last one."""
        return self._until_end(min((start for start, _ in self._ran), default=0))

    def since_queued(self) -> float:
        """Return the milliseconds from when the first command was queued to the end of the last one.

        They include the compilation at a first launch, and whatever the device does before it starts.
        """
        return self._until_end(min((event.profile.queued for _, event in self._events), default=0))

    @cached_property
    def _ran(self) -> list[tuple[int, int]]:
        """When each command started and ended, in nanoseconds; the platform is asked once."""
        return [(event.profile.start, event.profile.end) for _, event in self._events]

    def _until_end(self, moment: int) -> float:
        return float(max((end for _, end in self._ran), default=0) - moment) * _MS

    def __len__(self) -> int:
        return len(self._events)

"""The limits of a trial: seconds of the clock, and bytes of memory where the system has such a limit."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from numbers import Real

from msb.errors import UsageError

GIB = 1 << 30


@dataclass(frozen=True)
class Limits:
    """What one library may take for one task.

    Attributes
    ----------
    seconds : float
        Of the clock, its start and its files included.
    memory : float
        GiB of memory that the process may write to (on Linux: RLIMIT_DATA).
    """

    seconds: float = 60.0
    memory: float = 4.0

    def __post_init__(self) -> None:
        for name, value in (("seconds", self.seconds), ("memory", self.memory)):
            if not (isinstance(value, Real) and 0 < value < math.inf):
                raise UsageError("USAGE", f"the limit of {name} is {value}; it must be a positive number")

    @property
    def limits_memory(self) -> bool:
        """Whether the system holds a process to its memory limit; only Linux does it as is meant here."""
        return sys.platform == "linux"

    def to_dict(self) -> dict[str, float | None]:
        """Return them as JSON data; the memory is None where there is no such limit."""
        return {"seconds": self.seconds, "memory_gib": self.memory if self.limits_memory else None}


def limit_memory(gib: float) -> None:
    """Hold this process to `gib` GiB, where the system can.

    RLIMIT_DATA counts what may be written to. RLIMIT_AS would also count what libraries only reserve, such
    as the arenas of threads, and end them far below the memory they take.
    """
    if sys.platform == "linux":
        import resource

        most = int(gib * GIB)
        _, hard = resource.getrlimit(resource.RLIMIT_DATA)
        most = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))


def end_with_parent() -> None:
    """Let this process be killed when its parent ends in whatever way, on Linux."""
    if sys.platform == "linux":
        import ctypes
        import signal

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


_PR_SET_PDEATHSIG = 1
"""A constant of linux/prctl.h."""

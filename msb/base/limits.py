"""What a call in a child process may take: seconds of the clock, and memory where the system limits it."""

import math
import sys
from dataclasses import dataclass
from numbers import Real
from typing import Annotated

from msb.base.option import Option
from msb.errors import UsageError


@dataclass(frozen=True)
class Limits:
    """What one call in a child process may take.

    Attributes
    ----------
    seconds : float
        Of the clock, its start and its files included.
    memory : float, optional
        GiB of memory that the process may write to (on Linux: RLIMIT_DATA); None sets no limit.
    """

    seconds: Annotated[float, Option("Time limit of each process of another library.")] = 60.0
    memory: Annotated[float | None, Option("Its memory limit, in GiB.", metavar="GIB")] = 4.0

    def __post_init__(self) -> None:
        for name, value in (("seconds", self.seconds), ("memory", self.memory)):
            if value is not None and not (isinstance(value, Real) and 0 < value < math.inf):
                raise UsageError("USAGE", f"the limit of {name} is {value}; it must be a positive number")

    @property
    def limits_memory(self) -> bool:
        """Whether the system holds a process to its memory limit; only Linux does it as is meant here."""
        return sys.platform == "linux" and self.memory is not None

    def to_dict(self) -> dict[str, float | None]:
        """Return them as JSON data; the memory is None where there is no such limit."""
        return {"seconds": self.seconds, "memory_gib": self.memory if self.limits_memory else None}

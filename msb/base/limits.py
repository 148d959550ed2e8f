"""Limits of time and memory for calls in child processes."""

import math
import sys
from dataclasses import dataclass
from numbers import Real
from typing import Annotated

from msb.base.option import Option
from msb.errors import UsageError


@dataclass(frozen=True)
class Limits:
    """Time and memory limits of one call in a child process.

    Attributes
    ----------
    seconds : float
        Elapsed time, including the start of the process and the exchange of files.
    memory : float, optional
        Writable memory in GiB (RLIMIT_DATA of Linux; other systems have no limit). The value None sets no
        limit.
    """

    seconds: Annotated[float, Option("Time limit in seconds for each call of another library.")] = 60.0
    memory: Annotated[
        float | None, Option("Memory limit in GiB for each call of another library.", metavar="GIB")
    ] = 4.0

    def __post_init__(self) -> None:
        for name, value in (("seconds", self.seconds), ("memory", self.memory)):
            if value is not None and not (isinstance(value, Real) and 0 < value < math.inf):
                raise UsageError("USAGE", f"the limit of {name} is {value}; it must be a positive number")

    @property
    def limits_memory(self) -> bool:
        """Whether the memory limit applies on this system. Only Linux can limit writable memory."""
        return sys.platform == "linux" and self.memory is not None

    def to_dict(self) -> dict[str, float | None]:
        """Return the limits as JSON data. The memory is None if it is not limited."""
        return {"seconds": self.seconds, "memory_gib": self.memory if self.limits_memory else None}

"""How long a renderer is timed."""

from dataclasses import dataclass
from typing import Annotated

from msb.base.option import Option


@dataclass(frozen=True)
class Timing:
    """What ends the timing of a renderer, and what comes before it."""

    frames: Annotated[int, Option("Time at least N frames ...", ("--repeat",), metavar="N", least=1)] = 100
    seconds: Annotated[float, Option("... and at least S seconds.", metavar="S", least=0, most=86400)] = 3.0
    warm_up: Annotated[
        int | None,
        Option("Draw N frames first; default: 10, or for a second.", ("--warmup",), metavar="N", least=0),
    ] = None

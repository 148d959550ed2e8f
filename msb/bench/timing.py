"""Options for the timing of a renderer."""

from dataclasses import dataclass
from typing import Annotated

from msb.base.option import Option


@dataclass(frozen=True)
class Timing:
    """The minimum duration of a timing, and the number of warm-up frames."""

    frames: Annotated[
        int, Option("Time at least N frames; see also --seconds.", ("--repeat",), metavar="N", least=1)
    ] = 100
    seconds: Annotated[float, Option("Time for at least S seconds.", metavar="S", least=0, most=86400)] = 3.0
    warm_up: Annotated[
        int | None,
        Option(
            "Draw N frames before the timing. Default: 10 frames or one second, whichever is shorter.",
            ("--warmup",),
            metavar="N",
            least=0,
        ),
    ] = None

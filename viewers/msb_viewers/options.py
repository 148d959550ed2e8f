"""What the topology viewer shows at first. It loads nothing, so that a command's help can name it."""

from dataclasses import dataclass
from typing import Annotated, Literal

from msb.base.option import Option


@dataclass(frozen=True)
class ViewOptions:
    """What to show at first."""

    show: Annotated[
        tuple[str, ...],
        Option("Layers that are on: names, all or none. May be given again.", metavar="LAYERS"),
    ] = ()
    at: Annotated[
        str | None,
        Option(
            "Fly to the N-th element of a layer, or to vertex V, whose fans are drawn apart.",
            ("--at", "--vertex"),
            metavar="LAYER:N|V",
        ),
    ] = None
    component: Annotated[int | None, Option("Show only the N-th largest component.", least=1)] = None
    colors: Annotated[
        Literal["own", "components", "grey"] | None,
        Option("How the mesh is coloured. Default: its own colours."),
    ] = None

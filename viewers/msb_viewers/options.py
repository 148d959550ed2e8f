"""Options of the first view. This module imports no viewer, so that the command's help is fast."""

from dataclasses import dataclass
from typing import Annotated, Literal

from msb.base.option import Option


@dataclass(frozen=True)
class ViewOptions:
    """The visible layers, colours and position of the first view."""

    show: Annotated[
        tuple[str, ...],
        Option("Visible layers: names, all or none. May be given again.", metavar="LAYERS"),
    ] = ()
    at: Annotated[
        str | None,
        Option(
            "Go to the N-th element of a layer, or to vertex V, and show the fans of this vertex.",
            ("--at", "--vertex"),
            metavar="LAYER:N|V",
        ),
    ] = None
    component: Annotated[int | None, Option("Show only the N-th largest component.", least=1)] = None
    colors: Annotated[
        Literal["own", "components", "grey"] | None,
        Option("Colouring of the mesh: own (the colours of the mesh, default), by component, or grey."),
    ] = None

"""The options of a bake: of `msb.bake`, of the command and of a protocol's `[[bakes]]`.

Nothing here imports NumPy, so that the help of the command stays fast.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypedDict

from msb.base.extras import need_extra
from msb.base.option import Option, check_values, label_of
from msb.errors import UsageError, shorten
from msb.render.options import Up

Geometry = Literal["kept", "fitted", "surface"]
GeometryChoice = Literal["auto", "kept", "fitted", "surface"]
Look = Literal["texture", "vertex"]
Supervision = Literal["dedicated", "photographs"]
ShapeKind = Literal["mesh", "hulls", "box"]

FEWEST_FACES = 4  # faces of the smallest closed mesh, a tetrahedron
_MOST_SHAPE = 1 << 20  # most faces or convex parts of a collision shape


@dataclass(frozen=True)
class BakeOptions:
    """What a bake makes, from which images, and for how long; `msb.bake` describes each option.

    Raises
    ------
    UsageError
        USAGE: an option has an invalid value, or two options contradict each other.
    """

    geometry: Annotated[
        GeometryChoice,
        Option(
            "kept: the model's triangles; fitted: moved until the picture is right; auto: the better of "
            "these; surface: closed, for tools that need a solid.",
            metavar="auto|kept|fitted|surface",
        ),
    ] = "auto"
    for_solid: Annotated[
        bool,
        Option(
            "Of auto: make fitted and surface; take the surface, unless its verdict is BAD. A plain mesh "
            "that is OK is kept."
        ),
    ] = False
    color: Annotated[
        Look | None,
        Option("Default: vertex for kept, if the model has static colours there; else texture."),
    ] = None
    teacher: Annotated[
        Supervision,
        Option("What teaches: the method's own look, or the scene's photographs."),
    ] = "dedicated"
    faces: Annotated[int | None, Option("At most N fitted triangles, or about N of a surface.", least=1)] = (
        None
    )
    texture: Annotated[
        int | None,
        Option(
            "Texels along a side of the texture. Default: as many as pictures show.", least=16, most=16384
        ),
    ] = None
    lods: Annotated[
        str | Sequence[float] | None,
        Option(
            "Levels of detail beside OUT (NAME_lod1, ...): shares of its faces, as 0.5,0.25,0.1.",
            metavar="SHARES",
        ),
    ] = None
    collision: Annotated[
        str | None,
        Option("A shape to bump into beside OUT (NAME_collision).", metavar="mesh:N|hulls:N|box"),
    ] = None
    seconds: Annotated[
        float,
        Option(
            "About how long fitted triangles, and a surface of them, may move; 0: a single step.", least=0
        ),
    ] = 60.0
    seed: Annotated[int, Option("Where the search begins.", least=0)] = 0
    up: Annotated[
        Up | None, Option("Axis round which views are made where there are no cameras. Default: the asset's.")
    ] = None
    keep_best: Annotated[bool, Option("At Ctrl-C write the best so far, not nothing.")] = False
    cache: Annotated[
        Path | str | os.PathLike[str] | None,
        Option(
            "A folder that keeps the pictures that the model's own renderer draws: a second bake takes them.",
            metavar="DIR",
        ),
    ] = None

    def __post_init__(self) -> None:
        check_values(self)
        contradictions = {
            ("for_solid", "geometry"): self.for_solid and self.geometry != "auto",
            ("faces", "geometry"): self.faces is not None and self.geometry == "kept",
            ("texture", "color"): self.texture is not None and self.color == "vertex",
        }
        for (name, other), holds in contradictions.items():
            if holds:
                value = getattr(self, other)
                text = f"{label_of(self, name)} does not go with {label_of(self, other)} {value}"
                raise UsageError("USAGE", text)
        if self.collision is not None:
            parse_collision(self.collision)
        _ = self.shares

    @property
    def shares(self) -> tuple[float, ...]:
        """The levels of detail, as falling shares of the faces; none by default."""
        return () if self.lods is None else parse_shares(self.lods)

    @property
    def has_closed_surface(self) -> bool:
        """Whether a closed surface is among what is made."""
        return self.for_solid or self.geometry == "surface"


class BakeKeywords(TypedDict, total=False):
    """The fields of `BakeOptions` as keywords of `msb.bake`, for tools that check types."""

    geometry: GeometryChoice
    for_solid: bool
    color: Look | None
    teacher: Supervision
    faces: int | None
    texture: int | None
    lods: str | Sequence[float] | None
    collision: str | None
    seconds: float
    seed: int
    up: Up | None
    keep_best: bool
    cache: str | os.PathLike[str] | None


def parse_shares(lods: str | Sequence[float]) -> tuple[float, ...]:
    """Return the shares of all faces in "0.5,0.25,0.1", or in a sequence: each below 1 and the one before.

    Raises
    ------
    UsageError
        USAGE: they are not.
    """
    words = lods.split(",") if isinstance(lods, str) else lods
    try:
        shares = tuple(float(word) for word in words)
    except (TypeError, ValueError):
        shares = (0.0,)
    if any(not 0 < share < before for before, share in zip((1.0, *shares), shares, strict=False)):
        given = shorten(lods if isinstance(lods, str) else ",".join(map(str, lods)), 40)
        text = f"--lods is {given}; it must be falling shares of the faces, such as 0.5,0.25,0.1"
        raise UsageError("USAGE", text)
    return shares


def parse_collision(text: str) -> tuple[ShapeKind, int]:
    """Return the kind and the largest number of faces or parts in "mesh:1000", "hulls:16" or "box".

    Raises
    ------
    UsageError
        USAGE: the text is none of these.
    """
    name, _, number = text.partition(":")
    if text == "box":
        return "box", 1
    count = int(number) if number.isascii() and number.isdigit() and len(number) < 9 else 0
    if name == "mesh" and FEWEST_FACES <= count <= _MOST_SHAPE:
        return "mesh", count
    if name == "hulls" and 1 <= count <= _MOST_SHAPE:
        return "hulls", count
    wanted = f"mesh:N (N faces, {FEWEST_FACES} or more), hulls:N (N convex parts) or box"
    raise UsageError("USAGE", f'--collision is "{shorten(text, 40)}"; it must be {wanted}')


def need_libraries(options: BakeOptions) -> None:
    """Reject a closed surface if its libraries are not installed."""
    if options.has_closed_surface:
        need_extra("bench", "skimage", what="a closed surface")
        need_extra("trial", "fast_simplification", "xatlas", what="a closed surface")

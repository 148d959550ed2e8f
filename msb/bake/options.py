"""The options of a bake in `msb.bake`, in the command and in a protocol's `[[bakes]]`.

This module does not import NumPy, so that the help of the command stays fast.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypedDict

from msb.asset.frame import Frame, make_frame
from msb.base.extras import need_extras
from msb.base.option import Option, check_values, label_of
from msb.errors import UsageError, shorten
from msb.render.options import Floor, KnownDistance, Scale, UpDirection, ViewKind

Geometry = Literal["kept", "fitted", "surface"]
GeometryChoice = Literal["auto", "kept", "fitted", "surface"]
ColorTarget = Literal["texture", "vertex"]
Supervision = Literal["native", "photographs"]
Material = Literal["unlit", "lit"]
CollisionKind = Literal["mesh", "hulls", "box"]
Effort = Literal["draft", "normal", "fine"]

# Relative number of steps of a search for each `effort`.
_STEPS: dict[str, float] = {"draft": 0.25, "normal": 1.0, "fine": 2.5}

# Number of faces of a tetrahedron, the smallest closed mesh.
MIN_CLOSED_FACES = 4
# Largest number of faces or convex parts of a collision shape. This limit on numbers catches typing mistakes.
_MAX_COLLISION_SIZE = 1 << 20


@dataclass(frozen=True)
class BakeOptions:
    """Options for the result, the images and the time of a bake. `msb.bake` describes each option.

    Raises
    ------
    UsageError
        USAGE: an option has an invalid value, or two options contradict each other.
    """

    geometry: Annotated[
        GeometryChoice,
        Option(
            "Choose the triangles. kept: the model's triangles. fitted: triangles moved until the "
            "opaque image matches the model. surface: one closed surface. auto: the better result of "
            "kept and fitted.",
            metavar="auto|kept|fitted|surface",
        ),
    ] = "auto"
    for_solid: Annotated[
        bool,
        Option(
            "Prefer a closed surface; fall back to fitted triangles if no valid surface is found. The "
            "triangles of a closed mesh file are kept."
        ),
    ] = False
    color: Annotated[
        ColorTarget | None,
        Option(
            "Store the colours in a texture or at the vertices. Default: at the vertices for kept triangles "
            "with static vertex colours, else in a texture."
        ),
    ] = None
    supervision: Annotated[
        Supervision | None,
        Option(
            "Fit to native renderings of the model, or to the photographs of --scene. Default: native "
            "renderings. With --geometry auto, both kinds of images are tried, and photographs are "
            "chosen if they gain 0.5 dB."
        ),
    ] = None
    faces: Annotated[
        int | None,
        Option("Use at most N fitted triangles, or about N triangles for a surface.", least=1),
    ] = None
    texture: Annotated[
        int | None,
        Option(
            "Make a texture of N x N texels. By default, the PSNR in the validation views decides the size.",
            least=16,
            most=16384,
        ),
    ] = None
    material: Annotated[
        Material,
        Option(
            "Make other programs show the colours as stored (unlit), or light them (lit). Baked colours "
            "always contain the light of the photographs."
        ),
    ] = "unlit"
    lods: Annotated[
        str | Sequence[float] | None,
        Option(
            "Write levels of detail next to OUT (NAME_lod1, ...) with these shares of the faces, for example "
            "0.5,0.25,0.1.",
            metavar="SHARES",
        ),
    ] = None
    collision: Annotated[
        str | None,
        Option(
            "Write a collision shape next to OUT (NAME_collision): a mesh of N faces, N convex hulls, or a "
            "box.",
            metavar="mesh:N|hulls:N|box",
        ),
    ] = None
    thickness: Annotated[
        float,
        Option(
            "Set the thickness of the walls that make an interior a solid, as a share of the distance "
            "from the middle of the interior.",
            least=1e-3,
            most=1,
        ),
    ] = 0.05
    effort: Annotated[
        Effort,
        Option(
            "Set the number of steps of the search. draft: a quarter of the normal number of steps. "
            "fine: 2.5 times the normal number."
        ),
    ] = "normal"
    seconds: Annotated[
        float | None,
        Option(
            "Stop moving triangles after about X seconds (1.5 times as long for a surface), even if steps "
            "are left. Default: no limit.",
            least=0,
        ),
    ] = None
    truth: Annotated[
        Path | str | os.PathLike[str] | None,
        Option(
            "Compare the normals and depths of the result with this mesh of the true surface, for the report "
            "only.",
            metavar="MESH",
        ),
    ] = None
    seed: Annotated[int, Option("Set the seed of the random search.", least=0)] = 0
    up: Annotated[
        UpDirection | None,
        Option(
            "Set the direction that is up, for generated views and in mesh files: an axis such as +z, "
            "or three numbers. Default: the up direction of the asset, else of the cameras of --scene.",
            metavar="AXIS|X,Y,Z",
        ),
    ] = None
    scale: Scale = None
    known_distance: KnownDistance = None
    floor: Floor = False
    views: Annotated[
        ViewKind | None,
        Option(
            "Generate views around the model, inside it, or both. Default: the views that show more of "
            "the model."
        ),
    ] = None
    keep_best: Annotated[bool, Option("On Ctrl-C, write the best result instead of nothing.")] = False
    cache: Annotated[
        Path | str | os.PathLike[str] | None,
        Option("Cache native renderings in DIR and reuse them in later bakes.", metavar="DIR"),
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
                text = f"{label_of(self, name)} cannot be combined with {label_of(self, other)} {value}"
                raise UsageError("USAGE", text)
        if self.collision is not None:
            parse_collision(self.collision)
        _ = self.lod_shares
        _ = self.frame

    @property
    def lod_shares(self) -> tuple[float, ...]:
        """The levels of detail as falling shares of the faces. The value is empty by default."""
        return () if self.lods is None else parse_lods(self.lods)

    @property
    def frame(self) -> Frame | None:
        """The up direction and the unit from the options, without the floor.

        The value is None if neither option is given.
        """
        return make_frame(self.up, self.scale, self.known_distance)

    @property
    def step_factor(self) -> float:
        """The number of steps of each search, relative to the normal number of steps."""
        return _STEPS[self.effort]

    @property
    def makes_surface(self) -> bool:
        """Whether a closed surface is among the candidates."""
        return self.for_solid or self.geometry == "surface"


class BakeKeywords(TypedDict, total=False):
    """The fields of `BakeOptions` as keywords of `msb.bake`, for type checkers."""

    geometry: GeometryChoice
    for_solid: bool
    color: ColorTarget | None
    supervision: Supervision | None
    faces: int | None
    texture: int | None
    material: Material
    lods: str | Sequence[float] | None
    collision: str | None
    thickness: float
    effort: Effort
    seconds: float | None
    truth: str | os.PathLike[str] | None
    seed: int
    up: UpDirection | None
    scale: float | None
    known_distance: tuple[str, str, str] | None
    floor: bool
    views: ViewKind | None
    keep_best: bool
    cache: str | os.PathLike[str] | None


def parse_lods(lods: str | Sequence[float]) -> tuple[float, ...]:
    """Return the falling shares of the faces, between 0 and 1, from a text or a sequence.

    Raises
    ------
    UsageError
        USAGE: the shares are invalid.
    """
    words = lods.split(",") if isinstance(lods, str) else lods
    try:
        shares = tuple(float(word) for word in words)
    except (TypeError, ValueError):
        shares = (0.0,)
    if any(not 0 < share < before for before, share in zip((1.0, *shares), shares, strict=False)):
        given = shorten(lods if isinstance(lods, str) else ",".join(map(str, lods)), 40)
        text = f"--lods is {given}; pass falling shares of the faces, such as 0.5,0.25,0.1"
        raise UsageError("USAGE", text)
    return shares


def parse_collision(text: str) -> tuple[CollisionKind, int]:
    """Parse a text such as "mesh:1000". Return the kind, and the largest number of faces or parts.

    Raises
    ------
    UsageError
        USAGE: the text is invalid.
    """
    name, _, number = text.partition(":")
    if text == "box":
        return "box", 1
    count = int(number) if number.isascii() and number.isdigit() and len(number) < 9 else 0
    if name == "mesh" and MIN_CLOSED_FACES <= count <= _MAX_COLLISION_SIZE:
        return "mesh", count
    if name == "hulls" and 1 <= count <= _MAX_COLLISION_SIZE:
        return "hulls", count
    expected = f"mesh:N (N faces, {MIN_CLOSED_FACES} or more), hulls:N (N convex parts) or box"
    raise UsageError("USAGE", f'--collision is "{shorten(text, 40)}"; pass {expected}')


def need_libraries(options: BakeOptions) -> None:
    """Reject the geometry `surface` if libraries are missing. The error names all missing extras."""
    if options.makes_surface:
        hulls = options.collision is not None and parse_collision(options.collision)[0] == "hulls"
        trial = ["fast_simplification", "xatlas", *(["coacd"] if hulls else [])]
        need_extras({"bench": ["skimage"], "trial": trial}, what="a closed surface")

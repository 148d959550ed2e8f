"""The options of `msb.lod` and of its command. Nothing here imports NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal, TypedDict

from msb.base.option import Option, check_values
from msb.delivery.collision_kinds import parse_collision
from msb.errors import UsageError, shorten
from msb.render.options import Floor

Target = Literal["unity", "unreal", "godot", "blender", "web", "mujoco", "isaac"]
# Targets whose output is a folder.
FOLDERS = ("mujoco", "isaac")
# Targets whose file contains the collision shape, because the program finds it there by its name.
INCLUDES_COLLISION = ("unreal", "godot")
# Targets that do not read quantised attributes.
PLAIN = ("unreal", "godot", "blender")
_DEFAULT_LODS, _DEFAULT_COLLISION = "0.5,0.25,0.1", "hulls:8"


@dataclass(frozen=True)
class LodOptions:
    """The levels, the collision shape, the names and the target; `msb.lod` describes each option.

    Raises
    ------
    UsageError
        USAGE: an option has an invalid value, or two options contradict each other.
    """

    lods: Annotated[
        str | Sequence[float] | None,
        Option(
            "Make levels of detail with these shares or numbers of faces, such as 0.5,0.25 or 20000,5000. "
            "none: no levels. Default: 0.5,0.25,0.1, and none for mujoco and isaac.",
            metavar="SHARES|COUNTS",
        ),
    ] = None
    collision: Annotated[
        str | None,
        Option(
            "Make a collision shape: a mesh of N faces, N convex hulls, or a box. Default: none; hulls:8 for "
            "mujoco and isaac.",
            metavar="mesh:N|hulls:N|box",
        ),
    ] = None
    one_file: Annotated[bool, Option("Write all levels into one file instead of one file each.")] = False
    target: Annotated[
        Target | None,
        Option(
            "Write what this program opens without import settings. mujoco: a folder with an MJCF model. "
            "isaac: a folder with a USD asset for Isaac Sim. All others: a .glb.",
            ("--for",),
        ),
    ] = None
    scale: Annotated[
        float | None, Option("Length of the unit of the asset in metres.", metavar="X", least=1e-9)
    ] = None
    floor: Floor = False
    center: Annotated[
        bool, Option("Put the middle of the bounding box at the origin; with --floor only horizontally.")
    ] = False
    density: Annotated[
        float | None,
        Option(
            "Density in kg per cubic metre, for mujoco and isaac. Default: 1000.", metavar="X", least=1e-6
        ),
    ] = None
    mass: Annotated[float | None, Option("Mass in kg, in place of --density.", metavar="X", least=1e-9)] = (
        None
    )
    label: Annotated[
        str | None, Option("Semantic label, for isaac. Default: the name of the output.", metavar="NAME")
    ] = None

    def __post_init__(self) -> None:
        check_values(self)
        if self.collision is not None:
            parse_collision(self.collision)
        _ = self.wanted
        if self.is_folder and self.one_file:
            raise UsageError("USAGE", f"--one-file cannot be combined with --for {self.target}")
        for name in ("density", "mass", "label"):
            if getattr(self, name) is not None and not self.is_folder:
                raise UsageError("USAGE", f"--{name} needs --for mujoco or --for isaac")
        if self.density is not None and self.mass is not None:
            raise UsageError("USAGE", "--density and --mass cannot be combined")
        if self.label is not None and self.target != "isaac":
            raise UsageError("USAGE", "--label needs --for isaac")

    @property
    def is_folder(self) -> bool:
        """Whether the output is a folder."""
        return self.target in FOLDERS

    @property
    def wanted(self) -> tuple[float, ...]:
        """The levels: falling shares below 1, or falling numbers of faces from 1 on."""
        lods = ("none" if self.is_folder else _DEFAULT_LODS) if self.lods is None else self.lods
        return () if lods == "none" else parse_levels(lods)

    @property
    def shape(self) -> str | None:
        """The collision shape."""
        return self.collision or (_DEFAULT_COLLISION if self.is_folder else None)


class LodKeywords(TypedDict, total=False):
    """The fields of `LodOptions` as keywords of `msb.lod`, for type checkers."""

    lods: str | Sequence[float] | None
    collision: str | None
    one_file: bool
    target: Target | None
    scale: float | None
    floor: bool
    center: bool
    density: float | None
    mass: float | None
    label: str | None


def parse_levels(lods: str | Sequence[float]) -> tuple[float, ...]:
    """Return the levels in "0.5,0.25" or "20000,5000", or in a sequence; they fall.

    Raises
    ------
    UsageError
        USAGE: they are invalid.
    """
    words = lods.split(",") if isinstance(lods, str) else lods
    try:
        levels = tuple(float(word) for word in words)
    except (TypeError, ValueError):
        levels = (0.0,)
    are_shares = all(0 < level < 1 for level in levels)
    are_counts = all(level >= 1 and level == round(level) and level < 2**31 for level in levels)
    if not (are_shares or are_counts) or any(b >= a for a, b in pairwise(levels)):
        given = shorten(lods if isinstance(lods, str) else ",".join(map(str, lods)), 40)
        text = f"--lods is {given}; it must be falling shares such as 0.5,0.25, or falling numbers of faces"
        raise UsageError("USAGE", text)
    return levels

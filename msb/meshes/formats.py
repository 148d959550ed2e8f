"""The description of a mesh format, and the table of all formats."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO, Literal

if TYPE_CHECKING:
    from msb.meshes.mesh import Mesh
    from msb.meshes.source import Source


Color = Literal["linear", "srgb"]
Picture = Literal["png", "jpeg", "webp"]


@dataclass(frozen=True)
class Web:
    """How much of a mesh is kept in a file for the web, whose arrays are compressed.

    Attributes
    ----------
    quarters : int
        Quarters of a bit of positions: they lie on a grid of about 2 ** (quarters / 4) steps along the
        longest side of the mesh; 88 is about float32.
    levels : float, optional
        Colours have a byte of linear light, and a second one where the first is off by more levels of 8-bit
        sRGB; None: nowhere, which is off by six where it is dark.
    by_distance : bool
        Of a mesh whose faces share no vertex: the step is finer for faces near its middle and coarser for
        those far from it, instead of one for all.
    """

    quarters: int = 64
    levels: float | None = 1.0
    by_distance: bool = False


@dataclass(frozen=True)
class Style:
    """What may be chosen of a mesh file that is written.

    Attributes
    ----------
    color : {"linear", "srgb"}, optional
        Whether vertex colours are linear light or sRGB; None: as the format has them.
    texture : {"png", "jpeg", "webp"}
        What the textures are packed as.
    web : Web, optional
        Of a GLB: compressed for the web, with rows in another order; None: as every program opens it.
    stem : str, optional
        What the files beside it are called, without their endings; None: there are none.
    extras : mapping, optional
        Of a GLB: JSON data about the mesh that its `asset` carries.
    collision : tuple of Mesh
        Of USD: what simulators let collide in its place.
    is_convex : bool
        Whether each of those is convex.
    """

    color: Color | None = None
    texture: Picture = "png"
    web: Web | None = None
    stem: str | None = None
    extras: Mapping[str, Any] | None = None
    collision: tuple[Mesh, ...] = ()
    is_convex: bool = False


@dataclass(frozen=True)
class Format:
    """One mesh format. Its module declares it, and a line of `msb.meshes.files` registers it.

    Attributes
    ----------
    title : str
        The name that messages print, such as "PLY".
    suffixes : tuple of str
        The suffixes in lower case, the usual one first, such as (".ply",).
    read : callable
        A function from `Source` to `Mesh`; whatever the bytes are, it returns or raises `MeshFileError`.
    write : callable, optional
        A function that writes a mesh, whose coordinates and indices are checked, to a binary file; None for a
        format that is only read.
    begins : compiled pattern of bytes, optional
        How every file of the format begins, if no file of another format begins so. A file with a wrong
        suffix is then recognised by it.
    beside : callable, optional
        A function that returns the files which a mesh needs beside its own, name -> content; they are called
        after the `stem` of the style.
    keeps : tuple of {"vertex_colors", "face_colors", "vertex_uvs", "textures", "collision"}
        What the format can hold of a mesh beside its surface.
    is_soup : bool
        True if the format writes the vertices of every face anew, so that no two faces share one.
    is_single : bool
        True if the format holds coordinates as float32, whatever the mesh has.
    is_linear : bool
        True if the format says that vertex colours are linear light.
    up : str, optional
        The axis that the format says is up, such as "+y".
    """

    title: str
    suffixes: tuple[str, ...]
    read: Callable[[Source], Mesh]
    write: Callable[[Mesh, BinaryIO, Style], None] | None = None
    begins: re.Pattern[bytes] | None = None
    beside: Callable[[Mesh, Style], dict[str, bytes]] | None = None
    keeps: tuple[Literal["vertex_colors", "face_colors", "vertex_uvs", "textures", "collision"], ...] = ()
    is_soup: bool = False
    is_single: bool = False
    is_linear: bool = False
    up: str | None = None


# Suffix, in lower case -> format. `msb.meshes.files` fills it.
FORMATS: dict[str, Format] = {}


def written_suffixes() -> list[str]:
    """Return the suffixes of the formats that can be written."""
    return [suffix for suffix, each in FORMATS.items() if each.write is not None]

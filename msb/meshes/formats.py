"""The declaration of a mesh format, and the table of all formats."""

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
    """The precision of a compressed GLB for the web.

    Attributes
    ----------
    quarters : int
        Position precision in quarters of a bit: the grid has about 2 ** (quarters / 4) steps along the
        longest side of the bounding box. 88 is about the precision of float32.
    levels : float, optional
        Largest colour error in levels of 8-bit sRGB. Colours are stored as 16-bit linear light, rounded to as
        few significant bits as this error allows. None: 8-bit linear light, with errors of up to 6 levels in
        dark colours.
    by_distance : bool
        For triangle soups: use a finer grid for faces near the centre of the scene and a coarser grid far
        away, instead of one grid.
    """

    quarters: int = 64
    levels: float | None = 1.0
    by_distance: bool = False


@dataclass(frozen=True)
class Style:
    """Options for writing a mesh file.

    Attributes
    ----------
    color : {"linear", "srgb"}, optional
        The colour space of vertex colours; None: the format's default.
    texture : {"png", "jpeg", "webp"}
        The image format of textures.
    web : Web, optional
        For GLB: the precision of a compressed file, whose rows are reordered. None: an uncompressed file,
        which every program can read.
    stem : str, optional
        The file name, without suffix, of companion files (materials, images); None: write no companions.
    extras : mapping, optional
        For GLB: JSON data for the file's `asset.extras`.
    collision : tuple of Mesh
        For USD: collision shapes.
    is_convex : bool
        Whether each collision shape is convex.
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
    """One mesh format. Its module declares it, and one line in `msb.meshes.files` registers it.

    Attributes
    ----------
    title : str
        The name in messages, such as "PLY".
    suffixes : tuple of str
        The suffixes in lower case, the usual one first, such as (".ply",).
    read : callable
        A function from `Source` to `Mesh`. For invalid bytes it raises `MeshFileError` and nothing else.
    write : callable, optional
        A function that writes a mesh with valid coordinates and indices to a binary stream; None for a
        read-only format.
    begins : compiled pattern of bytes, optional
        The signature at the start of every file of this format and of no other. It identifies files with a
        wrong suffix.
    companions : callable, optional
        A function that returns the companion files of a mesh (materials, images) as name -> content; their
        names begin with the `stem` of the style.
    keeps : tuple of {"vertex_colors", "face_colors", "vertex_uvs", "textures", "collision"}
        The optional parts of a mesh that the format can store.
    list_stored, list_lost : callable, optional
        Functions that name the colours and textures that a file stores of a textured mesh, and the parts that
        it loses, if this depends on more than `keeps`.
    is_soup : bool
        True if the format stores three vertices per face, so that faces never share vertices.
    is_single : bool
        True if the format always stores coordinates as float32.
    is_linear : bool
        True if the format defines vertex colours as linear light.
    up : str, optional
        The axis that the format defines as up, such as "+y".
    """

    title: str
    suffixes: tuple[str, ...]
    read: Callable[[Source], Mesh]
    write: Callable[[Mesh, BinaryIO, Style], None] | None = None
    begins: re.Pattern[bytes] | None = None
    companions: Callable[[Mesh, Style], dict[str, bytes]] | None = None
    keeps: tuple[Literal["vertex_colors", "face_colors", "vertex_uvs", "textures", "collision"], ...] = ()
    list_stored: Callable[[Mesh], list[str]] | None = None
    list_lost: Callable[[Mesh], list[str]] | None = None
    is_soup: bool = False
    is_single: bool = False
    is_linear: bool = False
    up: str | None = None


# Suffix, in lower case -> format. `msb.meshes.files` fills it.
FORMATS: dict[str, Format] = {}


def list_written_suffixes() -> list[str]:
    """Return the suffixes of the formats that can be written."""
    return [suffix for suffix, form in FORMATS.items() if form.write is not None]

"""What a mesh format is, and the table of all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, BinaryIO, Literal

if TYPE_CHECKING:
    import re
    from collections.abc import Callable

    from msb.meshes.mesh import Mesh
    from msb.meshes.source import Source


@dataclass(frozen=True)
class Format:
    """One format; its module declares it, a line of `msb.meshes.files` registers it.

    Attributes
    ----------
    title : str
        As messages print it: "PLY".
    suffixes : tuple of str
        In lower case, the usual one first: (".ply",).
    read : callable
        From `Source` to `Mesh`; whatever the bytes are, it returns or raises `MeshFileError`.
    write : callable, optional
        Writes a mesh, whose coordinates and indices are checked, to a binary file; None for a format that is
        only read.
    begins : compiled pattern of bytes, optional
        How every file of the format begins, if no file of another does: then a file of another suffix is
        known by it.
    keeps : tuple of {"vertex_colors", "face_colors"}
        Which colours it writes.
    """

    title: str
    suffixes: tuple[str, ...]
    read: Callable[[Source], Mesh]
    write: Callable[[Mesh, BinaryIO], None] | None = None
    begins: re.Pattern[bytes] | None = None
    keeps: tuple[Literal["vertex_colors", "face_colors"], ...] = ()


FORMATS: dict[str, Format] = {}
"""Suffix, in lower case -> format. `msb.meshes.files` fills it."""


def written_suffixes() -> list[str]:
    """Return the suffixes of the formats that can be written."""
    return [suffix for suffix, each in FORMATS.items() if each.write is not None]

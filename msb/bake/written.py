"""The files of a plain asset: several formats at once, all whole or none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

from msb.asset import ASSET_SUFFIX
from msb.asset.writer import write_packed
from msb.bake.solid import parts as parts_of
from msb.base.atomic import new_files
from msb.delivery.saving import output_suffix
from msb.errors import UsageError
from msb.meshes import Mesh, write_mesh
from msb.meshes.assets import as_held, mesh_from_asset, with_faces
from msb.meshes.files import beside
from msb.meshes.formats import FORMATS, Style

if TYPE_CHECKING:
    from msb.asset import Asset

    Write = Callable[[BinaryIO], object]

_LEAST_TEXTURED = Mesh(
    np.zeros((3, 3), np.float32),
    np.arange(3)[None],
    vertex_uvs=np.zeros((3, 2), np.float32),
    textures=(np.zeros((1, 1, 3), np.uint8),),
)


class Part(NamedTuple):
    """One of the assets of a bake: what stands behind the name of its file, and data that GLBs carry.

    A stage of USD also has the shape that simulators let collide in its place, and whether its parts are
    convex.
    """

    ending: str
    asset: Asset
    extras: Mapping[str, Any]
    shape: Asset | None = None
    is_convex: bool = False


def endings(levels: int, *, has_collision: bool) -> list[str]:
    """Return what stands behind the names of the assets of a bake, in the order of its parts: the main one,
    its levels of detail, its collision shape."""
    found = ["", *(f"_lod{number}" for number in range(1, levels + 1))]
    return [*found, "_collision"] if has_collision else found


def place_of(path: Path, ending: str) -> Path:
    """Return where the part with this ending is written, if the main asset is at `path`."""
    return path.with_name(f"{path.stem}{ending}{path.suffix}")


def places(paths: Sequence[Path], endings: Sequence[str] = ("",)) -> list[Path]:
    """Return all files that `write_all` may write to `paths`: also those beside them that a texture needs."""
    found = []
    for path in paths:
        suffix = output_suffix(path)
        for ending in endings:
            place = place_of(path, ending)
            others = beside(_LEAST_TEXTURED, place, Style()) if suffix != ASSET_SUFFIX else {}
            found += [place, *others]
    if len(set(found)) < len(found):
        twice = next(path for path in found if found.count(path) > 1)
        raise UsageError("USAGE", "two outputs would be written to it; give each its own", file=twice)
    return found


def write_all(
    parts: Sequence[Part], paths: Sequence[Path], overwrite: bool = False
) -> list[tuple[Path, int]]:
    """Write assets to all paths, each in the format of its suffix, all or none.

    Returns the file of each at the first path and its bytes, with those of files that it needs beside it.
    """
    if not paths:
        raise UsageError("USAGE", "no output is named")
    places(paths, [part.ending for part in parts])
    writes: list[tuple[Path, Write]] = []
    main: list[tuple[Path, int]] = []
    for path in paths:
        for part in parts:
            place = place_of(path, part.ending)
            writes += _writes(part, place)
            if path == paths[0]:
                main.append((place, len(writes)))
    with new_files([path for path, _ in writes], overwrite=overwrite) as files:
        for file, (_, write) in zip(files, writes, strict=True):
            write(file)
        sizes = [file.seek(0, 2) for file in files]
    starts = [0, *(end for _, end in main)]
    return [(place, sum(sizes[start:end])) for start, (place, end) in zip(starts, main, strict=False)]


def _writes(part: Part, place: Path) -> list[tuple[Path, Write]]:
    """Return the files of one asset, and what writes each."""
    suffix = output_suffix(place)
    if suffix == ASSET_SUFFIX:
        return [(place, partial(write_packed, part.asset))]
    held = as_held(mesh_from_asset(part.asset), suffix)
    shape = part.shape if "collision" in FORMATS[suffix].keeps else None
    style = Style(
        stem=place.stem,
        extras={"bake": dict(part.extras)} if part.extras else {},
        collision=() if shape is None else _pieces(as_held(mesh_from_asset(shape), suffix)),
        is_convex=part.is_convex,
    )
    others = beside(held, place, style)
    found: list[tuple[Path, Write]] = [(other, partial(_put, content)) for other, content in others.items()]
    return [*found, (place, partial(write_mesh, held, suffix=suffix, style=style))]


def _pieces(mesh: Mesh) -> tuple[Mesh, ...]:
    """Return the parts of a mesh that share no vertex."""
    label = parts_of(mesh.vertices, mesh.faces)
    return tuple(with_faces(mesh, label == number) for number in np.unique(label))


def _put(content: bytes, file: BinaryIO) -> None:
    file.write(content)

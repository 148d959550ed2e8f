"""The files of a plain asset: several formats at once, all whole or none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from msb.asset import ASSET_SUFFIX
from msb.asset.writer import write_packed
from msb.base.atomic import new_files
from msb.delivery.saving import output_suffix
from msb.errors import UsageError
from msb.meshes import Mesh, write_mesh
from msb.meshes.assets import as_held, mesh_from_asset
from msb.meshes.files import beside
from msb.meshes.formats import Style

if TYPE_CHECKING:
    from msb.asset import Asset

    Write = Callable[[BinaryIO], object]

_LEAST_TEXTURED = Mesh(
    np.zeros((3, 3), np.float32),
    np.arange(3)[None],
    vertex_uvs=np.zeros((3, 2), np.float32),
    textures=(np.zeros((1, 1, 3), np.uint8),),
)


def places(paths: Sequence[Path]) -> list[Path]:
    """Return all files that `write_all` may write to `paths`: also those beside them that a texture needs."""
    found = []
    for path in paths:
        suffix = output_suffix(path)
        others = beside(_LEAST_TEXTURED, path, Style()) if suffix != ASSET_SUFFIX else {}
        found += [path, *others]
    if len(set(found)) < len(found):
        twice = next(path for path in found if found.count(path) > 1)
        raise UsageError("USAGE", "two outputs would be written to it; give each its own", file=twice)
    return found


def write_all(asset: Asset, paths: Sequence[Path], extras: Mapping[str, Any], overwrite: bool = False) -> int:
    """Write an asset to all paths, each in the format of its suffix; return the bytes of the first one.

    Those include the files that it needs beside it. The JSON data `extras` are carried by GLBs.
    """
    if not paths:
        raise UsageError("USAGE", "no output is named")
    places(paths)
    mesh = mesh_from_asset(asset)
    parts: list[tuple[Path, Write]] = []
    first = 0
    for path in paths:
        suffix = output_suffix(path)
        if suffix == ASSET_SUFFIX:
            parts.append((path, partial(write_packed, asset)))
        else:
            held, style = as_held(mesh, suffix), Style(stem=path.stem, extras={"bake": dict(extras)})
            others = beside(held, path, style)
            parts += [(other, partial(_put, content)) for other, content in others.items()]
            parts.append((path, partial(write_mesh, held, suffix=suffix, style=style)))
        first = first or len(parts)
    with new_files([path for path, _ in parts], overwrite=overwrite) as files:
        for file, (_, write) in zip(files, parts, strict=True):
            write(file)
        return sum(file.seek(0, 2) for file in files[:first])


def _put(content: bytes, file: BinaryIO) -> None:
    file.write(content)

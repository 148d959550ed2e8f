"""The files of a bake in several formats. Either all files are written, or none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple

import numpy as np

from msb.asset import ASSET_SUFFIX
from msb.asset.writer import write_packed
from msb.bake.closed_mesh import label_parts
from msb.base.atomic import new_files
from msb.base.soup import is_soup
from msb.delivery.saving import output_suffix
from msb.errors import UsageError
from msb.meshes import Mesh, write_mesh
from msb.meshes.assets import fit_to_format, mesh_from_asset, with_faces
from msb.meshes.files import companion_files
from msb.meshes.formats import FORMATS, Style
from msb.meshes.normals import with_smooth_normals

if TYPE_CHECKING:
    from msb.asset import Asset

    WriteFile = Callable[[BinaryIO], object]

# The smallest textured mesh needs the same additional files as any textured mesh.
_SMALLEST_TEXTURED = Mesh(
    np.zeros((3, 3), np.float32),
    np.arange(3)[None],
    vertex_uvs=np.zeros((3, 2), np.float32),
    textures=(np.zeros((2, 2, 3), np.uint8),),
)


class OutputAsset(NamedTuple):
    """An asset of a bake, the ending of its file name, and the `extras` in its GLB.

    The field `collision` is the collision shape that a USD stage includes. The field `is_convex` states
    whether the parts of the collision shape are convex. With `is_lit`, other programs light the materials.
    """

    ending: str
    asset: Asset
    extras: Mapping[str, Any]
    collision: Asset | None = None
    is_convex: bool = False
    is_lit: bool = False


def list_endings(levels: int, *, has_collision: bool) -> list[str]:
    """Return the endings of file names: of the main asset, levels of detail and collision shape."""
    endings = ["", *(f"_lod{number}" for number in range(1, levels + 1))]
    return [*endings, "_collision"] if has_collision else endings


def add_ending(path: Path, ending: str) -> Path:
    """Return the path of the asset with this ending next to the main asset at `path`."""
    return path.with_name(f"{path.stem}{ending}{path.suffix}")


def list_output_files(paths: Sequence[Path], endings: Sequence[str] = ("",)) -> list[Path]:
    """Return all files that `write_assets` may write for `paths`, including files that a texture needs.

    Raises
    ------
    UsageError
        USAGE: two outputs would write the same file.
    """
    written: dict[Path, Path] = {}  # For each file, the output path that needs this file.
    for path in paths:
        suffix = output_suffix(path)
        for ending in endings:
            place = add_ending(path, ending)
            others = companion_files(_SMALLEST_TEXTURED, place, Style()) if suffix != ASSET_SUFFIX else {}
            for file in (place, *others):
                if file in written:
                    both = f"--out {written[file]} and --out {path}"
                    raise UsageError(
                        "USAGE", f"{both} would both write this file; pass different names", file=file
                    )
                written[file] = path
    return list(written)


def write_assets(
    assets: Sequence[OutputAsset], paths: Sequence[Path], overwrite: bool = False
) -> list[tuple[Path, int]]:
    """Write assets to all paths in the formats of their suffixes. If one file fails, write no file.

    Return the first file of each asset, and its size in bytes. The size includes the additional files.
    """
    if not paths:
        raise UsageError("USAGE", "missing output; pass a path to write to")
    list_output_files(paths, [asset.ending for asset in assets])
    writes: list[tuple[Path, WriteFile]] = []
    # For each asset, store the path of its file in the first output, and the number of files so far.
    main: list[tuple[Path, int]] = []
    for path in paths:
        for asset in assets:
            place = add_ending(path, asset.ending)
            writes += _plan_writes(asset, place)
            if path == paths[0]:
                main.append((place, len(writes)))
    with new_files([path for path, _ in writes], overwrite=overwrite) as files:
        for file, (_, write) in zip(files, writes, strict=True):
            write(file)
        sizes = [file.seek(0, 2) for file in files]
    starts = [0, *(end for _, end in main)]
    return [(place, sum(sizes[start:end])) for start, (place, end) in zip(starts, main, strict=False)]


def _plan_writes(output: OutputAsset, place: Path) -> list[tuple[Path, WriteFile]]:
    """Return the files of one asset, and a function that writes each file."""
    suffix = output_suffix(place)
    if suffix == ASSET_SUFFIX:
        return [(place, partial(write_packed, output.asset))]
    mesh = fit_to_format(mesh_from_asset(output.asset), suffix)
    # A surface has smooth normals. The faces of a soup are flat and need no normals.
    if "normals" in FORMATS[suffix].keeps and not is_soup(mesh.faces):
        mesh = with_smooth_normals(mesh)
    shape = output.collision if "collision" in FORMATS[suffix].keeps else None
    style = Style(
        stem=place.stem,
        extras={"bake": dict(output.extras)} if output.extras else {},
        collision=() if shape is None else _split_parts(fit_to_format(mesh_from_asset(shape), suffix)),
        is_convex=output.is_convex,
        is_lit=output.is_lit,
    )
    others = companion_files(mesh, place, style)
    writes: list[tuple[Path, WriteFile]] = [
        (other, partial(_write_bytes, content)) for other, content in others.items()
    ]
    return [*writes, (place, partial(write_mesh, mesh, suffix=suffix, style=style))]


def _split_parts(mesh: Mesh) -> tuple[Mesh, ...]:
    """Return the parts of a mesh. Different parts share no vertex."""
    label = label_parts(mesh.vertices, mesh.faces)
    return tuple(with_faces(mesh, label == number) for number in np.unique(label))


def _write_bytes(content: bytes, file: BinaryIO) -> None:
    file.write(content)

"""What each method's own exporter writes, made from an asset.

These differ from the standard tier on purpose: some keep an alpha, evaluate SH in a fixed direction, merge
vertices or write every face twice. Compared with files the official code wrote (tests/golden).
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from msb.adapters.diffsoup_web import WEIGHTS, texture_size
from msb.adapters.sh import evaluate_sh
from msb.asset.visible import sigmoid, visible_faces
from msb.atomic import new_file, new_folder
from msb.errors import Unsupported, UsageError
from msb.meshes.assets import baked_colors
from msb.meshes.files import write_mesh
from msb.meshes.mesh import Mesh
from msb.meshes.writing import write_rows
from msb.methods import METHODS

if TYPE_CHECKING:
    import os
    from collections.abc import Callable

    from numpy.typing import NDArray

    from msb.asset import Asset

_UP = {
    f"{sign}{axis}": [length if axis == other else 0.0 for other in "xyz"]
    for sign, length in (("+", 1.0), ("-", -1.0))
    for axis in "xyz"
}


class _Exporter(NamedTuple):
    """The suffixes an official exporter writes ("" is a folder), and what writes them."""

    suffixes: tuple[str, ...]
    write: Callable[[Asset, Path], None]


def write_official(asset: Asset, path: str | os.PathLike[str]) -> None:
    """Write `asset` to `path` as the method's own exporter would.

    Raises
    ------
    Unsupported
        `UNSUPPORTED_OFFICIAL`: the method has none.
    UsageError
        `OFFICIAL_FORMAT`: it does not write files of that suffix.
    OutputError
        The place cannot be written.
    """
    exporter, path = official_exporter(asset.manifest.method), Path(path)
    suffix = path.suffix.lower()
    if suffix not in exporter.suffixes:
        wanted = " or ".join(name or "a folder" for name in exporter.suffixes)
        text = f"the exporter of {asset.manifest.method} writes {wanted}; OUT is {path.name}"
        raise UsageError("OFFICIAL_FORMAT", text, file=path, value=suffix)
    exporter.write(asset, path)


def official_exporter(method: str) -> _Exporter:
    """Return how the exporter of `method` writes.

    Raises
    ------
    Unsupported
        `UNSUPPORTED_OFFICIAL`.
    """
    if method not in _EXPORTERS:
        names = ", ".join(_EXPORTERS)
        title = METHODS[method].title
        text = f"{title} has no exporter of its own for such an asset; {names} have"
        raise Unsupported("UNSUPPORTED_OFFICIAL", text, value=method)
    return _EXPORTERS[method]


def _two_dts(asset: Asset, path: Path) -> None:
    """All triangles, or those above the STE threshold and in the scene box; twice without back culling.

    GaodeRender/triangle-splatting at 54c80f7: GLB with vertex RGBA, PLY with face RGBA, by trimesh.
    """
    buffers, settings = asset.buffers, asset.manifest.settings
    keep = visible_faces(asset)
    keep = np.ones(asset.manifest.face_count, bool) if keep is None else keep
    keep &= _in_box(asset)
    alpha = sigmoid(buffers["opacity"][keep])
    if settings["ste_threshold"].value is not None:
        alpha[:] = sigmoid(np.float32(10.0))
    rgba = _bytes(np.column_stack([baked_colors(buffers["f_dc"][keep]), alpha]))
    vertices = buffers["positions"].reshape(-1, 3, 3)[keep].reshape(-1, 3)
    faces = np.arange(len(vertices), dtype=np.int64).reshape(-1, 3)
    twice = not settings["back_culling"].value
    all_faces = np.concatenate([faces, faces[:, ::-1]]) if twice else faces
    if path.suffix.lower() == ".glb":
        mesh = Mesh(vertices, all_faces, np.repeat(rgba, 3, axis=0), None)
    else:
        mesh = Mesh(vertices, all_faces, None, np.concatenate([rgba, rgba]) if twice else rgba)
    with new_file(path) as file:
        write_mesh(mesh, file, suffix=path.suffix)


def _in_box(asset: Asset) -> NDArray[np.bool_]:
    """Return which centroids lie in the scene box, bounds included, if the checkpoint had one."""
    centroids = asset.buffers["positions"].reshape(-1, 3, 3).mean(axis=1)
    inside = np.ones(len(centroids), bool)
    for number, axis in enumerate("xyz"):
        low = asset.manifest.compositing.get(f"scene_bbox_min_{axis}")
        high = asset.manifest.compositing.get(f"scene_bbox_max_{axis}")
        if low is not None and high is not None:
            inside &= (centroids[:, number] >= low) & (centroids[:, number] <= high)
    return inside


def _triangle_splatting(asset: Asset, path: Path) -> None:
    """COFF with merged vertices and face colours: all stored SH seen from the world's origin.

    trianglesplatting/triangle-splatting at 685ff27: create_off.py.
    """
    positions = asset.buffers["positions"]
    triangles = positions.reshape(-1, 3, 3)
    directions = triangles.mean(axis=1, dtype=np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    colors = evaluate_sh(asset, directions, degree=asset.manifest.sh_degree) + np.float32(0.5)
    levels = (np.clip(colors, 0, 1) * np.float32(255)).astype(np.uint8)
    vertices, index = np.unique(positions, axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    rows = np.column_stack([np.full(len(faces), 3), faces, levels, np.full(len(faces), 255)])
    with new_file(path) as file:
        file.write(f"COFF\n{len(vertices)} {len(faces)} 0\n".encode())
        write_rows(file, "%r %r %r", vertices.astype(np.float64))
        write_rows(file, "%d %d %d %d %d %d %d %d", rows)


def _mesh_splatting(asset: Asset, path: Path) -> None:
    """All vertices and faces as stored, baked RGB and full alpha.

    meshsplatting/mesh-splatting at 608e5d0: create_ply.py.
    """
    rgb = baked_colors(asset.buffers["f_dc"])
    rgba = _bytes(np.column_stack([rgb, np.ones(len(rgb), np.float32)]))
    mesh = Mesh(asset.buffers["positions"], asset.buffers["indices"].astype(np.int64), rgba, None)
    with new_file(path) as file:
        write_mesh(mesh, file, suffix=".ply")


def _diffsoup(asset: Asset, path: Path) -> None:
    """A folder for the web viewer: mesh.ply, two textures, the decoder and meta.json.

    kenji-tojo/diffsoup at c74e35d: examples/06_export_web.py.
    """
    buffers, appearance = asset.buffers, asset.manifest.appearance
    lattice, opacity = _texels(buffers["features.lattice"]), _texels(buffers["features.opacity"])
    decoder = {key: buffers[f"decoder.{name}"].ravel().tolist() for key, name in WEIGHTS.items()}
    white = asset.manifest.settings["layout"].value == "synthetic"
    up: list[Any] = [appearance.get(f"up_{axis}") for axis in "xyz"]
    if None in up:
        up = _UP.get(asset.manifest.coordinate_frame.up, [0.0, -1.0, 0.0])
    meta = {
        "up": up,
        "level": appearance["level"],
        "background": [1.0 if white else 0.0] * 3,
        "num_faces": asset.manifest.face_count,
        "num_verts": asset.manifest.vertex_count,
    }
    with new_folder(path) as folder:
        mesh = Mesh(buffers["positions"], buffers["indices"].astype(np.int64), None, None)
        write_mesh(mesh, folder / "mesh.ply", suffix=".ply")
        _write_png(folder / "lut0.png", lattice[:, :, :4])
        _write_png(folder / "lut1.png", np.concatenate([lattice[:, :, 4:], opacity[:, :, None]], axis=2))
        (folder / "mlp_weights.json").write_text(json.dumps(decoder))
        (folder / "meta.json").write_text(json.dumps(meta, indent=2))


def _texels(features: NDArray[Any]) -> NDArray[np.uint8]:
    """Return numbers in [0, 1] as bytes, cut off and not rounded; bytes as they are."""
    if features.dtype == np.uint8:
        return features
    return np.clip(features * np.float32(255), 0, 255).astype(np.uint8)


def _write_png(path: Path, texels: NDArray[np.uint8]) -> None:
    """Write (faces, samples, 4) texels one after the other, in rows, padded with zeros."""
    from PIL import Image

    width, height = texture_size(texels.shape[0] * texels.shape[1])
    pixels = np.zeros((height * width, 4), np.uint8)
    pixels[: texels.shape[0] * texels.shape[1]] = texels.reshape(-1, 4)
    Image.fromarray(pixels.reshape(height, width, 4)).save(path, compress_level=6)


def _bytes(colors: NDArray[Any]) -> NDArray[np.uint8]:
    """Return colours in [0, 1] as bytes, rounded half to even."""
    return np.round(colors.astype(np.float64) * 255).astype(np.uint8)


_EXPORTERS: dict[str, _Exporter] = {
    "two_dts": _Exporter((".glb", ".ply"), _two_dts),
    "triangle_splatting": _Exporter((".off",), _triangle_splatting),
    "mesh_splatting": _Exporter((".ply",), _mesh_splatting),
    "diffsoup": _Exporter(("",), _diffsoup),
}

"""The official export format of DiffSoup: a folder for its web viewer."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.origin import world_positions
from msb.base.atomic import new_folder
from msb.meshes.files import write_mesh
from msb.meshes.mesh import Mesh
from msb.methods.diffsoup.adapter_web import WEIGHTS, texture_size

# The format is a folder, so it has no suffix.
SUFFIXES = ("",)

# Maps the name of each axis to its unit vector.
_UP = {
    f"{sign}{axis}": [length if axis == other else 0.0 for other in "xyz"]
    for sign, length in (("+", 1.0), ("-", -1.0))
    for axis in "xyz"
}


def write(asset: Asset, path: Path) -> None:
    """Write a folder for the web viewer: mesh.ply, two textures, the decoder and meta.json.

    The format follows kenji-tojo/diffsoup at c74e35d: examples/06_export_web.py.
    """
    buffers, appearance = asset.buffers, asset.manifest.appearance
    lattice, opacity = _to_bytes(buffers["features.lattice"]), _to_bytes(buffers["features.opacity"])
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
        mesh = Mesh(world_positions(asset), buffers["indices"].astype(np.int64), None, None)
        write_mesh(mesh, folder / "mesh.ply", suffix=".ply")
        _write_png(folder / "lut0.png", lattice[:, :, :4])
        _write_png(folder / "lut1.png", np.concatenate([lattice[:, :, 4:], opacity[:, :, None]], axis=2))
        (folder / "mlp_weights.json").write_text(json.dumps(decoder))
        (folder / "meta.json").write_text(json.dumps(meta, indent=2))


def _to_bytes(features: NDArray[Any]) -> NDArray[np.uint8]:
    """Return numbers in [0, 1] truncated to bytes; bytes are returned unchanged."""
    if features.dtype == np.uint8:
        return features
    return np.clip(features * np.float32(255), 0, 255).astype(np.uint8)


def _write_png(path: Path, texels: NDArray[np.uint8]) -> None:
    """Write texels (faces, samples, 4) row by row, padded with zeros."""
    from PIL import Image

    width, height = texture_size(texels.shape[0] * texels.shape[1])
    pixels = np.zeros((height * width, 4), np.uint8)
    pixels[: texels.shape[0] * texels.shape[1]] = texels.reshape(-1, 4)
    Image.fromarray(pixels.reshape(height, width, 4)).save(path, compress_level=6)

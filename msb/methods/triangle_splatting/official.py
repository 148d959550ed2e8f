"""The official export format of Triangle-Splatting: COFF with merged vertices and face colours."""

from pathlib import Path

import numpy as np

from msb.asset import Asset
from msb.asset.activation import rest_coefficients
from msb.asset.sh import SH_C0, sh_basis
from msb.base.atomic import new_file
from msb.meshes.writing import write_rows

SUFFIXES = (".off",)


def write(asset: Asset, path: Path) -> None:
    """Write COFF with merged vertices and face colours. All SH degrees are evaluated for a camera at the
    world's origin.

    The format follows trianglesplatting/triangle-splatting at 685ff27: create_off.py.
    """
    positions = asset.buffers["positions"]
    triangles = positions.reshape(-1, 3, 3)
    # Evaluate SH of all stored degrees in the direction of each centroid, and truncate the colours to bytes.
    directions = triangles.mean(axis=1, dtype=np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    colors = np.float32(SH_C0) * asset.buffers["f_dc"]
    for number, value in enumerate(sh_basis(directions, asset.manifest.sh_degree)):
        colors = colors + value[:, None] * rest_coefficients(asset)[:, number]
    colors = colors + np.float32(0.5)
    levels = (np.clip(colors, 0, 1) * np.float32(255)).astype(np.uint8)
    # Merge vertices with equal coordinates.
    vertices, index = np.unique(positions, axis=0, return_inverse=True)
    faces = index.reshape(-1, 3)
    rows = np.column_stack([np.full(len(faces), 3), faces, levels, np.full(len(faces), 255)])
    with new_file(path) as file:
        file.write(f"COFF\n{len(vertices)} {len(faces)} 0\n".encode())
        write_rows(file, "%r %r %r", vertices.astype(np.float64))
        write_rows(file, "%d %d %d %d %d %d %d %d", rows)

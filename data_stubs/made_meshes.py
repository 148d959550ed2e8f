"""Meshes of a known surface in the official file layouts of methods that output a mesh.

The meshes are not trained. Each mesh is the surface itself, and its colours are stored as the method stores
them.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from msb.meshes.files import write_mesh
from msb.meshes.mesh import Mesh

if TYPE_CHECKING:
    from data_stubs.surface import Surface

_FINE = "3Dgs7000_densityestim02_sdfnorm02_level03_decim200000"
PLACES = {
    "milo": "mesh_learnable_sdf.ply",
    "gaussian_wrapping": "mesh_ours_2pivots_post_texture_refined_999.ply",
    "trisplat": "mesh/DIRECT_triangle_mesh_post.ply",
    "sugar": f"sugarfine_{_FINE}_normalconsistency01_gaussperface6.obj",
    "frosting": f"frostingfine_{_FINE}_depth10_quantile01_gauss2000000_frostlevel001_proposal30.obj",
}
"""The path of each method's mesh below the output folder of a scene."""
SQUARE = 10
"""Number of texels along each side of the square that two faces share.

SuGaR and Frosting have this layout.
"""


def write_meshes(folder: Path, surface: Surface, *, white: bool) -> None:
    """Write a mesh of every method below `folder`."""
    for method, place in PLACES.items():
        file = folder / method / place
        file.parent.mkdir(parents=True, exist_ok=True)
        if file.suffix == ".obj":
            _write_textured(file, surface)
        else:
            rgba = np.column_stack([_bytes(surface.color), np.full(len(surface.color), 255, np.uint8)])
            mesh = Mesh(surface.vertices.astype(np.float32), surface.faces, rgba, None)
            write_mesh(mesh, file, suffix=".ply")
    for method in ("milo", "gaussian_wrapping"):
        arguments = "sh_degree=3, source_path='data/pebble', images='images', resolution=-1, eval=True"
        text = f"Namespace({arguments}, white_background={white})"
        (folder / method / "cfg_args").write_text(text)


def _write_textured(file: Path, surface: Surface) -> None:
    """Write an OBJ with material and texture: two faces share a square of texels, cut along its diagonal."""
    count = len(surface.faces)
    side = int(np.ceil(np.sqrt((count + 1) // 2)))
    row, column = np.divmod(np.arange(count) // 2, side)
    texels = np.zeros((side * SQUARE, side * SQUARE, 3), np.uint8)
    y, x = (np.arange(SQUARE) + 0.5)[:, None] / SQUARE, (np.arange(SQUARE) + 0.5)[None] / SQUARE
    corners = np.zeros((count, 3, 2))
    for face in range(count):
        upper = face % 2 == 1
        # Weights of corners 1 and 2 in the square. On its diagonal, the two weights add up to 1.
        b1, b2 = (1 - x, 1 - y) if upper else (x, y)
        first, second, third = surface.color[surface.faces[face]]
        color = first + b1[..., None] * (second - first) + b2[..., None] * (third - first)
        own = (b1 + b2 <= 1) if not upper else (b1 + b2 < 1)
        top, left = row[face] * SQUARE, column[face] * SQUARE
        square = texels[top : top + SQUARE, left : left + SQUARE]
        square[own] = _bytes(color)[own]
        inside = np.array([(1, 1), (0, 1), (1, 0)] if upper else [(0, 0), (1, 0), (0, 1)])
        corners[face] = (np.array([left, top]) + 0.5 + inside * (SQUARE - 1)) / (side * SQUARE)
    corners[..., 1] = 1 - corners[..., 1]  # OBJ counts from below
    material, image = file.with_suffix(".mtl"), file.with_suffix(".png")
    Image.fromarray(texels).save(image)
    material.write_text(f"newmtl mesh\nmap_Kd {image.name}\n# Test colors\nKa 1.000 1.000 1.000\n")
    lines = [f"mtllib {material.name}", "usemtl mesh", ""]
    lines += [f"v {a:.6f} {b:.6f} {c:.6f}" for a, b, c in surface.vertices]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in corners.reshape(-1, 2)]
    for face, (a, b, c) in enumerate(surface.faces + 1):
        lines.append(f"f {a}/{3 * face + 1} {b}/{3 * face + 2} {c}/{3 * face + 3}")
    file.write_text("\n".join(lines) + "\n")


def _bytes(color: NDArray[np.float64]) -> NDArray[np.uint8]:
    return (np.clip(color, 0, 1) * 255).astype(np.uint8)

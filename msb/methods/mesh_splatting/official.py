"""The official export format of MeshSplatting: a PLY with vertex RGBA."""

from pathlib import Path

import numpy as np

from msb.adapters.official import rounded_bytes
from msb.asset import Asset
from msb.asset.look import baked_colors
from msb.asset.origin import world_positions
from msb.base.atomic import new_file
from msb.meshes.files import write_mesh
from msb.meshes.mesh import Mesh

SUFFIXES = (".ply",)


def write(asset: Asset, path: Path) -> None:
    """Write all vertices and faces as stored. Colours are evaluated at SH degree 0, and alpha is 1.

    The format follows meshsplatting/mesh-splatting at 608e5d0: create_ply.py.
    """
    rgb = baked_colors(asset.buffers["f_dc"])
    rgba = rounded_bytes(np.column_stack([rgb, np.ones(len(rgb), np.float32)]))
    mesh = Mesh(world_positions(asset), asset.buffers["indices"].astype(np.int64), rgba, None)
    with new_file(path) as file:
        write_mesh(mesh, file, suffix=".ply")

"""The official file of 3DGS and 2DGS: ``point_cloud.ply`` with the stored parameters of all Gaussians.

The layout follows graphdeco-inria/gaussian-splatting at 54c035f (scene/gaussian_model.py, save_ply). 2DGS
writes two scales.
"""

from pathlib import Path

import numpy as np

from msb.asset import Asset
from msb.asset.activation import rest_coefficients
from msb.asset.tiers import reject_triangles
from msb.base.atomic import new_file
from msb.splats.primitive import MEAN, ROTATION, SCALE

SUFFIXES = (".ply",)
# Number of Gaussians written at a time, to limit temporary memory.
_CHUNK = 1 << 17


def write(asset: Asset, path: Path) -> None:
    """Write a binary PLY with means, normals of 0, SH, opacity, scales and rotations.

    Raises
    ------
    Unsupported
        UNSUPPORTED_METHOD: the asset is a mesh that was extracted from Gaussians.
    """
    reject_triangles(asset.manifest, asset.opened_from)
    count, buffers = asset.manifest.face_count, asset.buffers
    # SH coefficients (N, 3, K): all red coefficients, then green, then blue.
    rest = rest_coefficients(asset).transpose(0, 2, 1) if asset.manifest.sh_degree else None
    coefficients = 0 if rest is None else 3 * rest.shape[2]
    names = ["x", "y", "z", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3))]
    names += [f"f_rest_{k}" for k in range(coefficients)] + ["opacity"]
    names += [f"scale_{k}" for k in range(buffers[SCALE].shape[1])] + [f"rot_{k}" for k in range(4)]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    header += [*(f"property float {name}" for name in names), "end_header\n"]
    with new_file(path) as file:
        file.write("\n".join(header).encode())
        for start in range(0, count, _CHUNK):
            part = slice(start, start + _CHUNK)
            columns = [buffers[MEAN][part], np.zeros_like(buffers[MEAN][part]), buffers["f_dc"][part]]
            columns += [] if rest is None else [rest[part].reshape(-1, coefficients)]
            columns += [buffers["opacity"][part, None], buffers[SCALE][part], buffers[ROTATION][part]]
            file.write(np.concatenate(columns, axis=1).astype("<f4").tobytes())

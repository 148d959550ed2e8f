"""Gaussians of a `.splat` file: rows of 32 bytes without a header (antimatter15/splat).

A row stores the mean and the linear scale as six float32 numbers. Eight bytes follow: red, green, blue,
opacity, and the quaternion w, x, y, z as 128 q + 128. The format has no SH coefficients beyond degree 0.
"""

import numpy as np

from msb.splats.gaussians import Gaussians, check_count, damaged, to_f_dc, to_log, to_logit

_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])


def read(data: memoryview) -> Gaussians:
    """Return the Gaussians of a `.splat` file.

    Raises
    ------
    CheckpointError
        CHECKPOINT_DAMAGED: the file size is not a multiple of the row size. CHECKPOINT_LAYOUT: the file is
        empty.
    """
    if len(data) % _ROW.itemsize:
        raise damaged(f"the file has {len(data)} bytes; a .splat file has {_ROW.itemsize} for each Gaussian")
    check_count(len(data))
    rows = np.frombuffer(data, _ROW)
    rotation = (rows["rotation"].astype(np.float32) - 128) / np.float32(128)
    # A quaternion of length 0 has no direction; use the identity.
    rotation[~rotation.any(axis=1)] = (1, 0, 0, 0)
    rgba = rows["rgba"] / 255
    return Gaussians(
        mean=rows["mean"].copy(),
        scale=to_log(np.abs(rows["scale"].astype(np.float64))),
        rotation=rotation,
        opacity=to_logit(rgba[:, 3]),
        f_dc=to_f_dc(rgba[:, :3]),
    )

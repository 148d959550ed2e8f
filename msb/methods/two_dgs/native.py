"""Native rendering of 2DGS: settings and activations."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.methods.three_dgs.native import splat_culling
from msb.render.splat.model import SplatModel
from msb.splats.primitive import activate


def splat_model(asset: Asset, settings: Mapping[str, Any]) -> SplatModel:
    """Return the model of `asset` for the kernels; raise the errors of `make_model`."""
    discs = activate(asset, 2)
    # Both axes of the N discs as vectors (N, 3). The length of an axis is one standard deviation.
    axes = [discs.rotation[:, :, k] * discs.deviation[:, k : k + 1] for k in range(2)]
    culling = splat_culling(settings["rasterizer"])
    return SplatModel(
        program="two_dgs",
        package=__package__,
        face_words=24,
        engine_words=24,
        positions=np.concatenate([discs.mean, *axes], axis=1).reshape(-1, 3),
        coverage=np.concatenate([discs.opacity[:, None], discs.rotation[:, :, 2]], axis=1),
        near=0.01,
        far=100.0,
        culling=culling,
        engine_culling=culling,
        defines={"GSPLAT": settings["rasterizer"] == "gsplat"},
        outputs=("depth_median", "normal"),
        raw={},
    )

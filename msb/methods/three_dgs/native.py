"""Native rendering of 3DGS: settings and activations."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.render.splat.model import SplatModel
from msb.render.splat.view import Culling
from msb.splats.primitive import activate, covariances

# Depths of the near planes, by rasterizer.
NEAREST = {"official": 0.2, "gsplat": 0.01}


def splat_model(asset: Asset, settings: Mapping[str, Any]) -> SplatModel:
    """Return the model of `asset` for the kernels; raise the errors of `make_model`."""
    gaussians = activate(asset, 3)
    rows = [gaussians.mean, covariances(gaussians.deviation, gaussians.rotation)]
    culling = splat_culling(settings["rasterizer"])
    return SplatModel(
        program="three_dgs",
        package=__package__,
        face_words=24,
        engine_words=24,
        positions=np.concatenate(rows, axis=1).reshape(-1, 3),
        coverage=gaussians.opacity[:, None],
        near=0.01,
        far=100.0,
        culling=culling,
        engine_culling=culling,
        defines={"ANTIALIASED": settings["antialiased"], "GSPLAT": settings["rasterizer"] == "gsplat"},
        outputs=("depth_median",),
        raw={},
    )


def splat_culling(rasterizer: str) -> Culling:
    """Return the bounds outside which a rasterizer draws no Gaussian.

    gsplat evaluates the Jacobian at a point clamped to 0.3 tan(fov / 2) beyond the edge of the image. The
    dilation of the bounds covers this clamp at any principal point. The margin allows for the low-pass filter
    and for whole tiles.
    """
    dilation = 1.3 if rasterizer == "gsplat" else 1.0
    return Culling(nearest=NEAREST[rasterizer], dilation=dilation, margin=8.0)

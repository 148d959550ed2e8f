"""Native rendering of Triangle-Splatting: settings and activations."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.asset.activation import exponential, sigmoid
from msb.asset.drawable import require, required_buffer
from msb.render.splat.model import SplatModel, contour, rim, soup_positions
from msb.render.splat.view import Culling


def splat_model(asset: Asset, settings: Mapping[str, Any]) -> SplatModel:
    """Return the model of `asset` for the kernels; raise the errors of `make_model`."""
    require(asset, "opacity", "encoding", "logit")
    require(asset, "coverage", "sigma_encoding", "exp")
    count = asset.manifest.face_count
    offset = np.float32(asset.manifest.coverage.get("sigma_offset", 0))
    opacity = sigmoid(required_buffer(asset, "opacity", count))
    sigma = offset + exponential(required_buffer(asset, "sigma", count))
    return SplatModel(
        program="triangle_splatting",
        package=__package__,
        face_words=24,
        engine_words=32,
        positions=soup_positions(asset),
        coverage=np.stack([opacity, sigma, contour(opacity, sigma), rim(opacity, sigma)], axis=1),
        near=0.01,
        far=100.0,
        # Two edges of a triangle can be nearly parallel (determinant 1e-3). Rounding shifts the intersection
        # of two nearly parallel edges by up to 0.1 % of its distance from the first sample. The distance is
        # at most the raster's side plus 1600 samples, because a face extends at most 1600 samples beyond the
        # raster. `Culling` adds a margin in proportion to the raster's side.
        culling=Culling(nearest=0.2, dilation=1.0, margin=8.0),
        method_values={"broadcast_z": np.uint32(settings["view_dir"] == "broadcast_z")},
        outputs=("normal", "depth_median"),
        raw={
            "alpha": "alpha",
            "depth_accum": "depth",
            "depth_median": "depth_median",
            "normal_accum": "normal",
        },
    )

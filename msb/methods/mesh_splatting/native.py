"""Native rendering of MeshSplatting: settings and activations."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.asset.activation import sigmoid
from msb.asset.drawable import require, required_buffer
from msb.render.splat.model import SplatModel, rim
from msb.render.splat.view import Culling


def splat_model(asset: Asset, settings: Mapping[str, Any]) -> SplatModel:
    """Return the model of `asset` for the kernels; raise the errors of `make_model`."""
    require(asset, "opacity", "encoding", "logit")
    floor, scale = settings["opacity_floor"], settings["supersample"]
    logits = required_buffer(asset, "opacity", asset.manifest.vertex_count)
    opacity = np.float32(floor) + np.float32(1 - floor) * sigmoid(logits)
    prefix = f"ss{scale}_"
    return SplatModel(
        program="mesh_splatting",
        package=__package__,
        face_words=40,
        engine_words=32,
        positions=asset.buffers["positions"],
        coverage=np.stack([opacity, rim(opacity, np.float32(settings["sigma"]))], axis=1),
        near=0.01,
        far=100.0,
        culling=Culling(nearest=0.2, dilation=1.0, margin=7.0),
        scale=scale,
        box_mean=True,
        method_values={"sigma": np.float32(settings["sigma"])},
        vertex_colors=True,
        outputs=("normal", "depth_median", "face_id"),
        raw={
            f"{prefix}image": "image",
            f"{prefix}alpha": "alpha",
            f"{prefix}depth_expected": "depth",
            f"{prefix}depth_median": "depth_median",
            f"{prefix}normal_cam": "normal",
            f"{prefix}face_id": "face_id",
        },
    )

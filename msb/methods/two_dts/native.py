"""Native rendering of 2DTS: settings and activations."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.activation import sigmoid
from msb.asset.drawable import require, required_buffer
from msb.render.splat.model import CLIPPED, SplatModel, soup_positions
from msb.render.splat.view import Culling

# Number of triangles that are rescaled at a time, to limit temporary memory.
_CHUNK = 1 << 16


def rescale(positions: NDArray[np.float32], gamma: float) -> NDArray[np.float32]:
    """Return triangles (3 F, 3), shrunk about their centroids.

    The factor keeps the total opacity equal for every gamma.

    The scale factor is 1 / sqrt(2^b b Gamma(b)) with b = 1 / gamma, computed in double and rounded
    (GaodeRender/triangle-splatting: src/diff_recon/models/VanillaTS_model.py).
    """
    beta = 1 / gamma
    factor = np.float32(1 / math.sqrt(2**beta * beta * math.gamma(beta)))
    rescaled = np.zeros_like(positions)
    for start in range(0, len(positions), 3 * _CHUNK):
        part = positions[start : start + 3 * _CHUNK].reshape(-1, 3, 3)
        center = ((part[:, 0] + part[:, 1] + part[:, 2]) / np.float32(3))[:, None]
        rescaled[start : start + 3 * _CHUNK] = ((part - center) * factor + center).reshape(-1, 3)
    return rescaled


def reach(opacity: NDArray[np.float32], gamma: float) -> NDArray[np.float32]:
    """Return the eccentricity beyond which alpha is less than 1/255, but at most 10.

    At eccentricity ecc, alpha is o exp(-ecc^(2 gamma) / 2); ecc is 0 at the centroid and 1 on the edges.
    The result is slightly increased to allow for rounding. The result is -1 if alpha is below 1/255 even at
    the centroid.
    """
    with np.errstate(divide="ignore"):
        squared = 2 * np.log(255.0 * opacity.astype(np.float64)) + 1e-5
    limit = np.maximum(squared, 1e-30) ** (1 / (2 * gamma)) * 1.0001
    return np.where(squared > 0, np.minimum(limit, 10), -1).astype(np.float32)


def splat_model(asset: Asset, settings: Mapping[str, Any]) -> SplatModel:
    """Return the model of `asset` for the kernels; raise the errors of `make_model`."""
    require(asset, "opacity", "encoding", "logit")
    positions = soup_positions(asset)
    if settings["gamma_rescale"]:
        positions = rescale(positions, settings["gamma"])
    opacity = sigmoid(required_buffer(asset, "opacity", asset.manifest.face_count))
    if settings["ste_threshold"] is not None:
        step = (opacity > np.float32(settings["ste_threshold"])).astype(np.float32)
        # float32 rounding may give a value slightly above or below 1, as in the official code
        opacity = (step - opacity) + opacity
    return SplatModel(
        program="two_dts",
        package=__package__,
        face_words=24,
        engine_words=32,
        defines={"PLANAR": settings["rasterizer"] == "3D"},
        positions=positions,
        coverage=np.stack([opacity, reach(opacity, settings["gamma"])], axis=1),
        near=1.0,
        far=1000.0,
        culling=Culling(nearest=1.0, dilation=3.0),
        engine_culling=replace(CLIPPED, dilation=10.0),
        scale=settings["render_up_scale"] or 1,
        method_values={
            "power": np.float32(2) * np.float32(settings["gamma"]),
            "back_culling": np.uint32(settings["back_culling"]),
        },
        outputs=("normal",),
        raw={"transmittance": "transmittance", "depth": "depth_over_background", "normal": "normal"},
    )

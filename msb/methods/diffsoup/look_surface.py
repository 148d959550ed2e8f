"""DiffSoup's model for a pipeline with a z-buffer in hardware, whose WGSL is diffsoup.wgsl."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.methods.diffsoup.look_camera import diffsoup_matrices
from msb.methods.diffsoup.look_model import LAYERS, diffsoup_model
from msb.render.surface import Surface

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.scenes import Camera


def surface_model(asset: Asset, settings: Mapping[str, Any]) -> Surface:
    """Return `asset` as diffsoup.wgsl takes it."""
    model = diffsoup_model(asset)
    layout, near, far = settings["layout"], settings["z_near"], settings["z_far"]

    def projection(camera: Camera) -> NDArray[np.float32]:
        return diffsoup_matrices(camera, layout, near, far)[0]

    return Surface(
        program="diffsoup",
        package=__package__,
        positions=model.positions,
        coverage=model.opaque.astype(np.float32)[:, None],
        near=near,
        far=far,
        own={"flip": np.uint32(layout == "synthetic")},
        indices=model.indices,
        opacity=model.opacity,
        features=model.features,
        decoder=_blocks(model.decoder),
        level=model.level,
        projection=projection,
    )


def _blocks(decoder: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return weights as 4 x 4 matrices, output block by output block, column by column; then all biases."""
    weights, biases, first = [], [], 0
    for outputs, inputs in LAYERS.values():
        padding = -outputs % 4
        last = first + outputs * inputs
        weight = np.pad(decoder[first:last].reshape(outputs, inputs), ((0, padding), (0, 0)))
        weights.append(weight.reshape(-1, 4, inputs // 4, 4).transpose(0, 2, 3, 1).ravel())
        first = last + outputs
        biases.append(np.pad(decoder[last:first], (0, padding)))
    return np.concatenate(weights + biases)

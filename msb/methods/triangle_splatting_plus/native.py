"""Native rendering of Triangle Splatting+: MeshSplatting's kernels with `PLUS` defined."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.methods.mesh_splatting import native
from msb.render.splat.model import SplatModel, contour


def splat_model(asset: Asset, settings: Mapping[str, Any]) -> SplatModel:
    """Return the model of `asset` for the kernels; raise the errors of `make_model`."""
    model = native.splat_model(asset, settings)
    shrunk = contour(model.coverage[:, 0], np.float32(settings["sigma"]))
    # The tiles and the margin are computed as in Triangle-Splatting.
    return replace(
        model,
        coverage=np.column_stack([model.coverage, shrunk]),
        culling=replace(model.culling, margin=8.0),
        defines={"PLUS": True},
    )

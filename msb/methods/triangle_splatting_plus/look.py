"""Triangle Splatting+ on the dedicated tier: MeshSplatting's kernels with their `PLUS` defined."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.methods.mesh_splatting import look
from msb.render.splat.model import Model, contour


def splat_model(asset: Asset, settings: Mapping[str, Any]) -> Model:
    """Return `asset` as the kernels take it; errors as `make_model`."""
    model = look.splat_model(asset, settings)
    shrunk = contour(model.coverage[:, 0], np.float32(settings["sigma"]))
    # The margin is Triangle-Splatting's, whose tiles it has.
    return replace(
        model,
        coverage=np.column_stack([model.coverage, shrunk]),
        culling=replace(model.culling, margin=8.0),
        defines={"PLUS": True},
    )

"""What the splatting pipeline refuses to draw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from msb.errors import AssetError, UsageError
from msb.render.splat.pipeline import SplattingPipeline
from tests.reference.soups import SPLATTING
from tests.render.test_splatting import model

if TYPE_CHECKING:
    from msb.cl import Device


@pytest.mark.parametrize(
    ("method", "name"),
    [(method, name) for method in SPLATTING for name in ("positions", "opacity", "f_dc", "f_rest")]
    + [("triangle_splatting", "sigma")],
)
def test_nan_is_refused(method: str, name: str, cpu: Device) -> None:
    asset = model(method, 1)
    array = asset.buffers[name].copy()
    array.reshape(-1)[17] = np.nan
    row = 17 // (array.size // len(array))
    object.__setattr__(asset, "buffers", {**asset.buffers, name: array})
    with pytest.raises(AssetError, match=f"buffer {name} .*row {row};") as caught:
        SplattingPipeline(asset, device=cpu)
    assert caught.value.code == "TRIASSET_VALUE_NONFINITE"


def test_an_index_out_of_range_is_refused(cpu: Device) -> None:
    asset = model("mesh_splatting", 1)
    indices = asset.buffers["indices"].copy()
    indices[5, 2] = asset.manifest.vertex_count
    object.__setattr__(asset, "buffers", {**asset.buffers, "indices": indices})
    with pytest.raises(AssetError) as caught:
        SplattingPipeline(asset, device=cpu)
    assert caught.value.code == "TRIASSET_INDEX_OUT_OF_RANGE"


def test_wrong_options_are_refused(cpu: Device) -> None:
    asset = model("two_dts", 1)
    with pytest.raises(UsageError, match="there is no output"):
        SplattingPipeline(asset, device=cpu, outputs=("normals",))
    with pytest.raises(UsageError, match="no setting"):
        SplattingPipeline(asset, device=cpu, settings={"sigma": 1.0})

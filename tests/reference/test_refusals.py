"""What cannot be drawn is refused by code, and says why."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from msb.asset import Asset, build_asset
from msb.errors import AssetError, Unsupported, UsageError
from msb.reference import render_reference
from tests.conftest import TETRAHEDRON
from tests.reference.soups import METHODS, front_camera, random_triangles, soup


def changed(asset: Asset, name: str, index: Any, value: float) -> Asset:
    """Return `asset` with one value of a buffer replaced behind its checks, as a file can have it."""
    array = asset.buffers[name].copy()
    array[index] = value
    return replace(asset, buffers={**asset.buffers, name: array})


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite(method: str, value: float) -> None:
    asset = soup(method, random_triangles(1, count=4), degree=0 if method == "diffsoup" else 1)
    floats = [name for name, array in asset.buffers.items() if array.dtype.kind == "f"]
    assert len(floats) >= 4
    for name in floats:
        if name == "opacity" and np.isinf(value):
            continue
        bad = changed(asset, name, 2, value)
        with pytest.raises(AssetError) as caught:
            render_reference(bad, front_camera())
        assert caught.value.code == "TRIASSET_VALUE_NONFINITE"
        assert caught.value.pointer == f"{name}[2]"


@pytest.mark.parametrize("method", METHODS)
def test_indices_out_of_range(method: str) -> None:
    asset = soup(method, random_triangles(1, count=4))
    with pytest.raises(AssetError) as caught:
        render_reference(changed(asset, "indices", (3, 1), 12), front_camera())
    assert caught.value.code == "TRIASSET_INDEX_OUT_OF_RANGE"
    assert caught.value.pointer == "indices[3, 1]"


@pytest.mark.parametrize("method", METHODS)
def test_missing_and_misshapen_buffers(method: str) -> None:
    asset = soup(method, random_triangles(1, count=4))
    for name in asset.buffers.keys() - {"positions", "indices"}:
        rest = {other: array for other, array in asset.buffers.items() if other != name}
        with pytest.raises(AssetError) as caught:
            render_reference(replace(asset, buffers=rest), front_camera())
        assert caught.value.code == "TRIASSET_BUFFER"
        assert name in str(caught.value)
        longer = np.concatenate([asset.buffers[name]] * 2)
        with pytest.raises(AssetError) as caught:
            render_reference(replace(asset, buffers={**rest, name: longer}), front_camera())
        assert caught.value.code == "TRIASSET_BUFFER"


@pytest.mark.parametrize(
    ("method", "section", "key", "value"),
    [
        ("two_dts", "opacity", "encoding", "opaque"),
        ("triangle_splatting", "coverage", "sigma_encoding", "log"),
        ("triangle_splatting", "coverage", "sigma_offset", "0.01"),
        ("diffsoup", "appearance", "level", None),
        ("diffsoup", "appearance", "level", 40),
        ("diffsoup", "appearance", "level", True),
    ],
)
def test_parameters_we_do_not_know(method: str, section: str, key: str, value: Any) -> None:
    asset = soup(method, random_triangles(1, count=4))
    parameters = {**getattr(asset.manifest, section), key: value}
    asset = replace(asset, manifest=replace(asset.manifest, **{section: parameters}))
    with pytest.raises(AssetError) as caught:
        render_reference(asset, front_camera())
    assert caught.value.code == "TRIASSET_FIELD"
    assert caught.value.pointer == f"/{section}/{key}"


def test_a_mesh_has_no_reference_tier() -> None:
    vertices, faces = TETRAHEDRON
    asset = build_asset({"positions": vertices, "indices": faces.astype(np.uint32)}, {})
    with pytest.raises(Unsupported) as caught:
        render_reference(asset, front_camera())
    assert caught.value.code == "UNSUPPORTED_TIER"
    assert caught.value.exit_status == 4
    assert "mesh" in caught.value.message
    assert "static colours" in caught.value.message


def test_settings_that_are_none() -> None:
    asset = soup("two_dts", random_triangles(1, count=4))
    with pytest.raises(UsageError, match="gama"):
        render_reference(asset, front_camera(), settings={"gama": 2.0})
    with pytest.raises(UsageError, match="degree 0"):
        render_reference(asset, front_camera(), settings={"sh_degree": 2})

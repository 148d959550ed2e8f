"""Assets that cannot be drawn are rejected with an error code, on every tier."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import Asset, build_asset
from msb.errors import AssetError, MsbError, Unsupported, UsageError
from msb.reference import render_reference
from tests.cl.conftest import SELECTOR
from tests.conftest import TETRAHEDRON
from tests.reference.soups import METHODS, SPLATTING, front_camera, random_triangles, soup

TIERS = [*((method, tier) for method in METHODS for tier in ("reference", "dedicated"))]
EVERY = [*TIERS, *((method, "standard") for method in SPLATTING)]


def rejection(asset: Asset, tier: Any, code: str) -> MsbError:
    """Return the error with the given code that `tier` raises for `asset`."""
    with pytest.raises(AssetError, match=f"^{code}: ") as caught:
        msb.render(asset, front_camera(), tier, device=SELECTOR)
    return caught.value


def replace_value(asset: Asset, name: str, index: Any, value: float) -> Asset:
    """Return `asset` with one value of a buffer replaced. Any value is possible, as in a file."""
    array = asset.buffers[name].copy()
    array[index] = value
    return replace(asset, buffers={**asset.buffers, name: array})


@pytest.mark.parametrize(("method", "tier"), EVERY)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite(method: str, tier: str, value: float) -> None:
    asset = soup(method, random_triangles(1, count=4), degree=0 if method == "diffsoup" else 1)
    names = [name for name, array in asset.buffers.items() if array.dtype.kind == "f"]
    for name in ("positions", "f_dc") if tier == "standard" else names:
        if name == "opacity" and np.isinf(value):
            continue
        error = rejection(replace_value(asset, name, 2, value), tier, "TRIASSET_VALUE_NONFINITE")
        assert error.pointer == f"{name}[2]"


@pytest.mark.parametrize(("method", "tier"), EVERY)
def test_indices_out_of_range(method: str, tier: str) -> None:
    asset = replace_value(soup(method, random_triangles(1, count=4)), "indices", (3, 1), 12)
    assert rejection(asset, tier, "TRIASSET_INDEX_OUT_OF_RANGE").pointer == "indices[3, 1]"


@pytest.mark.parametrize(("method", "tier"), TIERS)
def test_missing_and_misshapen_buffers(method: str, tier: str) -> None:
    asset = soup(method, random_triangles(1, count=4))
    for name in asset.buffers.keys() - {"positions", "indices"}:
        rest = {other: array for other, array in asset.buffers.items() if other != name}
        longer = np.concatenate([asset.buffers[name]] * 2)
        for buffers in (rest, {**rest, name: longer}):
            error = rejection(replace(asset, buffers=buffers), tier, "TRIASSET_BUFFER")
            assert name in str(error)


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
def test_unknown_parameters(method: str, section: str, key: str, value: Any) -> None:
    asset = soup(method, random_triangles(1, count=4))
    parameters = {**getattr(asset.manifest, section), key: value}
    asset = replace(asset, manifest=replace(asset.manifest, **{section: parameters}))
    for tier in ("reference", "dedicated") if key != "sigma_offset" else ("reference",):
        assert rejection(asset, tier, "TRIASSET_FIELD").pointer == f"/{section}/{key}"


@pytest.mark.parametrize(
    ("method", "tier"), [("mesh", "reference"), ("mesh", "dedicated"), ("diffsoup", "standard")]
)
def test_unsupported_tiers(method: str, tier: Any) -> None:
    vertices, faces = TETRAHEDRON
    mesh = build_asset({"positions": vertices, "indices": faces.astype(np.uint32)}, {})
    asset = mesh if method == "mesh" else soup(method, random_triangles(1, count=4))
    with pytest.raises(Unsupported) as caught:
        msb.render(asset, front_camera(), tier, device=SELECTOR)
    assert (caught.value.code, caught.value.exit_status) == ("UNSUPPORTED_TIER", 4)


@pytest.mark.parametrize(
    ("settings", "code"), [({"gama": 2.0}, "SETTING_UNKNOWN"), ({"sh_degree": 2}, "SETTING_VALUE")]
)
def test_invalid_settings(settings: dict[str, Any], code: str) -> None:
    with pytest.raises(UsageError, match=code):
        render_reference(soup("two_dts", random_triangles(1, count=4)), front_camera(), settings=settings)

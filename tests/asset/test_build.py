"""Building an asset in memory: complete manifests, canonical arrays, and errors."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from msb.asset import Description, build_asset
from msb.asset.build import measure_bounds
from msb.asset.manifest import Source, SourceFile, StoredSetting
from msb.asset.validation import check_values
from msb.errors import AssetError
from msb.registry import METHODS, TIERS
from tests.corpus.good import SHA_OF_NOTHING, decoder, mesh, soup

TRIANGLE = np.eye(3, dtype=np.float32)
FACE = np.array([[0, 1, 2]], np.uint32)
POINTS = arrays(
    np.float32, st.tuples(st.integers(1, 40), st.just(3)), elements=st.floats(-(2.0**60), 2.0**60, width=32)
)


def refused(code: str, buffers: dict, domains: dict | None = None, **description: object) -> None:
    with pytest.raises(AssetError, match=f"TRIASSET_{code}: "):
        build_asset(buffers, domains or {}, Description(**description))


@pytest.mark.parametrize("make", [mesh, soup, decoder])
def test_the_manifest_describes_the_buffers(make) -> None:
    asset = make()
    assert check_values(asset) == []
    assert list(asset.buffers) == list(asset.manifest.buffers)
    for name, spec in asset.manifest.buffers.items():
        array = asset.buffers[name]
        assert spec.shape == array.shape
        assert spec.byte_length == array.nbytes
        assert spec.sha256 == hashlib.sha256(array.tobytes()).hexdigest()
        assert not array.flags.writeable


@given(POINTS)
def test_bounds_are_exact_and_the_sphere_holds_every_vertex(points: np.ndarray) -> None:
    bounds, sphere = measure_bounds(points)
    assert np.array_equal(bounds.min, points.min(axis=0))
    assert np.array_equal(bounds.max, points.max(axis=0))
    distance = np.sqrt(np.square(points.astype(np.float64) - sphere.center).sum(axis=1))
    assert (distance <= sphere.radius).all()
    assert sphere.radius <= np.linalg.norm(np.subtract(bounds.max, bounds.min)) / 2 * (1 + 1e-12) + 1e-300


@given(POINTS, st.sampled_from([np.nan, np.inf, -np.inf]))
def test_bounds_ignore_rows_that_are_not_finite(points: np.ndarray, bad: float) -> None:
    spoilt = np.concatenate([points, np.full((1, 3), bad, np.float32)])
    spoilt[-1, 0] = 0
    assert measure_bounds(spoilt) == measure_bounds(points)


def test_minus_zero_is_written_as_zero() -> None:
    bounds, sphere = measure_bounds(-np.zeros((2, 3), np.float32))
    assert repr((bounds, sphere)).count("-0.0") == 0
    assert sphere.radius == 0


def test_contiguous_arrays_are_not_copied() -> None:
    positions, indices = TRIANGLE.copy(), FACE.copy()
    asset = build_asset({"positions": positions, "indices": indices}, {})
    assert np.shares_memory(asset.buffers["positions"], positions)
    assert positions.flags.writeable
    swapped = build_asset({"positions": positions.astype(">f4"), "indices": indices.astype(">u4")}, {})
    assert swapped.buffers["positions"].dtype == np.dtype("<f4")
    assert swapped.manifest == asset.manifest
    strided = build_asset({"positions": np.repeat(positions, 2, axis=0)[::2], "indices": indices}, {})
    assert strided.manifest == asset.manifest


@pytest.mark.parametrize("method", METHODS)
def test_every_method_makes_a_valid_manifest_from_its_defaults(method: str) -> None:
    settings = {
        name: StoredSetting(0 if name == "sh_degree" else setting.default, "default")
        for name, setting in METHODS[method].settings.items()
    }
    declared = METHODS[method]
    description = Description(method=method, settings=settings, primitive=declared.primitive)
    buffers, domains, tiers = {"positions": TRIANGLE, "indices": FACE}, {}, set(TIERS)
    if declared.primitive == "gaussian":
        widths = {"gauss.mean": 3, "gauss.scale": 3, "gauss.rotation": 4}
        buffers |= {name: np.zeros((1, width), np.float32) for name, width in widths.items()}
        domains, tiers = dict.fromkeys(widths, "face"), tiers - {"standard"}
    manifest = build_asset(buffers, domains, description).manifest
    assert set(manifest.required_passes) == {tier for tier in tiers if declared.supports(tier)}


def test_invalid_buffers_are_rejected() -> None:
    good = {"positions": TRIANGLE, "indices": FACE}
    nan = TRIANGLE.copy()
    nan[1, 1] = np.nan
    refused("VALUE_NONFINITE", {**good, "positions": nan})
    refused("INDEX_OUT_OF_RANGE", {**good, "indices": FACE + np.uint32(1)})
    refused("BUFFER", {**good, "indices": np.full((1, 3), np.nan, np.float32)})
    refused("BUFFER", {**good, "positions": TRIANGLE.astype(np.float64)})
    refused("BUFFER", {**good, "positions": TRIANGLE.ravel()})
    refused("BUFFER", {"positions": TRIANGLE})
    refused("EMPTY", {**good, "indices": FACE[:0]})
    refused("BUFFER", {**good, "f_dc": TRIANGLE[:2]}, {"f_dc": "vertex"})
    refused("BUFFER", {**good, "f_dc": TRIANGLE})
    refused("BUFFER", {**good, "f_rest": np.zeros((3, 0), np.float32)}, {"f_rest": "vertex"})
    refused("BUFFER", {**good, "Bad": TRIANGLE}, {"Bad": "vertex"})


def test_invalid_descriptions_are_rejected() -> None:
    good = {"positions": TRIANGLE, "indices": FACE}
    undecodable = SourceFile("cam\udcff.pt", SHA_OF_NOTHING, 0)
    for wrong in (
        {"method": "NeRF"},
        {"coverage": {"kernel": "solid", "gamma": float("nan")}},
        {"coverage": {"kernel": "solid", "gamma": np.float32(1)}},
        {"source": Source((undecodable,))},
        {"settings": {"gamma": StoredSetting(1.0, "flag")}},
        {"sh_degree": 1},
    ):
        refused("FIELD", good, **wrong)


def test_a_soup_is_recognised_by_its_indices_alone() -> None:
    points = np.arange(18, dtype=np.float32).reshape(6, 3)
    in_order = np.arange(6, dtype=np.uint32).reshape(2, 3)
    for indices, topology in (
        (in_order, "triangle_soup"),
        (in_order[::-1], "indexed_mesh"),
        (in_order[:1], "indexed_mesh"),
    ):
        assert build_asset({"positions": points, "indices": indices}, {}).manifest.topology == topology

"""Crossing faces compared with exact arithmetic on every pair, and with CGAL."""

from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msb.topology.crossings import find_crossing_pairs


def side(a: Any, b: Any, c: Any, d: Any) -> int:
    """Return the sign of a determinant of integers, exactly."""
    (x, y, z), (u, v, w), (p, q, r) = (
        [int(s) - int(t) for s, t in zip(e, d, strict=True)] for e in (a, b, c)
    )
    value = x * (v * r - w * q) + y * (w * p - u * r) + z * (u * q - v * p)
    return (value > 0) - (value < 0)


def crosses(first: Any, second: Any) -> bool:
    """Return whether an edge of one triangle passes through the other triangle or its border."""
    for edges, face in ((first, second), (second, first)):
        for k in range(3):
            p, q = edges[k], edges[(k + 1) % 3]
            if side(*face, p) * side(*face, q) >= 0:
                continue
            turns = [side(p, q, face[j], face[(j + 1) % 3]) for j in range(3)]
            if not {-1, 1} <= set(turns):
                return True
    return False


def every_pair(corners: Any) -> list[list[int]]:
    rows = corners.tolist()
    return [[i, j] for i, j in combinations(range(len(rows)), 2) if crosses(rows[i], rows[j])]


@settings(max_examples=60)
@given(st.integers(0, 10_000), st.sampled_from([2, 3, 6, 50]), st.integers(2, 16))
def test_crossings_equal_exact_arithmetic(seed: int, size: int, count: int) -> None:
    # Coordinates are a few integers, so that touching, coplanar and degenerate triangles are common.
    rng = np.random.default_rng(seed)
    corners = rng.integers(0, size, (count, 3, 3)).astype(np.float64)
    pairs = every_pair(corners)
    assert find_crossing_pairs(corners).tolist() == pairs
    some = rng.random(count) < 0.3
    assert find_crossing_pairs(corners, of=some).tolist() == [pair for pair in pairs if some[pair].any()]


@pytest.mark.slow
def test_crossings_of_small_and_large_faces_are_found() -> None:
    rng = np.random.default_rng(4)
    sizes = 10.0 ** rng.uniform(0, 3, (300, 1, 1))
    corners = np.round(rng.uniform(0, 2000, (300, 1, 3)) + sizes * rng.normal(size=(300, 3, 3)))
    result = find_crossing_pairs(corners).tolist()
    assert result == every_pair(corners)
    assert len(result) > 100


@pytest.mark.slow
@pytest.mark.oracle
def test_crossings_equal_cgal() -> None:
    cgal = pytest.importorskip("igl.copyleft.cgal")
    rng = np.random.default_rng(0)
    corners = rng.random((5000, 3, 3)) * 0.05 + rng.random((5000, 1, 3))
    result = find_crossing_pairs(corners)
    theirs = cgal.remesh_self_intersections(
        corners.reshape(-1, 3), np.arange(15000).reshape(-1, 3), detect_only=True
    )[2]
    assert len(result) > 100
    assert set(map(tuple, result.tolist())) == {tuple(sorted(map(int, row))) for row in theirs.tolist()}


def test_long_thin_faces_are_searched_within_a_limit() -> None:
    rng = np.random.default_rng(2)
    ends = rng.integers(0, 1000, (120, 2, 3)).astype(np.float64)
    corners = np.concatenate([ends, ends[:, :1] + rng.integers(-1, 2, (120, 1, 3))], axis=1)
    assert find_crossing_pairs(corners).tolist() == every_pair(corners)
    assert find_crossing_pairs(corners, most=10) is None


def test_empty_and_single_face_meshes_have_no_crossings() -> None:
    assert find_crossing_pairs(np.zeros((0, 3, 3))).shape == (0, 2)
    assert find_crossing_pairs(np.zeros((1, 3, 3))).shape == (0, 2)
    assert find_crossing_pairs(np.zeros((4, 3, 3))).shape == (0, 2)

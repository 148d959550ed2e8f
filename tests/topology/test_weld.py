"""Welding: merged and kept vertices, independent of order and magnitude."""

import numpy as np
import pytest

from data_stubs.splat_like import splat_like
from msb import audit
from msb.errors import MeshError
from msb.topology.weld import corners_coincide, parse_weld, weld_vertices

NO_FACES = np.zeros((0, 3), np.int32)


def merged(points: object, weld: object) -> list[int]:
    """Return for each vertex the number of the vertex that it became."""
    points = np.asarray(points, float).reshape(-1, 3)
    faces_of_points = np.stack([np.arange(len(points))] * 3, axis=1)
    _, faces = weld_vertices(points, faces_of_points, weld)
    return faces[:, 0].tolist()


def line(*x: float) -> np.ndarray:
    return np.array([[v, 0.0, 0.0] for v in x])


NAN, INF = np.nan, np.inf


@pytest.mark.parametrize(
    ("points", "weld", "groups"),
    [
        (line(0.1, 0.1 + 1e-12, 0.1 + 1e-7), "exact", [0, 0, 1]),  # as float32
        ([[0.0, -0.0, 0.0], [-0.0, 0.0, 0.0], [0.0, 0.0, 1e-45]], "exact", [0, 0, 1]),
        (line(NAN, NAN, INF, INF, -INF), "exact", [0, 1, 2, 2, 3]),
        (line(0.0, 1.0, 2.0, 3.5, 4.0, 9.0), 1.0, [0, 0, 0, 1, 1, 2]),  # chains are merged
        # vertices at exactly the given distance are merged
        ([[0.0, 0, 0], [3, 4, 0], [10, 0, 0], [10, 3, 4.001]], 5.0, [0, 0, 1, 2]),
        ([[0, 0, 0], [NAN, 0, 0], [NAN, 0, 0], [INF, 0, 0], [0.1, 0, 0]], 1.0, [0, 1, 2, 3, 0]),
        (np.full((3, 3), NAN), 1.0, [0, 1, 2]),
        (line(1.0, 2.0, 1.0), 5e-324, [0, 1, 0]),
        (line(1.0, 2.0, 3e-300), 1.7e308, [0, 0, 0]),
        (np.zeros((20_000, 3)), 1e-3, [0] * 20_000),  # coincident vertices do not count as pairs
        (np.zeros((0, 3)), "exact", []),
        (np.zeros((0, 3)), 0.5, []),
    ],
)
def test_merged_vertices(points: object, weld: object, groups: list[int]) -> None:
    assert merged(points, weld) == groups


@pytest.mark.parametrize("weld", ["exact", 0.05])
def test_weld_does_not_depend_on_the_order_of_vertices(weld: object) -> None:
    random = np.random.default_rng(2)
    points = random.integers(0, 4, (200, 3)) + random.choice([0.0, 0.03, 0.06, 0.2], (200, 3))
    groups = merged(points, weld)
    order = random.permutation(200)
    shuffled = merged(points[order], weld)
    # The groups are equal, but their numbers differ.
    together = {(groups[o], s) for o, s in zip(order, shuffled, strict=True)}
    assert len(set(groups)) == len(set(shuffled)) == len(together)


def test_length_weld_equals_joining_all_pairs() -> None:
    random = np.random.default_rng(9)
    for scale in (1e-200, 1.0, 1e200):
        points = random.random((60, 3)) * scale
        reach = 0.15 * scale
        label = list(range(60))
        unit = points / scale
        for i in range(60):
            for j in range(i):
                if np.linalg.norm(unit[i] - unit[j]) <= 0.15:
                    a, b = label[i], label[j]
                    label = [min(a, b) if x in (a, b) else x for x in label]
        place = {first: n for n, first in enumerate(sorted(set(label)))}
        assert merged(points, reach) == [place[x] for x in label]


def test_weld_length_that_would_collapse_the_mesh_is_rejected() -> None:
    points = np.random.default_rng(0).random((20_000, 3))
    with pytest.raises(MeshError, match="shorter distance") as caught:
        weld_vertices(points, NO_FACES, 10.0)
    assert caught.value.code == "WELD_DISTANCE"


def test_exploding_and_welding_restores_the_mesh() -> None:
    points, faces = splat_like(14)
    before = audit(points, faces)
    soup = audit(points[faces.reshape(-1)], np.arange(faces.size).reshape(-1, 3), weld="exact")
    assert soup.is_soup
    assert soup.counts.components == len(faces)
    assert soup.welded.counts == before.counts
    np.testing.assert_allclose(
        [soup.welded.metrics.lcc_area_ratio, soup.welded.metrics.total_area],
        [before.metrics.lcc_area_ratio, before.metrics.total_area],
    )


def test_weld_keeps_dtypes_and_input() -> None:
    points, faces = line(1, 1).astype(np.float32), np.array([[0, 1, 0]], np.int32)
    points.flags.writeable = faces.flags.writeable = False
    for weld in ("exact", 0.5):
        kept, rows = weld_vertices(points, faces, weld)
        assert (kept.dtype, rows.dtype) == (np.float32, np.int32)


def test_weld_settings_are_parsed() -> None:
    assert parse_weld("exact") == "exact"
    assert parse_weld("1e-4") == 1e-4
    assert parse_weld(np.float32(0.5)) == 0.5


@pytest.mark.parametrize(
    "text", ["", "0", "-1", "nan", "inf", "close", "1 mm", 0, [1.0], 10**400, True, np.True_]
)
def test_invalid_weld_settings_are_rejected(text: object) -> None:
    with pytest.raises(MeshError) as caught:
        parse_weld(text)
    assert caught.value.code == "WELD_DISTANCE"


@pytest.mark.parametrize(
    ("moved", "coincide"),
    [
        ({}, False),
        ({(5, 1): (0, 0)}, True),
        ({(0, 2): (0, 1)}, False),  # corners of one face join nothing
        ({(0, 2): (0, 1), (5, 1): (0, 1)}, True),
    ],
)
def test_corners_coincide_if_two_faces_share_a_position(
    moved: dict[tuple[int, int], tuple[int, int]], coincide: bool
) -> None:
    corners = np.random.default_rng(0).uniform(-1, 1, (40, 3, 3))
    for target, source in moved.items():
        corners[target] = corners[source]
    faces = np.arange(120).reshape(-1, 3)
    assert corners_coincide(corners.reshape(-1, 3), faces) is coincide
    assert audit(corners.reshape(-1, 3), faces).corners_coincide is coincide


def test_nan_coincides_with_nothing() -> None:
    nowhere = np.full((9, 3), np.nan)
    nowhere[0], nowhere[3] = (0.0, 0.0, 0.0), (-0.0, 0.0, 1e-50)
    faces = np.arange(9).reshape(-1, 3)
    assert corners_coincide(nowhere, faces)
    assert not corners_coincide(nowhere[3:], faces[:2])
    assert audit(np.eye(3), [[0, 1, 2], [0, 2, 1]]).corners_coincide is None

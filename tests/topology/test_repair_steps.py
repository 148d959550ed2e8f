"""Guarantees of every repair step on random meshes, and results for meshes with a known optimum."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray

from msb.topology.arrays import mesh_arrays
from msb.topology.halfedge import NONE
from msb.topology.steps import Change, close, cut, debris, drop, orient, pair, weld
from tests.conftest import BOOK, TETRAHEDRON
from tests.topology.meshes import CASES, Case, Mesh, counts, finite_mesh, places, sphere
from tests.topology.test_properties import meshes

STEPS: dict[str, Callable[[np.ndarray, np.ndarray], Change]] = {
    "orient": lambda points, faces: orient(faces, len(points)),
    "cut": lambda points, faces: cut(faces, len(points)),
    "pair": pair,
    "drop": drop,
    "debris": lambda points, faces: debris(points, faces, least_faces=3),
    "close": close,
    "weld": weld,
}


def check_is_sound(name: str, points: np.ndarray, faces: np.ndarray) -> None:
    """Assert the guarantees of a step for any mesh."""
    change = STEPS[name](points, faces)
    after, old = places(points, change), counts(points, faces)
    new = counts(after, change.faces)
    kept = change.face_map != NONE
    corners = change.corner_map[np.repeat(kept, 3)]
    assert np.array_equal(after[change.faces[kept].reshape(-1)], points[faces.reshape(-1)[corners]])
    assert (np.sort(change.face_map[kept]) == change.face_map[kept]).all()
    if name != "weld":
        mapped = change.vertex_map[change.faces[kept]]
        assert np.array_equal(mapped.reshape(-1), faces.reshape(-1)[corners])
    if name in ("cut", "pair", "drop"):
        assert (new.nonmanifold_edges, new.nonmanifold_vertices) == (0, 0)
    if name in ("cut", "pair"):
        assert old.components <= new.components <= old.components_manifold_edges
        assert new.faces == old.faces
    if name == "orient":
        assert new.inconsistent_winding_edges == 0
    if name == "close":
        assert new.nonmanifold_edges == old.nonmanifold_edges
        assert new.nonmanifold_vertices == old.nonmanifold_vertices
    else:
        again = STEPS[name](after, change.faces)
        assert np.array_equal(again.faces, change.faces)
        assert np.array_equal(again.vertex_map, np.arange(len(after)))


@pytest.mark.parametrize("name", STEPS)
def test_steps_keep_their_guarantees_on_random_meshes(name: str) -> None:
    for seed in range(40):
        check_is_sound(name, *finite_mesh(seed))


@pytest.mark.parametrize("name", STEPS)
@settings(max_examples=30, derandomize=True)
@given(meshes(finite=True))
def test_steps_keep_their_guarantees_on_hypothesis_meshes(name: str, mesh: Mesh) -> None:
    check_is_sound(name, *mesh_arrays(*mesh))


@pytest.mark.parametrize("case", [c for c in CASES if c.valid], ids=lambda c: c.name)
def test_steps_accept_every_valid_hand_made_case(case: Case) -> None:
    points, faces = mesh_arrays(np.nan_to_num(case.vertices, posinf=1, neginf=-1), case.faces)
    for name in STEPS:
        check_is_sound(name, points, faces)


@pytest.mark.slow
def test_pair_leaves_a_consistent_winding_possible() -> None:
    for seed in range(150):
        points, faces = finite_mesh(seed)
        if orient(faces, len(points)).notes:
            continue
        change = pair(points, faces)
        wound = orient(change.faces, len(change.vertex_map))
        assert counts(places(points, change), wound.faces).inconsistent_winding_edges == 0, seed


def test_pair_prefers_flat_pages_then_equal_colours() -> None:
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0.1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    assert together(pair(points, faces)) == {(0, 1)}
    points[3] = [-1, 0, 0]
    points[4] = [-1, 0, 0]
    colors = np.zeros((5, 3))
    colors[3] = 1
    assert together(pair(points, faces, vertex_colors=colors)) == {(0, 2)}
    assert together(pair(points, faces, face_colors=np.array([[0.0], [0], [1]]))) == {(0, 1)}


def together(change: Change) -> set[tuple[int, int]]:
    """Return the pairs of faces that share an edge."""
    rows = enumerate(change.faces.tolist())
    return {(i, j) for (i, a), (j, b) in combinations(rows, 2) if len({*a} & {*b}) == 2}


def test_many_pages_are_paired_half_a_turn_apart() -> None:
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    pages = np.stack([np.cos(angle), np.sin(angle), np.zeros(20)], axis=1)
    points = np.concatenate([[[0, 0, 0], [0, 0, 1]], pages])
    faces = np.stack([np.zeros(20, int), np.ones(20, int), np.arange(2, 22)], axis=1)
    assert together(pair(points, faces)) == {(i, i + 10) for i in range(10)}


def strip(columns: int, rows: int, *, closed: bool = False) -> NDArray[np.int64]:
    """Return the faces of a Moebius strip, or of a Klein bottle (with joined rims) if `closed`."""
    count = rows if closed else rows + 1
    at = np.arange(columns * count).reshape(columns, count)
    behind = np.roll(at[:1, ::-1], 1, axis=1) if closed else at[:1, ::-1]
    at = np.concatenate([at, behind])
    at = np.concatenate([at, at[:, :1]], axis=1) if closed else at
    a, b, c, d = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
    return np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3)


def handles(count: int) -> NDArray[np.int64]:
    """Return the faces of a straight strip. `count` twisted strips connect parts of its upper rim."""
    along = np.arange(4 * count)
    low, high = np.stack([along, along + 1]), 4 * count + 1 + np.stack([along, along + 1])
    straight = np.stack([low[0], low[1], high[1], low[0], high[1], high[0]], axis=-1).reshape(-1, 3)
    a, b, c, d = high[0, ::4], high[1, ::4], high[0, 2::4], high[1, 2::4]
    e = int(high.max()) + 1 + 2 * np.arange(count)
    corners = [a, b, e + 1, a, e + 1, e, e, e + 1, d, e, d, c]
    return np.concatenate([straight, np.stack(corners, axis=-1).reshape(-1, 3)])


@pytest.mark.parametrize(
    ("faces", "cuts", "edges"),
    [
        (handles(1), "once", "1 edge"),
        (handles(30), "30 times", "30 edges"),
        (strip(5, 1), "once", "1 edge"),
        (strip(40, 6), "once", "6 edges"),  # across
        (strip(6, 12), "once", "6 edges"),  # round it
        (strip(5, 5, closed=True), "2 times", "10 edges"),
        (np.concatenate([strip(8, 2), 24 + strip(9, 3)]), "2 times", "5 edges"),
    ],
)
def test_one_sided_surfaces_are_cut_along_short_loops(
    faces: NDArray[np.int64], cuts: str, edges: str
) -> None:
    count = int(faces.max()) + 1
    turned = np.random.default_rng(2).random(len(faces)) < 0.3
    faces[turned] = faces[turned][:, [0, 2, 1]]
    change = orient(faces, count)
    assert f"cut {cuts}, along {edges}," in change.notes[0]
    np.testing.assert_array_equal(np.sort(change.vertex_map[change.faces]), np.sort(faces))
    points = np.random.default_rng(3).random((len(change.vertex_map), 3))
    audited = counts(points, change.faces)
    assert audited.inconsistent_winding_edges == 0
    assert audited.nonmanifold_edges == audited.nonmanifold_vertices == 0
    again = orient(change.faces, len(points))
    assert not again.turned.any()
    assert len(again.vertex_map) == len(points)


def test_drop_removes_the_lightest_page_of_a_book() -> None:
    points, faces = mesh_arrays(*BOOK)
    assert drop(points, faces, weights=np.array([1, 3, 2])).face_map.tolist() == [1, 2]


def test_debris_is_chosen_by_faces_or_by_weight() -> None:
    points = np.concatenate([TETRAHEDRON[0], BOOK[0] + 9, [[20, 0, 0], [29, 0, 0], [20, 9, 0]]])
    faces = np.concatenate([TETRAHEDRON[1], BOOK[1] + 4, [[9, 10, 11]]])
    points, faces = mesh_arrays(points, faces)
    assert debris(points, faces, least_faces=4).face_map.tolist() == [0, 1, 2, 3]
    by_area = debris(points, faces, least_faces=0, least_share=0.5)
    assert by_area.face_map.tolist() == [7]
    assert by_area.vertex_map.tolist() == [9, 10, 11]
    seen = np.array([0, 0, 0, 0, 9, 9, 9, 0])
    assert debris(points, faces, least_faces=0, least_share=0.1, weights=seen).face_map.tolist() == [4, 5, 6]


def test_close_ignores_outlines_long_rims_and_flipped_winding() -> None:
    points, whole = mesh_arrays(*sphere(12))
    assert len(close(points, whole[12:]).added_from) == 0  # the rim has 12 edges, the limit is 8
    assert len(close(points, whole[12:], most_edges=12).added_from) == 0  # an open bowl: the cap is too large
    assert len(close(points, whole[12:], most_edges=12, most_share=1).added_from) == 12
    flipped = whole[1:].copy()
    flipped[0] = flipped[0, ::-1]
    assert len(close(points, flipped).added_from) == 0
    assert len(close(*mesh_arrays(np.eye(3), np.array([[0, 1, 2]]))).added_from) == 0


def test_close_avoids_diagonals_that_are_edges() -> None:
    points = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, -9], [9, 9, 9], [9, 9, 8]], float)
    cone = [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]
    diagonal = [[0, 2, 5]]
    for rows_, added in ((cone, 2), (cone + diagonal, 2), (cone + diagonal + [[1, 3, 6]], 4)):
        mesh = mesh_arrays(points, np.array(rows_))
        change = close(*mesh)
        assert len(change.added_from) == added
        assert counts(places(points, change), change.faces).nonmanifold_edges == 0

"""The repair steps compared with their twins, plain loops and dictionaries, on random meshes."""

from typing import Any

import numpy as np
import pytest

from msb.topology.arrays import mesh_arrays
from msb.topology.halfedge import NONE
from msb.topology.steps import Change, close, cut, debris, drop, orient, pair, weld
from tests.topology import repair_twins as twins
from tests.topology.brute_force import edge_faces
from tests.topology.meshes import Mesh, counts, finite_mesh, sphere


def rows(faces: np.ndarray) -> list[Any]:
    return [tuple(row) for row in faces.tolist()]


def corner_numbers(faces: np.ndarray, change: Change) -> dict[tuple[int, int], int]:
    """Return the new vertex of each corner (face, old vertex) of the proper faces."""
    return {
        (f, v): new
        for f, (row, after) in enumerate(zip(faces.tolist(), change.faces.tolist(), strict=True))
        if len(set(row)) == 3
        for v, new in zip(row, after, strict=True)
    }


def twins_numbers(points: np.ndarray, faces: np.ndarray, number: dict[Any, int]) -> dict[Any, int]:
    """Return the vertex numbers of a twin.

    The numbers are shifted, because the twin does not count unreferenced vertices.
    """
    used = 1 + int(faces.max(initial=-1))
    return {corner: new if new < used else new + len(points) - used for corner, new in number.items()}


def test_orient_equals_its_twin() -> None:
    for seed in range(150):
        points, faces = finite_mesh(seed)
        change = orient(faces, len(points))
        turned, strange = twins.orient(rows(faces))
        if not strange:
            assert change.turned.tolist() == turned, seed
            assert counts(points, change.faces).inconsistent_winding_edges == 0
        assert bool(change.notes) == strange, seed


def test_cut_equals_its_twin() -> None:
    for seed in range(150):
        points, faces = finite_mesh(seed)
        change = cut(faces, len(points))
        expected = twins_numbers(points, faces, twins.cut(rows(faces)))
        assert corner_numbers(faces, change) == expected, seed


def test_pair_equals_its_twin() -> None:
    for seed in range(1, 241, 2):  # vertices in general position, so that all costs differ
        points, faces = finite_mesh(seed)
        if counts(points, faces).duplicate_faces:
            continue
        colors = np.random.default_rng(seed).random(points.shape)
        change = pair(points, faces, vertex_colors=colors)
        number = twins.pair(points.tolist(), rows(faces), colors.tolist(), 0.25)
        expected = twins_numbers(points, faces, number)
        assert corner_numbers(faces, change) == expected, seed


def test_drop_removes_few_faces_and_restores_all_that_fit() -> None:
    more = 0
    for seed in range(100):
        points, faces = finite_mesh(seed)
        change = drop(points, faces)
        removed = len(faces) - len(change.faces)
        more += removed - twins.fewest_dropped(rows(faces)) if len(faces) <= 12 else 0
        left = edge_faces(rows(faces), twins.proper_faces(rows(faces)))
        gone = set(range(len(faces))) - set(change.face_map.tolist())
        for f in gone:
            assert any(f in group and len(set(group) - gone) >= 2 for group in left.values()), seed
    assert more <= 5


def test_weld_equals_its_twin() -> None:
    for seed in range(0, 300, 2):  # integer coordinates, so that positions coincide
        points, faces = finite_mesh(seed)
        change = weld(points, faces)
        stay, corners = twins.weld(rows(points), rows(faces))
        assert change.face_map.tolist() == stay, seed
        assert rows(change.vertex_map[change.faces]) == corners, seed


@pytest.mark.parametrize(("least_faces", "least_share"), [(3, 0.0), (0, 0.2), (2, 0.1)])
def test_debris_equals_its_twin(least_faces: int, least_share: float) -> None:
    for seed in range(1, 300, 2):  # vertices in general position: no piece has exactly the share
        points, faces = finite_mesh(seed)
        change = debris(points, faces, least_faces=least_faces, least_share=least_share)
        stay = twins.debris(rows(points), rows(faces), least_faces, least_share)
        assert change.face_map.tolist() == stay, seed
        assert rows(change.vertex_map[change.faces]) == [rows(faces)[f] for f in stay], seed


def torn_sphere(seed: int) -> Mesh:
    """Return a sphere without some faces, with some faces reversed, beside a random mesh."""
    rng = np.random.default_rng(seed)
    points, faces = sphere(int(rng.integers(3, 12)))
    faces = faces[rng.random(len(faces)) < rng.uniform(0.5, 0.95)]
    over = rng.random(len(faces)) < 0.04
    faces[over] = faces[over, ::-1]
    beside, more = finite_mesh(2 * seed + 1)
    points = points + rng.normal(0, 0.05, points.shape)
    return mesh_arrays(np.concatenate([points, beside]), np.concatenate([faces, more + len(points)]))


def test_close_equals_its_twin() -> None:
    closed = 0
    for seed in range(200):
        points, faces = torn_sphere(seed)
        change = close(points, faces, most_edges=6)
        rims = twins.holes(rows(points), rows(faces), 6, 0.25)
        added = change.faces[change.face_map == NONE]
        sides = {(b, a) for row in rows(added) for a, b in zip(row, (*row[1:], row[0]), strict=True)}
        rim_edges = {edge for rim in rims for edge in rim}
        inside = {(a, b) for a, b in sides if (b, a) in sides or max(a, b) >= len(points)}
        assert sides - inside == rim_edges - inside, seed
        least = sum(1 if len(rim) == 3 else 2 if len(rim) == 4 else len(rim) for rim in rims)
        assert least <= len(added) <= least + 2 * sum(len(rim) == 4 for rim in rims), seed
        closed += len(rims)
    assert closed > 40

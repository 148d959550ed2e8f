"""Fairing removes dents, keeps creases, and equals a slow twin."""

import numpy as np
import pytest

from data_stubs.surface import icosphere
from msb.bake.arrays import Floats, Ints
from msb.bake.fairing import fair, filter_normals, find_neighbours, follow_normals
from msb.bake.shape import measure_bending
from msb.topology.faces import signed_volume


def normals_of(points: Floats, faces: Ints) -> Floats:
    corners = points[faces]
    vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def dented(points: Floats, size: float) -> Floats:
    return points + size * np.random.default_rng(3).standard_normal(points.shape)


def box(parts: int) -> tuple[Floats, Ints]:
    """Return the surface of the unit cube as a grid of `parts` squares along a side."""
    grid = np.stack(np.meshgrid(*[np.arange(parts + 1.0)] * 2, indexing="ij"), axis=-1).reshape(-1, 2)
    a = (np.arange(parts)[:, None] * (parts + 1) + np.arange(parts)).reshape(-1)
    side = np.concatenate(
        [np.stack([a, a + parts + 1, a + 1], 1), np.stack([a + 1, a + parts + 1, a + parts + 2], 1)]
    )
    points, faces = [], []
    for axis in range(3):
        for end in (0, parts):
            placed = np.insert(grid, axis, end, axis=1)
            # Insertion at axis 1 mirrors the grid, and the far side faces the other way.
            is_turned = (axis == 1) != (end == 0)
            faces.append((side[:, ::-1] if is_turned else side) + sum(map(len, points)))
            points.append(placed)
    merged, number = np.unique(np.concatenate(points), axis=0, return_inverse=True)
    return merged / parts, number.reshape(-1)[np.concatenate(faces)].astype(np.int64)


def test_the_filter_equals_a_loop_over_faces_that_share_a_vertex() -> None:
    points, faces = icosphere(2)
    points = dented(points, 0.05)
    corners, normals = points[faces], normals_of(points, faces)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    centers = corners.mean(axis=1)
    expected = []
    for face in range(len(faces)):
        around = [j for j in range(len(faces)) if set(faces[j]) & set(faces[face])]
        squares = np.square(centers[around] - centers[face]).sum(axis=1)
        weights = areas[around] * np.exp(
            -squares / (2 * squares.mean()) - np.square(normals[around] - normals[face]).sum(axis=1) / 0.5
        )
        expected.append(weights @ normals[around])
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    found = filter_normals(points, faces, find_neighbours(faces, len(points)), 1)
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_vertices_move_to_the_planes_of_their_faces() -> None:
    points, faces = icosphere(2)
    target = np.tile((0.0, 0.0, 1.0), (len(faces), 1))
    moved = follow_normals(points, faces, target)
    offsets = points[faces].mean(axis=1)[:, 2]
    expected = [offsets[(faces == vertex).any(axis=1)].mean() for vertex in range(len(points))]
    np.testing.assert_allclose(moved[:, :2], points[:, :2])
    np.testing.assert_allclose(moved[:, 2], expected)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_dents_of_a_ball_vanish(scale: float) -> None:
    points, faces = icosphere(8)
    rough = dented(points, 0.015)
    smooth = fair(scale * rough, faces) / scale
    before, after = (
        np.degrees(np.arccos((normals_of(part, faces) * normals_of(points, faces)).sum(axis=1))).mean()
        for part in (rough, smooth)
    )
    assert after < before / 3
    assert signed_volume(smooth, faces) == pytest.approx(signed_volume(points, faces), rel=0.03)


def test_the_edges_of_a_box_stay_sharp() -> None:
    points, faces = box(8)
    smooth = fair(dented(points, 0.008), faces)
    everything = np.ones(len(faces), bool)
    # Without dents, bending and creases of a cube are pi and 2 for a size of 1.
    shape = measure_bending(smooth, faces, everything)
    assert shape.bending == pytest.approx(np.pi, rel=0.15)
    assert shape.creases == pytest.approx(2, rel=0.1)
    np.testing.assert_allclose(np.abs(smooth - 0.5).max(axis=1), 0.5, atol=0.03)

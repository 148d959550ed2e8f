"""Small charts of a texture are merged without overlaps, and faces keep their sizes."""

import numpy as np
import pytest

from data_stubs.surface import icosphere
from msb.bake.arrays import Floats, Ints
from msb.bake.chart_merging import MIN_CHART_FACES, merge_small_charts
from tests.bake.test_fairing import box


def flatten(points: Floats, faces: Ints) -> Floats:
    """Return each face alone in a plane (F, 3, 2), without distortion, counter-clockwise."""
    corners = points[faces]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1)
    x = (first * second).sum(axis=1) / length
    y = np.linalg.norm(np.cross(first, second), axis=1) / length
    zero = np.zeros(len(faces))
    return np.stack([np.stack([zero, zero], 1), np.stack([length, zero], 1), np.stack([x, y], 1)], axis=1)


def signed_areas(corners: Floats) -> Floats:
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2


def count_overlaps(corners: Floats, chart: Ints) -> int:
    """Return how many points inside of faces lie inside another face of the same chart."""
    inner = np.array([(0.6, 0.2, 0.2), (0.2, 0.6, 0.2), (0.2, 0.2, 0.6), (1 / 3, 1 / 3, 1 / 3)])
    count = 0
    for label in np.unique(chart):
        faces = corners[chart == label]
        for number, point in enumerate((inner @ faces).reshape(-1, 2)):
            sides = np.roll(faces, -1, axis=1) - faces
            away = point - faces
            cross = sides[..., 0] * away[..., 1] - sides[..., 1] * away[..., 0]
            size = np.abs(sides).max(axis=(1, 2))[:, None] ** 2
            inside = (cross > 0.02 * size).all(axis=1) | (cross < -0.02 * size).all(axis=1)
            inside[number // len(inner)] = False
            count += int(inside.sum())
    return count


def test_the_strips_of_a_plane_become_one_chart() -> None:
    points, faces = box(8)
    top = faces[(points[faces][:, :, 2] == 1).all(axis=1)]
    row = (points[top].mean(axis=1)[:, 0] * 8).astype(int)
    # Each row is a chart of its own, turned by another angle.
    angle = 0.7 * row
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], axis=1).reshape(-1, 2, 2)
    plane = np.einsum("fij,fkj->fki", turn, points[top][:, :, :2])
    corners, chart = merge_small_charts(points, top, plane, row.astype(np.int64))
    assert len(np.unique(chart)) == 1
    places = {
        (vertex, *np.round(place, 9))
        for vertex, place in zip(top.reshape(-1), corners.reshape(-1, 2), strict=True)
    }
    assert len(places) == 81, "no vertex has two places"
    np.testing.assert_allclose(signed_areas(corners), 1 / 128)


@pytest.mark.parametrize("shape", ["ball", "box", "rough"])
@pytest.mark.slow
def test_single_faces_become_charts_without_overlaps(shape: str) -> None:
    points, faces = box(6) if shape == "box" else icosphere(6)
    if shape == "rough":
        points = points + 0.05 * np.random.default_rng(2).standard_normal(points.shape)
    plane = flatten(points, faces)
    corners, chart = merge_small_charts(points, faces, plane, np.arange(len(faces)))
    assert len(np.unique(chart)) < len(faces) / 10
    assert np.bincount(chart).min() > 1, "no chart is a single face"
    assert count_overlaps(corners, chart) == 0
    ratio = signed_areas(corners) / signed_areas(plane)
    assert 0.04 < ratio.min() <= ratio.max() < 2.1
    assert np.median(ratio) == pytest.approx(1, abs=0.4)


def test_large_charts_stay_as_they_are() -> None:
    points, faces = box(8)
    side = np.abs(points[faces].mean(axis=1) - 0.5).argmax(axis=1)
    plane = np.delete(points[faces], 2, axis=2)
    keep = side == 2
    corners, chart = merge_small_charts(points, faces[keep], plane[keep], side[keep])
    assert keep.sum() >= MIN_CHART_FACES
    np.testing.assert_array_equal(corners, plane[keep])
    # The two opposite sides are two charts, because no edge connects them.
    height = points[faces[keep]].mean(axis=1)[:, 2]
    np.testing.assert_array_equal(chart == chart[0], height == height[0])


def test_a_lone_face_takes_over_a_neighbour() -> None:
    points, faces = box(8)
    top = faces[(points[faces][:, :, 2] == 1).all(axis=1)]
    # A face in the middle of a large chart is cut out and lies elsewhere, so it fits into its old place; a
    # chart that covers this place as well prevents that.
    plane = points[top][:, :, :2].copy()
    lone = int(np.linalg.norm(plane.mean(axis=1) - 0.5, axis=1).argmin())
    plane[lone] += 5
    others = np.delete(np.arange(len(top)), lone)
    covered = np.concatenate([plane, points[top[[lone]]][:, :, :2]])
    shifted = np.concatenate([points, points[top[lone]] + [0, 0, 1e-3]])
    extra = np.concatenate([top, len(points) + np.arange(3)[None]])
    chart = np.zeros(len(extra), np.int64)
    chart[lone] = 1
    corners, merged = merge_small_charts(shifted, extra, covered, chart)
    assert np.bincount(merged)[merged[lone]] == 2
    assert np.bincount(merged)[merged[others]].max() == len(top) - 2
    np.testing.assert_allclose(np.abs(signed_areas(corners[: len(top)])), 1 / 128)

"""Tiles and compositing against loops over single samples and faces."""

import numpy as np
import pytest

from msb.reference.blend import Composite, Layers, Rule, composite, expected_depth
from msb.reference.tiles import Rectangles, Tile, grid_size, tile_number, tiles_front_to_back

RULES = [Rule(crossing, first) for crossing in (True, False) for first in (True, False)]
F = np.float32


def composite_sample(
    alphas: np.ndarray, colors: np.ndarray, depths: np.ndarray, rule: Rule
) -> tuple[object, ...]:
    """Composite faces front to back in a loop: colour, depth, T, median depth and face."""
    color, depth, t, median, face = np.zeros(3, F), F(0), F(1), F(0), -1
    for number, alpha in enumerate(alphas):
        if alpha < F(1) / F(255):
            continue
        after = t * (F(1) - alpha)
        if not rule.blends_crossing and after < F(1e-4):
            break
        weight = alpha * t
        color = color + (colors[number] * weight if rule.weight_first else colors[number] * alpha * t)
        depth = depth + depths[number] * weight
        if t > F(0.5):
            median, face = depths[number], number
        t = after
        if rule.blends_crossing and t <= F(1e-4):
            break
    return color, depth, t, median, face


def blend_columns(alphas: np.ndarray, colors: np.ndarray, depths: np.ndarray, rule: Rule) -> Composite:
    """Composite K faces at P samples of one tile, with P at most 16."""
    faces, samples = alphas.shape
    tile = Tile(np.arange(samples), np.zeros(samples, np.int64), np.arange(faces))

    def cover(chosen: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        assert x.dtype == y.dtype == F
        return alphas[chosen, x.astype(int)]

    def shade(chosen: np.ndarray, x: np.ndarray, y: np.ndarray) -> Layers:
        return Layers(colors[chosen], depths[chosen], np.zeros((len(chosen), 3), F))

    return composite([tile], cover, shade, rule, samples, 1, np.float32)


@pytest.mark.slow
@pytest.mark.parametrize("rule", RULES, ids=str)
@pytest.mark.parametrize(
    ("faces", "scale"), [(1, 1.0), (7, 1.0), (32, 0.3), (33, 0.5), (100, 0.1), (500, 0.02)]
)
def test_composite_equals_the_loop(rule: Rule, faces: int, scale: float) -> None:
    """The results are bit-identical, even if there are more faces than are evaluated at once, or samples stop
    early.
    """
    rng = np.random.default_rng(faces)
    alphas = np.minimum(rng.random((faces, 16)) * scale, 0.99).astype(F)
    alphas[rng.random(alphas.shape) < 0.3] = 0
    colors, depths = rng.random((faces, 3)).astype(F), (1 + rng.random(faces)).astype(F)
    image = blend_columns(alphas, colors, depths, rule)
    for sample in range(16):
        color, depth, t, median, face = composite_sample(alphas[:, sample], colors, depths, rule)
        np.testing.assert_array_equal(image.color[0, sample], color)
        assert image.depth[0, sample] == depth
        assert image.transmittance[0, sample] == t
        assert image.depth_median[0, sample] == median
        assert image.face_median[0, sample] == face


def test_a_face_is_shaded_only_where_it_is_blended() -> None:
    """Outside a face its depth and colour may be infinite, and 0 times infinity is NaN."""
    alphas = np.array([[0.5, 0.001, 0], [0.9999, 0, 0], [0.5, 0.5, 0]], F)
    shaded = []

    def shade(chosen: np.ndarray, x: np.ndarray, y: np.ndarray) -> Layers:
        shaded.extend(zip(chosen.tolist(), x.tolist(), y.tolist(), strict=True))
        return Layers(np.ones((len(chosen), 3), F), np.ones(len(chosen), F), np.ones((len(chosen), 3), F))

    tile = Tile(np.arange(3), np.zeros(3, np.int64), np.arange(3))
    composite([tile], lambda faces, x, y: alphas[faces, x.astype(int)], shade, RULES[2], 3, 1, np.float32)
    assert sorted(shaded) == [(0, 0, 0), (2, 1, 0)]


def test_expected_depth_of_empty_samples_is_zero() -> None:
    depth, alpha = np.array([0.0, 3.0], F), np.array([0.0, 0.5], F)
    np.testing.assert_array_equal(expected_depth(depth, alpha), [0, 6])


def test_tile_numbers_saturate_as_on_a_gpu() -> None:
    limit = np.array([5, 3])
    values = np.array([[-1e30, 1e30], [np.nan, -0.9], [np.inf, -np.inf], [2.99, 0.0]], F)
    with np.errstate(invalid="ignore"):
        np.testing.assert_array_equal(tile_number(values, limit), [[0, 3], [0, 0], [5, 0], [2, 0]])


@pytest.mark.parametrize(("width", "height"), [(1, 1), (16, 16), (17, 15), (50, 33)])
def test_tiles_list_the_faces_of_their_rectangles_front_to_back(width: int, height: int) -> None:
    rng = np.random.default_rng(width)
    grid = grid_size(width, height)
    low = rng.integers(0, grid + 1, (40, 2))
    rectangles = Rectangles(low, np.minimum(low + rng.integers(0, 3, (40, 2)), grid))
    depth = rng.integers(1, 6, 40).astype(F)
    kept = rng.random(40) < 0.8
    listed = {}
    for tile in tiles_front_to_back(rectangles, depth, kept, width, height):
        at = (int(tile.columns[0]) // 16, int(tile.rows[0]) // 16)
        listed[at] = tile
    for x in range(int(grid[0])):
        for y in range(int(grid[1])):
            inside = (rectangles.low <= (x, y)).all(axis=1) & ((x, y) < rectangles.high).all(axis=1) & kept
            wanted = sorted(np.flatnonzero(inside).tolist(), key=lambda face: (depth[face], face))
            if not wanted:
                assert (x, y) not in listed
                continue
            tile = listed.pop((x, y))
            assert tile.faces.tolist() == wanted
            samples = {
                (i, j)
                for i in range(16 * x, min(16 * x + 16, width))
                for j in range(16 * y, min(16 * y + 16, height))
            }
            assert set(zip(tile.columns.tolist(), tile.rows.tolist(), strict=True)) == samples
            assert len(tile.columns) == len(samples)
    assert not listed


def test_depths_are_compared_as_float32() -> None:
    rectangles = Rectangles(np.zeros((2, 2), int), np.ones((2, 2), int))
    depth = np.array([1 + 1e-12, 1.0])
    (tile,) = tiles_front_to_back(rectangles, depth, np.ones(2, bool), 4, 4)
    assert tile.faces.tolist() == [0, 1]


def test_rectangles_with_a_product_of_zero_are_empty() -> None:
    """Official kernels multiply unsigned extents, so a rectangle with two negative extents is not empty."""
    low, high = np.array([[0, 0], [1, 0], [3, 2]]), np.array([[1, 2], [1, 2], [0, 0]])
    np.testing.assert_array_equal(Rectangles(low, high).empty, [False, True, False])
    listed = list(tiles_front_to_back(Rectangles(low, high), np.ones(3, F), np.ones(3, bool), 40, 40))
    assert all(2 not in tile.faces for tile in listed)

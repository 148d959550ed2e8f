"""Atlases: faces fit, stay separate in smaller mip levels, and get texels in proportion to their pixels."""

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.asset.texture import Sampler, mip_levels, sample
from msb.bake import atlas, chart_merging
from msb.bake.atlas import make_chart_atlas, make_soup_atlas, unwrap_in_child
from msb.base.extras import is_installed
from msb.errors import UsageError

CLAMP = Sampler("linear", mipmaps=True, wrap_u="clamp", wrap_v="clamp")
NEEDS_XATLAS = pytest.mark.skipif(not is_installed("xatlas"), reason="xatlas is not installed")


def random_pixels(count: int, largest: float) -> NDArray[np.float64]:
    """Return random numbers of pixels from 0 to `largest`; a fifth of them is 0."""
    rng = np.random.default_rng(3)
    return np.where(rng.random(count) < 0.2, 0, largest ** rng.random(count))


def triangles(count: int) -> NDArray[np.float64]:
    """Return the corners of triangles of all shapes; the first one is a point."""
    corners = np.random.default_rng(4).normal(size=(count, 3, 3))
    corners[0] = 1
    return corners


def texel_areas(uvs: NDArray[np.float32], size: int) -> NDArray[np.float64]:
    """Return the number of texels of each face."""
    corners = uvs.reshape(-1, 3, 2).astype(np.float64) * size
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2)


def points_inside(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a grid of points of a triangle (3, 2), including its corners and edges."""
    a, b = np.meshgrid(np.linspace(0, 1, 25), np.linspace(0, 1, 25))
    a, b = a[a + b <= 1 + 1e-9], b[a + b <= 1 + 1e-9]
    return np.stack([1 - a - b, a, b], axis=1).clip(0, 1) @ corners


@pytest.mark.slow
@pytest.mark.parametrize(("largest", "last"), [(60.0, 2), (2000.0, 1)])
def test_no_mip_level_mixes_two_faces(largest: float, last: int) -> None:
    """Faces are separate in three levels if there is room for all requested texels, else in two."""
    size, count = 256, 200
    uvs = make_soup_atlas(triangles(count), random_pixels(count, largest), size)
    faces = np.flatnonzero(texel_areas(uvs, size))
    assert len(faces) > count // 2
    corners = uvs.reshape(-1, 3, 2).astype(np.float64)
    # Blacken all texels that other faces sample in the last level; a face must sample white only.
    points = [points_inside(corners[face]) for face in faces]
    for number in range(0, len(faces), 7):
        image = np.full((size, size, 3), 255, np.uint8)
        for other, others in enumerate(points):
            if other != number:
                blacken(image, others * size, 1 << last)
        levels = mip_levels(image)
        for lod in range(last + 1):
            values = sample(levels, points[number], CLAMP, np.full(len(points[number]), float(lod)))
            assert values.min() > 0.98, (faces[number], lod)


def blacken(image: NDArray[np.uint8], points: NDArray[np.float64], block: int) -> None:
    """Blacken the blocks of texels that contain one of `points`, which are in texels."""
    corner = (points / block).astype(int).clip(0, image.shape[0] // block - 1) * block
    for left, top in np.unique(corner, axis=0):
        image[top : top + block, left : left + block] = 0


def test_faces_get_a_texel_per_pixel_if_there_is_room() -> None:
    pixels = random_pixels(300, 900.0)
    roomy, short = (texel_areas(make_soup_atlas(triangles(300), pixels, size), size) for size in (1024, 128))
    assert (roomy[pixels == 0] == 0).all()
    large = pixels > 200
    assert np.abs(np.sqrt(roomy[large] / pixels[large]) - 1).max() < 0.2
    factor = np.sqrt(short[large] / pixels[large])
    assert 0.2 < factor.min() < factor.max() < 0.7


def test_legs_have_the_ratio_of_the_shorter_sides() -> None:
    corners = np.array([[[0, 0, 0], [3, 0, 0], [0, 1, 0]], [[0, 5, 0], [0, 0, 0], [2, 0, 0]]], float)
    uvs = make_soup_atlas(corners, np.full(2, 9000.0), 512).reshape(-1, 3, 2) * 512
    legs = np.linalg.norm(uvs - np.roll(uvs, 1, axis=1), axis=2)  # to the previous corner
    assert legs[0, 1] / legs[0, 0] == pytest.approx(3, rel=0.1)
    assert legs[0, 2] == pytest.approx(np.hypot(legs[0, 0], legs[0, 1]))
    assert legs[1, 1] / legs[1, 2] == pytest.approx(2.5, rel=0.1)


def test_cells_of_a_soup_do_not_overlap() -> None:
    size = 128
    uvs = make_soup_atlas(triangles(500), random_pixels(500, 50.0), size)
    corners = uvs.reshape(-1, 3, 2).astype(np.float64) * size
    assert len(np.unique(np.floor(corners.mean(axis=1)), axis=0)) == 500
    assert corners.min() > 0
    assert corners.max() < size


def test_a_soup_needs_a_texel_per_face() -> None:
    uvs = make_soup_atlas(triangles(64 * 64), np.full(64 * 64, 9.0), 64)
    assert len(np.unique(uvs, axis=0)) == 64 * 64
    with pytest.raises(UsageError) as caught:
        make_soup_atlas(triangles(64 * 64 + 1), np.full(64 * 64 + 1, 9.0), 64)
    assert caught.value.code == "USAGE"


@pytest.mark.slow
@NEEDS_XATLAS
def test_charts_are_scaled_by_their_pixels() -> None:
    """One of two equal squares has 9 times the pixels and gets 9 times the texels."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    vertices = np.concatenate([square, square + np.float32([0, 0, 5])])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    uvs = make_chart_atlas(vertices, faces, np.array([450.0, 450, 50, 50]), 256)
    assert uvs.shape == (12, 2)
    assert uvs.min() >= 0
    assert uvs.max() <= 1
    near, _, far, _ = texel_areas(uvs, 256)
    assert near / far == pytest.approx(9, rel=0.1)
    assert near > 5000


@NEEDS_XATLAS
def test_blocks_that_are_cut_separately_fit_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """The faces of a flat sheet keep their shape in all blocks, and none overlap."""
    monkeypatch.setattr(atlas, "UNWRAP_FACES", 30)
    monkeypatch.setattr(chart_merging, "MIN_CHART_FACES", 0)
    row, column = np.mgrid[0:9, 0:13]
    vertices = np.stack([column, row, 0 * row], axis=-1).reshape(-1, 3).astype(np.float32)
    first = (np.arange(8)[:, None] * 13 + np.arange(12)).reshape(-1)
    faces = np.stack([first, first + 1, first + 14, first, first + 14, first + 13], axis=1).reshape(-1, 3)
    arrays = {"vertices": vertices, "faces": faces.astype(np.uint32), "pixels": np.full(len(faces), 50.0)}
    info, result = unwrap_in_child("256", arrays)
    assert 8 <= info["charts"] <= 16  # 192 faces in 8 connected blocks of 24
    texels = texel_areas(result["uv"], 256)
    assert texels.min() > 0.8 * texels.max()
    sides = np.linalg.norm(np.diff(result["uv"].reshape(-1, 3, 2)[:, [0, 1, 2, 0]], axis=1), axis=2)
    shortest, _, longest = np.sort(sides, axis=1).T
    np.testing.assert_allclose(longest / shortest, np.sqrt(2), rtol=0.1)
    drawn = np.zeros((256, 256), int)
    y, x = np.mgrid[0:256, 0:256] + 0.5
    for a, b, c in 256 * result["uv"].reshape(-1, 3, 2).astype(float):
        edges = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        drawn += np.all(np.sign(edges) > 0, axis=0) | np.all(np.sign(edges) < 0, axis=0)
    assert drawn.max() == 1


@pytest.mark.slow
@NEEDS_XATLAS
def test_a_face_without_area_takes_no_room() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    uvs = make_chart_atlas(vertices, faces, np.array([100.0, 100, 0]), 64)
    assert np.isfinite(uvs).all()
    assert (texel_areas(uvs, 64)[:2] > 500).all()

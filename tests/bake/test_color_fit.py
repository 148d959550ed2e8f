"""Colours by least squares against SciPy's dense solvers, and blending weights over several views."""

from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

import msb
from msb.asset import Asset
from msb.bake.blending_weights import measure_blending_weights
from msb.bake.color_fit import (
    PRIOR,
    SMOOTHNESS,
    extend_colors,
    fit_mesh_colors,
    fit_soup_colors,
    make_edge_laplacian,
)
from msb.bake.images import ViewImages
from msb.bake.soup_renderer import FaceSums
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.methods.diffsoup.native import Pipeline
from msb.render.splat.pipeline import SplattingPipeline
from msb.scenes import Camera
from tests.cl.conftest import SELECTOR
from tests.reference.soups import front_camera, random_triangles, soup

FAN = np.array([[0, 1, 2], [2, 1, 3], [3, 1, 4], [1, 0, 4], [0, 1, 2]])
"""Make four faces around a vertex, and one of them a second time."""
EDGES = [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3), (1, 4), (3, 4), (0, 4)]


def sums_of(
    faces: NDArray[np.int64], colors: NDArray[np.float64], pixels: int, seed: int, tip: float = 1.0
) -> FaceSums:
    """Return sums over random pixels that show vertex `colors`.

    Pixels lie all over each face or in a `tip` of it.
    """
    random = np.random.default_rng(seed)
    weights = random.dirichlet((1, 1, 1), (len(faces), pixels))
    weights = tip * weights + [1 - tip, 0, 0]
    seen_colors = np.einsum("fpi,fic->fpc", weights, colors[faces])
    products = np.einsum("fpi,fpj->fij", weights, weights)[:, *np.triu_indices(3)]
    targets = np.einsum("fpi,fpc->fic", weights, seen_colors).reshape(len(faces), 9)
    sums = np.concatenate([products, targets], axis=1).astype(np.float32)
    return FaceSums(sums, np.full(len(faces), pixels, np.uint32), np.zeros((len(faces), 3, 3), np.float32))


def solve_densely(
    faces: NDArray[np.int64], laplacian: NDArray[np.float64], sums: FaceSums, before: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Return the best vertex colours in [0, 1] by a dense solver."""
    count = len(before)
    system = SMOOTHNESS * laplacian + PRIOR * np.eye(count)
    right = PRIOR * before.astype(np.float64)
    for face, row in zip(faces, sums.sums.astype(np.float64), strict=True):
        square = np.zeros((3, 3))
        square[np.triu_indices(3)] = row[:6]
        system[np.ix_(face, face)] += square + np.triu(square, 1).T
        right[face] += row[6:].reshape(3, 3)
    root = np.linalg.cholesky(system)
    solved = [
        lsq_linear(root.T, np.linalg.solve(root, right[:, k]), (0, 1), method="bvls").x for k in range(3)
    ]
    return np.stack(solved, axis=1)


def test_the_laplacian_counts_each_edge_once() -> None:
    expected = np.zeros((5, 5))
    for a, b in EDGES:
        expected[[a, b], [a, b]] += 1
        expected[[a, b], [b, a]] -= 1
    np.testing.assert_array_equal(make_edge_laplacian(FAN, 5).toarray(), expected)
    np.testing.assert_array_equal(make_edge_laplacian(np.array([[0, 0, 1]]), 2).toarray(), [[1, -1], [-1, 1]])


@pytest.mark.parametrize(("spread", "tolerance"), [(0.4, 1e-4), (0.9, 0.02)], ids=["inside", "clamped"])
def test_shared_vertices_get_the_colours_of_a_dense_solver(spread: float, tolerance: float) -> None:
    random = np.random.default_rng(1)
    colors = 0.5 + spread * random.uniform(-1, 1, (5, 3))
    sums, before = sums_of(FAN, colors, 40, 2), random.random((5, 3), np.float32)
    laplacian = make_edge_laplacian(FAN, 5)
    fitted = fit_mesh_colors(sums, FAN, before, laplacian)
    expected = solve_densely(FAN, laplacian.toarray(), sums, before)
    np.testing.assert_allclose(fitted, expected, atol=tolerance)
    assert fitted.min() >= 0
    assert fitted.max() <= 1


def test_faces_of_a_soup_get_the_colours_of_a_dense_solver() -> None:
    random = np.random.default_rng(3)
    faces = np.arange(12).reshape(4, 3)
    sums = sums_of(faces, 0.5 + 0.4 * random.uniform(-1, 1, (12, 3)), 40, 4)
    before = random.random((4, 3, 3), np.float32)
    expected = solve_densely(faces, make_edge_laplacian(faces, 12).toarray(), sums, before.reshape(12, 3))
    np.testing.assert_allclose(fit_soup_colors(sums, before).reshape(12, 3), expected, atol=1e-4)


@pytest.mark.parametrize("is_shared", [False, True])
def test_a_face_with_a_visible_tip_is_not_extrapolated(is_shared: bool) -> None:
    """The visible tip has colours from 0.45 to 0.55.

    If they were extrapolated, the corners would reach 0 and 1.
    """
    faces, tip = np.array([[0, 1, 2]]), 0.05
    colors = 0.5 + np.array([[0.0], [1.0], [-1.0]]) * np.full(3, 0.05 / tip)
    sums, before = sums_of(faces, colors, 40_000, 5, tip), np.full((3, 3), 0.5, np.float32)
    laplacian = make_edge_laplacian(faces, 3)
    if is_shared:
        fitted = fit_mesh_colors(sums, faces, before, laplacian)
    else:
        fitted = fit_soup_colors(sums, before[None])[0]
    assert 0.2 < fitted.min() < 0.45
    assert 0.55 < fitted.max() < 0.8
    unlimited = solve_densely(faces, laplacian.toarray(), sums, before)
    assert (unlimited.min(), unlimited.max()) == (0, 1)


def test_unseen_vertices_continue_the_colours_some_faces_away() -> None:
    faces = np.array([[k, k + 1, k + 2] for k in range(20)])
    before = np.full((22, 3), 0.25, np.float32)
    before[10:] = 1.0
    extended = extend_colors(before, faces, np.where(np.arange(20) < 15, 9.0, 0.0))
    # Faces from 15 on are unseen. Three rings of two faces each beside them are also coloured again.
    np.testing.assert_array_equal(extended[:9], before[:9])
    np.testing.assert_allclose(extended[9:], 0.25, atol=1e-3)


@pytest.mark.parametrize("pixels", [0.0, 1.0])
def test_colours_stay_if_all_or_no_faces_are_seen(pixels: float) -> None:
    before = np.random.default_rng(0).random((5, 3)).astype(np.float32)
    np.testing.assert_array_equal(extend_colors(before, FAN, np.full(len(FAN), pixels)), before)


CAMERAS = front_camera(), front_camera(33, 40)


def draw_noise(camera: Camera) -> np.ndarray:
    return np.random.default_rng(camera.width).random((camera.height, camera.width, 3), np.float32)


@pytest.fixture
def images() -> Any:
    with ViewImages(CAMERAS, (0.0, 0.0, 0.0), draw_noise) as noise:
        yield noise


@pytest.mark.slow
def test_weights_of_a_blended_model_are_sums_over_the_views(images: ViewImages) -> None:
    asset = soup("triangle_splatting", random_triangles(1))
    with closing(SplattingPipeline(asset, device=SELECTOR)) as pipeline:
        sums = sum(pipeline.shares(camera, images.image(k)) for k, camera in enumerate(CAMERAS))
    weights = measure_blending_weights(asset, images, SELECTOR)
    np.testing.assert_array_equal(weights.weight, sums[:, 3])
    np.testing.assert_allclose(weights.color * weights.weight[:, None], sums[:, :3], rtol=1e-12)
    unseen = weights.weight == 0
    assert 0 < unseen.sum() < 40
    assert (weights.color[unseen] == 0.5).all()


def mesh_asset() -> Asset:
    triangles = random_triangles(1)
    return asset_from_mesh(Mesh(triangles.reshape(-1, 3), np.arange(180).reshape(-1, 3)))


@pytest.mark.parametrize(
    ("asset", "tier"), [(soup("diffsoup", random_triangles(1)), "dedicated"), (mesh_asset(), "standard")]
)
def test_weights_of_an_opaque_model_are_its_pixels(asset: Asset, tier: Any, images: ViewImages) -> None:
    weights = measure_blending_weights(asset, images, SELECTOR)
    pixels, sums = np.zeros(60), np.zeros((60, 3))
    for k, camera in enumerate(CAMERAS):
        frame = msb.render(asset, camera, tier=tier, device=SELECTOR)
        for face, color in zip(frame.face_id.ravel(), images.image(k).reshape(-1, 3), strict=True):
            if face >= 0:
                pixels[face] += 1
                sums[face] += color
    assert 5 < (pixels > 0).sum() < 60
    np.testing.assert_array_equal(weights.weight, pixels)
    np.testing.assert_allclose(weights.color * pixels[:, None], sums, rtol=1e-9)
    assert (weights.color[pixels == 0] == 0.5).all()


def test_a_renderer_without_face_numbers_gives_no_weights(
    images: ViewImages, monkeypatch: pytest.MonkeyPatch
) -> None:
    render = Pipeline.render
    monkeypatch.setattr(Pipeline, "render", lambda *args: replace(render(*args), face_id=None))
    assert measure_blending_weights(soup("diffsoup", random_triangles(1)), images, SELECTOR) is None

"""Colours by least squares, held to SciPy's dense solvers; shares of faces over several lessons."""

from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

import msb
from msb.asset import Asset
from msb.bake.colors import PRIOR, SMOOTH, continued, laplacian, of_mesh, of_soup
from msb.bake.lessons import Lessons
from msb.bake.raster import Seen
from msb.bake.shares import blending_shares
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.methods.diffsoup.look import Pipeline
from msb.render.splat.pipeline import SplattingPipeline
from msb.scenes import Camera
from tests.cl.conftest import SELECTOR
from tests.reference.soups import front_camera, random_triangles, soup

FAN = np.array([[0, 1, 2], [2, 1, 3], [3, 1, 4], [1, 0, 4], [0, 1, 2]])
"""Four faces about an edge, one of them twice."""
EDGES = [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3), (1, 4), (3, 4), (0, 4)]


def seen_of(
    faces: NDArray[np.int64], wanted: NDArray[np.float64], views: int, seed: int, tip: float = 1.0
) -> Seen:
    """Return what pixels at random places of the faces, or of a `tip` of each, say of the colours `wanted` at
    vertices."""
    random = np.random.default_rng(seed)
    weights = random.dirichlet((1, 1, 1), (len(faces), views))
    weights = tip * weights + [1 - tip, 0, 0]
    shown = np.einsum("fpi,fic->fpc", weights, wanted[faces])
    squares = np.einsum("fpi,fpj->fij", weights, weights)[:, *np.triu_indices(3)]
    sides = np.einsum("fpi,fpc->fic", weights, shown).reshape(len(faces), 9)
    sums = np.concatenate([squares, sides], axis=1).astype(np.float32)
    return Seen(sums, np.full(len(faces), views, np.uint32), np.zeros((len(faces), 3, 3), np.float32))


def best(
    faces: NDArray[np.int64], edges: NDArray[np.float64], seen: Seen, colors: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Return the colours of vertices in [0, 1] that are best, by a dense solver."""
    count = len(colors)
    system = SMOOTH * edges + PRIOR * np.eye(count)
    right = PRIOR * colors.astype(np.float64)
    for face, sums in zip(faces, seen.sums.astype(np.float64), strict=True):
        square = np.zeros((3, 3))
        square[np.triu_indices(3)] = sums[:6]
        system[np.ix_(face, face)] += square + np.triu(square, 1).T
        right[face] += sums[6:].reshape(3, 3)
    root = np.linalg.cholesky(system)
    found = [
        lsq_linear(root.T, np.linalg.solve(root, right[:, k]), (0, 1), method="bvls").x for k in range(3)
    ]
    return np.stack(found, axis=1)


def test_each_edge_counts_once_however_many_faces_have_it() -> None:
    found = laplacian(FAN, 5).toarray()
    wanted = np.zeros((5, 5))
    for a, b in EDGES:
        wanted[[a, b], [a, b]] += 1
        wanted[[a, b], [b, a]] -= 1
    np.testing.assert_array_equal(found, wanted)
    np.testing.assert_array_equal(laplacian(np.array([[0, 0, 1]]), 2).toarray(), [[1, -1], [-1, 1]])


@pytest.mark.parametrize(("spread", "tolerance"), [(0.4, 1e-4), (0.9, 0.02)], ids=["inside", "at the bounds"])
def test_vertices_that_faces_share_get_the_colours_of_a_dense_solver(spread: float, tolerance: float) -> None:
    random = np.random.default_rng(1)
    wanted = 0.5 + spread * random.uniform(-1, 1, (5, 3))
    seen, before = seen_of(FAN, wanted, 40, 2), random.random((5, 3), np.float32)
    edges = laplacian(FAN, 5)
    found = of_mesh(seen, FAN, before, edges)
    np.testing.assert_allclose(found, best(FAN, edges.toarray(), seen, before), atol=tolerance)
    assert found.min() >= 0
    assert found.max() <= 1


def test_faces_that_share_nothing_get_those_of_their_own_system() -> None:
    random = np.random.default_rng(3)
    faces = np.arange(12).reshape(4, 3)
    seen = seen_of(faces, 0.5 + 0.4 * random.uniform(-1, 1, (12, 3)), 40, 4)
    before = random.random((4, 3, 3), np.float32)
    found = of_soup(seen, before)
    wanted = best(faces, laplacian(faces, 12).toarray(), seen, before.reshape(12, 3))
    np.testing.assert_allclose(found.reshape(12, 3), wanted, atol=1e-4)


@pytest.mark.parametrize("is_shared", [False, True])
def test_a_face_of_which_a_tip_is_seen_is_not_guessed_wildly(is_shared: bool) -> None:
    """At its tip a face goes from 0.45 to 0.55; on at this slope it would reach 0 and 1."""
    faces, tip = np.array([[0, 1, 2]]), 0.05
    wanted = 0.5 + np.array([[0.0], [1.0], [-1.0]]) * np.full(3, 0.05 / tip)
    seen, before = seen_of(faces, wanted, 40_000, 5, tip), np.full((3, 3), 0.5, np.float32)
    found = of_mesh(seen, faces, before, laplacian(faces, 3)) if is_shared else of_soup(seen, before[None])[0]
    assert 0.2 < found.min() < 0.45
    assert 0.55 < found.max() < 0.8
    plain = best(faces, laplacian(faces, 3).toarray(), seen, before)
    assert plain.min() == 0
    assert plain.max() == 1


def test_what_is_not_seen_goes_on_as_what_is_seen_some_faces_away() -> None:
    faces = np.array([[k, k + 1, k + 2] for k in range(20)])
    before = np.full((22, 3), 0.25, np.float32)
    before[10:] = 1.0
    shown = np.where(np.arange(20) < 15, 9.0, 0.0)
    found = continued(before, faces, shown)
    # Faces from 15 on are not shown; three rings of two faces each beside them are left out, too.
    np.testing.assert_array_equal(found[:9], before[:9])
    np.testing.assert_allclose(found[9:], 0.25, atol=1e-3)


@pytest.mark.parametrize("pixels", [0.0, 1.0])
def test_where_all_is_seen_or_nothing_colours_stay(pixels: float) -> None:
    before = np.random.default_rng(0).random((5, 3)).astype(np.float32)
    np.testing.assert_array_equal(continued(before, FAN, np.full(len(FAN), pixels)), before)


CAMERAS = front_camera(), front_camera(33, 40)


def noise(camera: Camera) -> np.ndarray:
    return np.random.default_rng(camera.width).random((camera.height, camera.width, 3), np.float32)


@pytest.fixture
def lessons() -> Any:
    with Lessons(CAMERAS, (0.0, 0.0, 0.0), noise) as made:
        yield made


def test_shares_of_a_blended_model_are_sums_over_the_views(lessons: Lessons) -> None:
    asset = soup("triangle_splatting", random_triangles(1))
    with closing(SplattingPipeline(asset, device=SELECTOR)) as pipeline:
        sums = sum(pipeline.shares(camera, lessons.image(k)) for k, camera in enumerate(CAMERAS))
    shares = blending_shares(asset, lessons, SELECTOR)
    np.testing.assert_array_equal(shares.weight, sums[:, 3])
    np.testing.assert_allclose(shares.color * shares.weight[:, None], sums[:, :3], rtol=1e-12)
    unseen = shares.weight == 0
    assert 0 < unseen.sum() < 40
    assert (shares.color[unseen] == 0.5).all()


def of_a_mesh() -> Asset:
    triangles = random_triangles(1)
    return asset_from_mesh(Mesh(triangles.reshape(-1, 3), np.arange(180).reshape(-1, 3)))


@pytest.mark.parametrize(
    ("asset", "tier"), [(soup("diffsoup", random_triangles(1)), "dedicated"), (of_a_mesh(), "standard")]
)
def test_shares_of_an_opaque_model_are_the_pixels_it_shows(asset: Asset, tier: Any, lessons: Lessons) -> None:
    shares = blending_shares(asset, lessons, SELECTOR)
    pixels, sums = np.zeros(60), np.zeros((60, 3))
    for k, camera in enumerate(CAMERAS):
        frame = msb.render(asset, camera, tier=tier, device=SELECTOR)
        for face, color in zip(frame.face_id.ravel(), lessons.image(k).reshape(-1, 3), strict=True):
            if face >= 0:
                pixels[face] += 1
                sums[face] += color
    assert 5 < (pixels > 0).sum() < 60
    np.testing.assert_array_equal(shares.weight, pixels)
    np.testing.assert_allclose(shares.color * pixels[:, None], sums, rtol=1e-9)
    assert (shares.color[pixels == 0] == 0.5).all()


def test_a_look_that_does_not_say_which_face_a_pixel_shows_has_none(
    lessons: Lessons, monkeypatch: pytest.MonkeyPatch
) -> None:
    render = Pipeline.render
    monkeypatch.setattr(Pipeline, "render", lambda *of: replace(render(*of), face_id=None))
    assert blending_shares(soup("diffsoup", random_triangles(1)), lessons, SELECTOR) is None

"""Compare how an engine samples triangles with a linear system that is solved for every sample."""

from typing import Any

import numpy as np
import pytest

from msb.methods.two_dts.reference import MAX_ECCENTRICITY, coverage_alpha, reach
from msb.reference import render_reference
from msb.reference.blend import MIN_TRANSMITTANCE
from msb.reference.camera_matrices import splatting_camera
from msb.reference.engine import NEAR, EngineTriangles, project_engine
from tests.reference.golden import View, exported, golden_views, names
from tests.reference.soups import METHODS, SPLATTING, constant_color, front_camera, random_triangles, soup

F = np.float64
CAMERAS = [front_camera(41, 29), front_camera(40, 28, cx=26.5, cy=9.25)]


def around_the_camera(seed: int, count: int = 150) -> np.ndarray:
    """Return triangles in front of, across and behind the camera, large and small."""
    rng = np.random.default_rng(seed)
    size = np.exp(rng.uniform(-2, 1.5, (count, 1, 1)))
    return rng.normal(0, 1, (count, 1, 3)) * (1, 1, 2) + (0, 0, 1) + size * rng.normal(0, 1, (count, 3, 3))


def project(triangles: np.ndarray, camera: Any, incentre: bool = True) -> EngineTriangles:
    view = splatting_camera(camera, 0.01, 100.0, F)
    with np.errstate(all="ignore"):  # like `render_reference`, for triangles that are dropped
        return project_engine(triangles, view, incentre=incentre)


def rays(camera: Any) -> np.ndarray:
    """Return the directions, with z = 1, of all pixel centres: (H, W, 3)."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    return np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("incentre", [True, False])
def test_fragments_are_where_rays_meet_triangles(camera: Any, incentre: bool) -> None:
    """Pixel centres are at half-integers, depths and barycentrics are exact, and the near plane clips."""
    triangles = around_the_camera(int(incentre))
    shapes = project(triangles, camera, incentre)
    rows, columns = (axis.ravel() for axis in np.mgrid[0 : camera.height, 0 : camera.width].astype(F))
    seen = crossing = 0
    for face, corners in enumerate(triangles):
        # depth * ray = sum of barycentric coordinates * corners
        scaled = np.linalg.solve(corners.T, rays(camera).reshape(-1, 3).T)
        depth = 1 / scaled.sum(axis=0)
        barycentrics = scaled * depth
        inside = (barycentrics >= 0).all(axis=0) & (depth >= NEAR)
        phi = shapes.phi(face, columns, rows)
        np.testing.assert_array_equal(~np.isnan(phi), inside)
        if not inside.any():
            continue
        assert not shapes.dropped[face]
        seen += 1
        crossing += corners[:, 2].min() < NEAR
        np.testing.assert_allclose(shapes.depth_at(face, columns, rows)[inside], depth[inside])
        weights = np.stack(shapes.barycentrics(face, columns, rows))[:, inside]
        np.testing.assert_allclose(weights, barycentrics[:, inside], atol=1e-9)
        low, high = shapes.rectangles.low[face], shapes.rectangles.high[face]
        assert (columns[inside] // 16 >= low[0]).all()
        assert (columns[inside] // 16 < high[0]).all()
        assert (rows[inside] // 16 >= low[1]).all()
        assert (rows[inside] // 16 < high[1]).all()
        # The window of the coverage, measured on the triangle in space.
        points = barycentrics[:, inside].T @ corners
        if incentre:
            sides = np.roll(corners, -1, axis=0) - corners
            length = np.linalg.norm(sides, axis=1)
            away = np.cross(points[:, None] - corners, sides)
            distance = np.linalg.norm(away, axis=-1) / length
            inradius = np.linalg.norm(np.cross(sides[0], sides[1])) / length.sum()
            np.testing.assert_allclose(phi[inside], distance.min(axis=1) / inradius, atol=1e-9)
        else:
            np.testing.assert_allclose(phi[inside], 3 * barycentrics[:, inside].min(axis=0), atol=1e-9)
    assert seen > 30
    assert crossing > 5


def test_invisible_triangles_are_dropped() -> None:
    front = np.array([[-1, -1, 4], [1, -1, 4], [0, 1.2, 4]], F)
    cases = {
        "behind": front - (0, 0, 8),
        "before the near plane": front * (1e-3, 1e-3, 1) - (0, 0, 3.995),
        "beside the image": np.add(front, (40, 0, 0)),
        "edge-on": front[:, [2, 1, 0]] * (0, 1, 1),
        "without area": front[[0, 1, 1]],
    }
    shapes = project(np.stack([front, *cases.values()]), front_camera())
    assert shapes.dropped.tolist() == [False] + [True] * len(cases)
    np.testing.assert_allclose(shapes.normal[0], [0, 0, 1])
    np.testing.assert_allclose(shapes.facing_normal()[0], [0, 0, -1])
    reversed_order = project(front[None, ::-1], front_camera())
    assert (shapes.back[0], reversed_order.back[0]) == (True, False)
    np.testing.assert_allclose(reversed_order.facing_normal()[0], [0, 0, -1])


def test_triangles_with_a_centroid_behind_the_camera_have_depth_zero() -> None:
    across = np.array([[[-1, 0.5, -9], [1, 0.5, -9], [0, 0.5, 3]]], F)
    shapes = project(across, front_camera())
    assert not shapes.dropped[0]
    assert shapes.depth[0] == 0


@pytest.mark.parametrize("gamma", [1.0, 2.5, 50.0])
def test_triangles_of_two_dts_are_enlarged_to_contain_their_coverage(gamma: float) -> None:
    opacity = np.array([0.003, 0.0041, 0.1, 0.7, 1.0], F)
    reached = reach(opacity, gamma)
    alpha = coverage_alpha(np.minimum(reached, MAX_ECCENTRICITY)[:, None], opacity[:, None], gamma)[:, 0]
    assert reached[0] == 0
    assert (np.diff(reached) > 0).all()
    assert (alpha[1:] < 1 / 255).all()
    np.testing.assert_allclose(alpha[1:], 1 / 255, rtol=0.06)


@pytest.mark.parametrize("method", SPLATTING)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_colors_are_interpolated_on_the_triangle(method: str, dtype: type) -> None:
    """A tilted triangle with a colour per corner. If the method has face colours, its depth is tested."""
    corners = np.array([[-1.5, -1, 2], [1.5, -1, 2], [0, 2.5, 8]], np.float32)
    rows = 3 if method == "mesh_splatting" else 1
    colors = np.concatenate(
        [constant_color(1, c) for c in ((0.9, 0.1, 0.1), (0.1, 0.9, 0.1), (0.1, 0.1, 0.9))]
    )
    buffers = {"opacity": np.full(rows, 12, np.float32), "f_dc": colors[:rows]}
    if method == "triangle_splatting":
        buffers["sigma"] = np.full(1, -9, np.float32)
    settings = {"supersample": 1} if method == "mesh_splatting" else {}
    camera = front_camera()
    frame = render_reference(
        soup(method, corners[None], **buffers), camera, (0, 0, 0), settings, dtype, sampling="engine"
    )
    scaled = np.linalg.solve(corners.T.astype(F), rays(camera).reshape(-1, 3).T)
    depth = (1 / scaled.sum(axis=0)).reshape(28, 40)
    inside = (scaled > 1e-3).all(axis=0).reshape(28, 40)
    assert inside.sum() > 100
    np.testing.assert_allclose(frame.depth[inside], depth[inside], rtol=1e-5)
    if method == "mesh_splatting":
        weights = (scaled.reshape(3, 28, 40) * depth).transpose(1, 2, 0)
        right = weights @ np.array([[0.9, 0.1, 0.1], [0.1, 0.9, 0.1], [0.1, 0.1, 0.9]])
        color = frame.image[inside] / frame.alpha[inside, None]
        np.testing.assert_allclose(color, right[inside], atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_triangles_across_the_camera_plane_are_clipped(method: str) -> None:
    """The official code drops triangles that reach behind the camera."""
    ground = np.array([[[-9, 1, -3], [9, 1, -3], [0, 1, 9]]], np.float32)
    buffers: dict[str, Any] = {}
    if method == "diffsoup":
        buffers["features.opacity"] = np.ones((1, 6), np.float32)
    elif method != "mesh_splatting":
        buffers["opacity"] = np.full(1, 12, np.float32)
    asset = soup(method, ground, **buffers)
    official = render_reference(asset, front_camera())
    engine = render_reference(asset, front_camera(), sampling="engine")
    if method == "diffsoup":
        assert not official.alpha.any()
    assert engine.visible.all()
    lower = engine.alpha[-1]
    assert (lower[5:-5] > 0.3).all()
    expected = 1 / rays(front_camera())[-1, 20, 1]
    assert engine.depth[-1, 20] == pytest.approx(expected, rel=1e-3)
    if method in ("triangle_splatting", "mesh_splatting"):
        assert not engine.alpha[: 28 // 2 - 2].any()


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_in_an_engine_there_are_no_tiles(method: str) -> None:
    asset = soup(method, around_the_camera(3).astype(np.float32))
    first, second = (
        render_reference(asset, CAMERAS[1], order=order, sampling="engine") for order in ("tile", "global")
    )
    np.testing.assert_array_equal(first.image, second.image)


@pytest.mark.slow
@pytest.mark.parametrize("method", SPLATTING)
def test_without_order_faces_are_blended_as_stored(method: str) -> None:
    """Two faces cover the middle. The first face in the asset is in front, although it is farther away."""
    triangle = np.array([[-2, 2, 3], [2, 2, 3], [0, -2.5, 3]], np.float32)
    pair = np.stack([triangle * (1, 1, 1.5), triangle]).astype(np.float32)
    rows = 3 if method == "mesh_splatting" else 1
    colors = np.concatenate([constant_color(rows, (1, 0, 0)), constant_color(rows, (0, 1, 0))])
    asset = soup(method, pair, f_dc=colors, opacity=np.full(2 * rows, 3, np.float32))
    for sampling in ("official", "engine"):
        for order, channel in (("tile", 1), ("global", 1), ("none", 0)):
            frame = render_reference(asset, front_camera(), order=order, sampling=sampling)
            middle = frame.image[12:16, 18:22]
            assert (middle[..., channel] > middle[..., 1 - channel] + 0.02).all()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["two_dts", "triangle_splatting"])
def test_without_tiles_faces_are_visible_everywhere(method: str) -> None:
    """The official tiles cut off parts of the only triangle."""
    cut = False
    for seed in range(30):
        asset = soup(method, random_triangles(seed, 1, 1.5), opacity=np.full(1, 4, np.float32))
        camera = front_camera(70, 60)
        official = render_reference(asset, camera).alpha
        everywhere = render_reference(asset, camera, order="global").alpha
        listed = official > 0
        np.testing.assert_array_equal(everywhere[listed], official[listed])
        cut |= bool((everywhere > official).any())
    assert cut


@pytest.mark.slow
@pytest.mark.parametrize(
    "view", [v for v in golden_views("diffsoup") if v.name.startswith("soup")][:2], ids=names
)
def test_diffsoup_in_an_engine_matches_its_official_viewer(view: View) -> None:
    """A rasterizer drew the web export. Clipped triangles cover a fifth of the pixels in this view."""
    with np.load(view.folder / "viewer_views.npz") as file:
        viewer_image = file[f"v{view.name[-1]}_viewer_image"]
    asset = exported(view.folder / "web_export" / view.folder.name)
    matching = {}
    for sampling in ("official", "engine"):
        frame = render_reference(asset, view.camera, view.background, view.settings, sampling=sampling)
        image = frame.image[::-1] if view.stored["flip_rows"] else frame.image
        levels = np.abs(np.rint(255 * image) - viewer_image.astype(int)).max(axis=-1)
        matching[sampling] = float((levels <= 8).mean())  # the viewer rounds features to bytes twice
    assert matching["official"] < 0.85
    assert matching["engine"] > 0.995


@pytest.mark.parametrize("method", SPLATTING)
def test_samples_stop_like_in_the_official_code(method: str) -> None:
    """With many nearly opaque layers, only the last blended layer lowers T below the threshold."""
    layer, depths = np.array([[-9, 9, 3], [9, 9, 3], [0, -12, 3]]), 0.01 * np.arange(40)
    layers = layer + np.stack([0 * depths, 0 * depths, depths], axis=-1)[:, None]
    rows = 3 * len(layers) if method == "mesh_splatting" else len(layers)
    asset = soup(method, layers.astype(np.float32), opacity=np.full(rows, 2, np.float32))
    settings = {"opacity_floor": 0.0, "supersample": 1} if method == "mesh_splatting" else {}
    frame = render_reference(asset, front_camera(), settings=settings, sampling="engine")
    through = 1 - frame.alpha
    assert through.max() < 0.01
    if method == "two_dts":
        assert (through <= MIN_TRANSMITTANCE).all()
    else:
        assert (through >= MIN_TRANSMITTANCE * 0.99).all()

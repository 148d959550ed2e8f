"""Properties of every model: empty views, odd image sizes, order of faces, settings, principal points."""

from typing import Any

import numpy as np
import pytest

from msb.reference import ReferenceFrame, render_reference
from msb.scenes import Camera
from tests.reference.soups import (
    SPLATTING,
    channel_major,
    constant_color,
    front_camera,
    random_triangles,
    soup,
)

VARIANTS: list[tuple[str, dict[str, Any]]] = [
    ("two_dts", {}),
    ("two_dts", {"rasterizer": "3D", "gamma": 20.0, "gamma_rescale": True}),
    ("two_dts", {"render_up_scale": 2, "back_culling": True}),
    ("triangle_splatting", {}),
    ("mesh_splatting", {"supersample": 2, "opacity_floor": 0.0, "sigma": 0.3}),
    ("mesh_splatting", {}),
    ("diffsoup", {}),
    ("diffsoup", {"layout": "synthetic", "z_near": 0.1, "z_far": 10.0}),
]
variants = pytest.mark.parametrize(("method", "settings"), VARIANTS)


def assert_same(first: ReferenceFrame, second: ReferenceFrame) -> None:
    """Assert that two frames are bit-identical."""
    for name in ("image", "alpha", "depth", "depth_median", "normal"):
        a, b = getattr(first, name), getattr(second, name)
        assert (a is None) == (b is None)
        if a is not None:
            np.testing.assert_array_equal(a, b, err_msg=name)


@pytest.mark.slow
@variants
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 17), (16, 16), (33, 31)])
def test_shapes_and_dtypes(
    method: str, settings: dict[str, Any], dtype: type, width: int, height: int
) -> None:
    camera = Camera(width, height, 42, 45, width / 2, height / 2, np.eye(4))
    frame = render_reference(soup(method, random_triangles(3, size=2.0)), camera, (1, 1, 1), settings, dtype)
    assert frame.image.shape == (height, width, 3)
    assert frame.alpha.shape == frame.depth.shape == (height, width)
    assert frame.visible.shape == (60,)
    assert frame.visible.any()
    for array in (frame.image, frame.alpha, frame.depth, frame.depth_median, frame.normal):
        assert array is None or (array.dtype == dtype and np.isfinite(array).all())
    assert (frame.depth_median is not None) == (method in ("triangle_splatting", "mesh_splatting"))
    assert (frame.face_id is not None) == (method in ("mesh_splatting", "diffsoup"))
    assert (frame.normal is not None) == (method in SPLATTING)
    assert ((frame.alpha >= 0) & (frame.alpha <= 1)).all()
    assert frame.alpha.any()


@pytest.mark.slow
@variants
def test_order_of_the_faces_does_not_matter(method: str, settings: dict[str, Any]) -> None:
    """The order would matter at equal depths, which do not occur here."""
    triangles = random_triangles(4, size=0.5)
    asset = soup(method, triangles)
    order = np.random.default_rng(0).permutation(len(triangles))
    buffers = {name: array for name, array in asset.buffers.items() if name not in ("positions", "indices")}
    for name, array in buffers.items():
        if name.startswith("decoder."):
            continue
        rows = array.reshape(len(triangles), -1)[order]
        buffers[name] = np.ascontiguousarray(rows.reshape(array.shape))
    mixed = soup(method, triangles[order], **buffers)
    first, second = (render_reference(a, front_camera(), (0, 0, 0), settings) for a in (asset, mixed))
    assert_same(first, second)
    np.testing.assert_array_equal(first.visible[order], second.visible)


@pytest.mark.parametrize(("method", "settings"), VARIANTS[:-2])
def test_ties_go_to_the_lower_index(method: str, settings: dict[str, Any]) -> None:
    """If two faces coincide, the first one is in front, whatever its colour is."""
    triangle = np.float32([[-2, 2, 3], [2, 2, 3], [0, -2.5, 3]])  # a front face: back_culling keeps it
    rows = 3 if method == "mesh_splatting" else 1
    red, green = constant_color(rows, (1, 0, 0)), constant_color(rows, (0, 1, 0))
    logits = np.full(2 * rows, 2, np.float32)
    for front, back, channel in ((red, green, 0), (green, red, 1)):
        colors = np.concatenate([front, back])
        pair = soup(method, np.stack([triangle, triangle]), f_dc=colors, opacity=logits)
        middle = render_reference(pair, front_camera(), (0, 0, 0), settings).image[12:16, 18:22]
        assert (middle[..., channel] > middle[..., 1 - channel] + 0.02).all()


def test_gamma_is_stored_or_overridden() -> None:
    triangles = random_triangles(5)
    stored = soup("two_dts", triangles, settings={"gamma": 20.0, "ste_threshold": 0.6})
    plain = soup("two_dts", triangles)
    camera = front_camera()
    assert_same(
        render_reference(stored, camera),
        render_reference(plain, camera, settings={"gamma": 20.0, "ste_threshold": 0.6}),
    )
    assert_same(
        render_reference(stored, camera, settings={"gamma": 1.0, "ste_threshold": None}),
        render_reference(plain, camera),
    )
    assert np.abs(render_reference(stored, camera).image - render_reference(plain, camera).image).max() > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("method", SPLATTING)
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_a_lower_sh_degree_ignores_higher_coefficients(method: str, degree: int) -> None:
    triangles = random_triangles(6)
    full = soup(method, triangles, degree=3)
    rest = full.buffers["f_rest"].reshape(len(full.buffers["f_rest"]), -1, 3)[:, : (degree + 1) ** 2 - 1]
    buffers = {"f_rest": np.ascontiguousarray(rest.reshape(len(rest), -1))} if degree else {}
    small = soup(method, triangles, degree=degree, **buffers)
    assert_same(
        render_reference(full, front_camera(), settings={"sh_degree": degree}),
        render_reference(small, front_camera()),
    )


@pytest.mark.parametrize("method", SPLATTING)
def test_both_orders_of_f_rest_are_read(method: str) -> None:
    asset = soup(method, random_triangles(7), degree=3)
    assert_same(
        render_reference(asset, front_camera()), render_reference(channel_major(asset), front_camera())
    )


@pytest.mark.parametrize(("method", "settings"), [case for case in VARIANTS if case != ("diffsoup", {})])
def test_a_small_face_appears_where_the_camera_projects_it(method: str, settings: dict[str, Any]) -> None:
    """The test includes off-centre principal points. Pixel centres are at half-integers.

    DiffSoup's COLMAP layout has the opposite sign of cy, which the next test covers.
    """
    center = np.array([0.31, -0.22, 3.0])
    # Triangles of 2DTS extend beyond their edges. Other methods drop tiny triangles, so the triangles for
    # them are larger here.
    size = 0.1 if method == "two_dts" and "rasterizer" not in settings else 1.0
    triangle = center + size * np.array([[-0.3, 0.2, 0], [0.3, 0.2, 0], [0, -0.4, 0]])
    opaque = {"features.opacity": np.ones((1, 6), np.float32)} if method == "diffsoup" else {}
    asset = soup(method, triangle[None], **opaque)
    settings = {**settings, "back_culling": False} if method == "two_dts" else settings
    for moved in ({}, {"cx": 26.5, "cy": 9.25}):
        camera = front_camera(**moved)
        alpha = render_reference(asset, camera, settings=settings).alpha
        rows, columns = np.mgrid[0:28, 0:40] + 0.5
        centroid = [(alpha * axis).sum() / alpha.sum() for axis in (columns, rows)]
        np.testing.assert_allclose(centroid, camera.project(center)[0], atol=0.3)


def test_diffsoup_keeps_the_sign_of_cy_of_its_colmap_layout() -> None:
    triangle = np.array([[-0.3, 0.2, 3.0], [0.3, 0.2, 3.0], [0, -0.4, 3.0]])
    asset = soup("diffsoup", triangle[None], **{"features.opacity": np.ones((1, 6), np.float32)})
    centered = render_reference(asset, front_camera(), settings={"layout": "colmap"})
    lower = render_reference(asset, front_camera(cy=18.0), settings={"layout": "colmap"})
    np.testing.assert_array_equal(lower.face_id[:-4], centered.face_id[4:])


@pytest.mark.parametrize("method", SPLATTING)
def test_moving_the_principal_point_by_whole_tiles_moves_the_image(method: str) -> None:
    """The shift only affects the mapping to pixels: faces and falloff are the same at another position."""
    asset = soup(method, random_triangles(8), degree=2)
    settings = {"supersample": 2} if method == "mesh_splatting" else {}
    first = render_reference(asset, front_camera(48, 48), (0, 0, 0), settings, np.float64)
    second = render_reference(asset, front_camera(48, 48, cx=40.0, cy=40.0), (0, 0, 0), settings, np.float64)
    np.testing.assert_allclose(second.image[16:, 16:], first.image[:-16, :-16], atol=1e-9)
    np.testing.assert_allclose(second.depth[16:, 16:], first.depth[:-16, :-16], atol=1e-9)


def test_infinite_opacity_logits_are_zero_and_one() -> None:
    triangles = random_triangles(9, count=2)
    logits = np.float32([np.inf, -np.inf])
    frame = render_reference(soup("two_dts", triangles, opacity=logits), front_camera())
    alone = render_reference(soup("two_dts", triangles, opacity=np.float32([90, -90])), front_camera())
    assert_same(frame, alone)
    assert frame.visible.tolist() == [True, True]

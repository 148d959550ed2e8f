"""Faces with very distant corners, against an independent ray caster in long double."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from data_stubs.surface import icosphere
from msb.cl import Device
from msb.render.frame import interior
from msb.scenes import Camera
from tests.render.standard_scenes import (
    BACKGROUND,
    Arrays,
    camera,
    draw,
    mesh_asset,
    random_colors,
    twin,
    unshared,
)

pytestmark = pytest.mark.slow

REAL = np.longdouble
NEAR = REAL(np.float32(0.01))


class Cast(NamedTuple):
    """The result of casting a ray per pixel. `clear` (H, W): no edge and no other surface is near."""

    face_id: NDArray[np.int64]
    depth: NDArray[np.float64]
    image: NDArray[np.float64]
    clear: NDArray[np.bool_]


def cast(mesh: Arrays, colors: NDArray[np.uint8], view: Camera) -> Cast:
    """Intersect the ray of every pixel with every face, using signed volumes of ray and edges."""
    pose = view.world_to_camera.astype(REAL)
    corners = (mesh[0].astype(REAL) @ pose[:3, :3].T + pose[:3, 3])[mesh[1]]
    rgb = colors[mesh[1]].astype(REAL) / 255
    y, x = np.mgrid[: view.height, : view.width].astype(REAL) + REAL(0.5)
    rays = np.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, np.ones_like(x)], axis=-1)
    nearest, second = np.zeros((2, view.height, view.width), REAL)
    face_id = np.full(x.shape, -1)
    image = np.broadcast_to(np.array(BACKGROUND, REAL), rays.shape).copy()
    for face, (a, b, c) in enumerate(corners):
        volumes = rays @ np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)]).T
        near, middle, far = sorted((a, b, c), key=lambda corner: np.abs(corner).max())
        normal = np.cross(middle - near, far - near)
        if normal @ near == 0:
            continue
        inverse = rays @ normal / (normal @ near)
        same_sign = (volumes >= 0).all(axis=-1) | (volumes <= 0).all(axis=-1)
        met = same_sign & (inverse > 0) & (inverse <= 1 / NEAR)
        wins = met & (inverse > nearest)
        second = np.where(wins, nearest, np.where(met, np.maximum(second, inverse), second))
        nearest[wins], face_id[wins] = inverse[wins], face
        weights = volumes[wins] / volumes[wins].sum(axis=-1, keepdims=True)
        image[wins] = weights @ rgb[face]
    hit = nearest > 0
    depth = np.where(hit, 1 / np.where(hit, nearest, 1), 0)
    clear = interior(face_id) & (second < nearest * REAL(0.999))
    return Cast(face_id, depth.astype(np.float64), image.astype(np.float64), clear)


def unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def far_triangles(kind: str, size: float, random: np.random.Generator) -> NDArray[np.float64]:
    """Return triangles (n, 3, 3) in camera space: some corners at distance `size`, the others at 1 to 5."""
    near = random.normal(size=(10, 3, 3)) * 1.2 + (0, 0, 4)
    away = size * random.uniform(0.5, 2, (10, 2, 1))
    match kind:
        case "one corner":
            near[:, :1] = unit(random.normal(size=(10, 1, 3))) * away[:, :1]
        case "two corners":
            near[:, :2] = unit(random.normal(size=(10, 2, 3))) * away
        case "along an axis":  # the far corner may have the least depth
            near[range(10), 0, random.integers(0, 3, 10)] = away[:, 0, 0] * random.choice([-1, 1], 10)
        case "floor":  # two triangles with all corners far away, in a plane 0.3 to 3 from the camera
            up = unit(random.normal(size=3))
            right = unit(np.cross(up, random.normal(size=3)))
            ahead = np.cross(up, right)
            a, b, c, d = (up * random.uniform(0.3, 3) + size * (right * i + ahead * j) for i, j in CORNERS)
            near = np.concatenate([near[:4], [[a, b, c], [a, c, d]]])
        case "strip":  # a strip, three units wide, that passes the camera
            along = unit(random.normal(size=(10, 3)))
            across = 3 * unit(np.cross(along, random.normal(size=(10, 3))))
            middle = random.normal((0, 0, 3), size=(10, 3))
            ends = middle - along * size, middle + along * size
            near = np.stack([*ends, ends[1] + across], axis=1)
    order = random.permuted(np.tile(np.arange(3), (len(near), 1)), axis=1)
    return np.take_along_axis(near, order[:, :, None], axis=1)


CORNERS = ((-1, -1), (1, -1), (1, 1), (-1, 1))


def random_camera(random: np.random.Generator) -> Camera:
    """Return a camera with a random pose, so that distant corners are rounded when transformed."""
    rotation = np.linalg.qr(random.normal(size=(3, 3)))[0]
    pose = np.eye(4)
    pose[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    pose[:3, 3] = random.normal(size=3)
    return camera(pose=pose)


def to_world(view: Camera, triangles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the world coordinates of points in camera space."""
    return (triangles - view.world_to_camera[:3, 3]) @ view.world_to_camera[:3, :3]


def check(frame: Any, expected: Cast) -> None:
    clear = expected.clear
    np.testing.assert_array_equal(frame.face_id[clear], expected.face_id[clear])
    assert (frame.face_id != expected.face_id).mean() < 0.002  # the very edges
    hit = clear & (expected.face_id >= 0)
    assert hit.sum() > 500
    np.testing.assert_allclose(frame.depth[hit], expected.depth[hit], rtol=5e-5)
    np.testing.assert_allclose(frame.image[hit], expected.image[hit], atol=2e-4)


CASES = [
    (kind, size)
    for kind in ("one corner", "two corners", "along an axis", "floor", "strip")
    for size in (1e4, 1e6, 7e7, 1e9)
    if not (kind == "strip" and size > 1e7)  # float32 cannot resolve the strip's width
]


@pytest.mark.parametrize(("kind", "size"), CASES)
def test_a_corner_far_away_leaves_face_depth_and_colour_right(
    cpu: Device, gpu: Device, kind: str, size: float
) -> None:
    random = np.random.default_rng([int(size), len(kind)])
    view = random_camera(random)
    mesh = unshared(to_world(view, far_triangles(kind, size, random)))
    colors = random_colors(7, len(mesh[0]))
    expected = cast(mesh, colors, view)
    check(twin(mesh, colors, view), expected)
    for device in (cpu, gpu):
        if kind in ("floor", "strip") and not device.record.fp64:
            continue  # without a near corner, float32 cannot represent the plane
        check(draw(device, mesh_asset(mesh, colors), view), expected)


@pytest.mark.parametrize("largest", [2, 4, 6, 9])
def test_a_shell_around_the_camera_has_no_cracks_however_far_its_corners_are(
    cpu: Device, gpu: Device, largest: int
) -> None:
    random = np.random.default_rng(largest)
    directions, faces = icosphere(3)
    is_far = random.random(len(directions)) < 0.3
    radii = 10 ** random.uniform(np.where(is_far, 1, -0.5), np.where(is_far, largest, 1))
    view = random_camera(random)
    mesh = to_world(view, directions * radii[:, None]).astype(np.float32), np.array(faces, np.uint32)
    colors = random_colors(1, len(directions))
    expected = cast(mesh, colors, view)
    frames = [draw(device, mesh_asset(mesh, colors), view) for device in (cpu, gpu)]
    for frame in frames:
        assert frame.alpha.all()
        np.testing.assert_array_equal(frame.face_id[expected.clear], expected.face_id[expected.clear])
    for name in ("image", "depth"):
        np.testing.assert_array_equal(getattr(frames[0], name), getattr(frames[1], name))

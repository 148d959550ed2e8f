"""The camera: projection, derived values, validation, order and split."""

import copy
import math
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from msb.errors import SceneError
from msb.scenes import Camera, from_opengl, invert_pose, sorted_by_stem, split_every_8th, stem
from msb.scenes.checks import MAX_PIXELS, MAX_SIDE
from msb.scenes.poses import quaternion_from_rotation, rotation_from_quaternion

from .builders import pose, quaternion, rotation, some_cameras

FRONT = Camera(200, 100, 50, 40, 90, 55, np.eye(4))


def test_the_centre_of_pixel_0_0_is_half_a_pixel_from_the_corner() -> None:
    camera = Camera(4, 2, 2, 2, 2, 1, np.eye(4))  # this camera sees x in -1..1 and y in -0.5..0.5 at depth 1
    pixels, _ = camera.project([[-0.75, -0.25, 1], [-1, -0.5, 1], [1, 0.5, 1]])
    assert pixels.tolist() == [[0.5, 0.5], [0, 0], [4, 2]]


def test_look_at_from_the_side() -> None:
    camera = Camera.look_at((2, 0, 0), (0, 0, 0), up=(0, 0, 3), width=200, height=100, fov_y=math.pi / 2)
    assert camera.fy == pytest.approx(50)
    assert camera.fx == camera.fy
    pixels, depth = camera.project([[0, 0, 0], [0, 1, 1], [0, 0, -1]])
    # For a camera that looks along -x with z up, +y is to the right. Points above the axis have a smaller v.
    np.testing.assert_allclose(pixels, [[100, 50], [125, 25], [100, 75]], atol=1e-12)
    np.testing.assert_allclose(depth, 2)
    np.testing.assert_allclose(camera.center, [2, 0, 0], atol=1e-15)


def test_up_is_minus_y_by_default() -> None:
    camera = Camera.look_at((0, 0, -2), (0, 0, 0), width=100, height=100, fov_y=1)
    pixels, _ = camera.project([[0, -0.5, 0], [0.5, 0, 0]])
    assert pixels[0, 1] < 50 < pixels[1, 0]  # -y is above the middle of the image, and +x is to the right


def test_points_behind_the_camera_are_nan() -> None:
    pixels, depth = FRONT.project([[[0, 0, -1], [1, 1, 0]], [[0, 0, 1], [0, 0, 1e-300]]])
    assert pixels.shape == (2, 2, 2)
    assert depth.tolist() == [[-1, 0], [1, 1e-300]]
    assert np.isnan(pixels[0]).all()
    assert pixels[1].tolist() == [[90, 55]] * 2


def test_projection_is_the_textbook_product() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3)) * 3
    for camera in some_cameras():
        np.testing.assert_allclose(camera.camera_to_world @ camera.world_to_camera, np.eye(4), atol=1e-14)
        product = (camera.K @ (camera.world_to_camera @ np.column_stack([points, np.ones(50)]).T)[:3]).T
        pixels, depth = camera.project(points)
        np.testing.assert_allclose(depth, product[:, 2], rtol=1e-12)
        front = depth > 0
        assert 0 < front.sum() < 50
        np.testing.assert_allclose(
            pixels[front], product[front, :2] / product[front, 2:], rtol=1e-9, atol=1e-9
        )


def test_resizing_keeps_the_field_of_view() -> None:
    camera = some_cameras()[1]
    half = camera.resized(20, 99)
    assert (half.width, half.height, half.source_size) == (20, 99, (camera.width, camera.height))
    assert (half.fov_x, half.fov_y) == pytest.approx((camera.fov_x, camera.fov_y))
    points = camera.center + [[1.0, 2, 3], [-3, 1, 1]] @ camera.world_to_camera[:3, :3]
    scale = (20 / camera.width, 99 / camera.height)
    np.testing.assert_allclose(half.project(points)[0], camera.project(points)[0] * scale)
    assert half.resized(7, 7).source_size == (camera.width, camera.height)
    assert camera.resized(camera.width, camera.height) is camera
    assert half.name == camera.name


def test_scaling_rounds_half_up_and_intrinsics_follow() -> None:
    camera = Camera(4946, 3286, 4000, 4001, 2473, 1643, np.eye(4))
    quarter = camera.scaled(1 / 4)
    assert (quarter.width, quarter.height) == (1237, 822)
    assert quarter.fx == pytest.approx(4000 * 1237 / 4946)
    assert quarter.fy == pytest.approx(4001 * 822 / 3286)
    assert (camera.scaled(1e-9).width, camera.scaled(1e-9).height) == (1, 1)


def test_centered_is_the_camera_of_the_3dgs_family() -> None:
    camera = some_cameras()[0].centered()
    assert (camera.cx, camera.cy) == (camera.width / 2, camera.height / 2)
    assert camera.fov_x == some_cameras()[0].fov_x
    assert camera.centered() == camera


def test_field_of_view_and_back() -> None:
    camera = Camera.from_fov(800, 600, np.eye(4).tolist(), fov_x=0.69, name="a")
    assert camera.fov_x == pytest.approx(0.69)
    assert camera.fov_y == pytest.approx(2 * math.atan(math.tan(0.69 / 2) * 600 / 800))  # square pixels
    both = Camera.from_fov(800, 600, np.eye(4), fov_x=1, fov_y=0.5)
    assert (both.fov_x, both.fov_y) == pytest.approx((1, 0.5))
    assert (both.cx, both.cy, both.name) == (400, 300, None)


def test_the_matrix_is_a_copy_that_cannot_be_changed() -> None:
    matrix = pose(3)
    camera = Camera(4, 4, 1, 1, 2, 2, matrix)
    matrix[0, 3] = 99
    assert camera.world_to_camera[0, 3] != 99
    for array in (camera.world_to_camera, camera.camera_to_world, camera.center):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(FrozenInstanceError):
        camera.width = 5
    for twin in (copy.deepcopy(camera), copy.copy(camera)):
        assert twin == camera
        assert not twin.world_to_camera.flags.writeable


def test_equal_cameras_are_equal_and_hash_alike() -> None:
    a, b = some_cameras()[0], some_cameras()[0]
    assert a == b
    assert hash(a) == hash(b)
    assert a != replace(a, fx=a.fx + 1e-12)
    assert a != replace(a, world_to_camera=pose(5))
    assert a != "camera"
    assert Camera(1, 1, 1, 1, 0, 0, -0.0 * np.eye(4) + np.eye(4)) == Camera(1, 1, 1, 1, 0, 0, np.eye(4))


def test_numpy_and_integer_arguments_become_python_numbers() -> None:
    camera = Camera(
        np.int32(5), np.uint64(6), np.float32(1.5), 2, np.int64(3), 0, np.eye(4, dtype=np.float32), "n",
        "images/n.png", [10, 12], "test", np.float32(2),
    )  # fmt: skip
    assert [type(value) for value in (camera.width, camera.height, camera.fx, camera.fy, camera.cx)] == [
        int, int, float, float, float
    ]  # fmt: skip
    assert type(camera.unit) is float
    assert camera.world_to_camera.dtype == np.float64
    assert camera.source_size == (10, 12)
    assert str(camera.image_path) == "images/n.png"


BAD: dict[str, dict[str, object]] = {
    "zero width": {"width": 0},
    "many pixels": {"width": 40000, "height": 40000},
    "nan focal": {"fx": math.nan},
    "tiny focal": {"fx": 1e-300},
    "far center": {"cy": -1e12},
    "3 x 4": {"world_to_camera": np.eye(4)[:3]},
    "nan pose": {"world_to_camera": np.eye(4) * math.nan},
    "scaled": {"world_to_camera": np.diag([1.0002, 1, 1, 1])},
    "singular": {"world_to_camera": np.diag([1.0, 1, 0, 1])},
    "empty name": {"name": ""},
    "backslash": {"name": "..\\x.png"},
    "up": {"name": "a/../b.png"},
    "trailing slash": {"name": "a/"},
    "surrogate": {"name": "a\ud800"},
    "bad source size": {"source_size": (5, 0)},
    "split": {"split": "Test"},
    "unit": {"unit": 0},
}


@pytest.mark.parametrize("name", BAD)
def test_invalid_cameras_are_rejected(name: str) -> None:
    good = {
        key: getattr(FRONT, key) for key in ("width", "height", "fx", "fy", "cx", "cy", "world_to_camera")
    }
    with pytest.raises(SceneError, match="CAMERA_INVALID") as caught:
        Camera(**(good | BAD[name]))
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 300


def test_limits_are_inclusive() -> None:
    assert Camera(MAX_SIDE, MAX_PIXELS // MAX_SIDE, 1e-9, 1e9, -1e9, 1e9, np.eye(4)).fx == 1e-9
    almost = np.eye(4)
    almost[0, 0] += 4.9e-5
    assert Camera(1, 1, 1, 1, 0, 0, almost).world_to_camera[0, 0] == almost[0, 0]
    assert Camera(1, 1, 1, 1, 0, 0, np.eye(4), "\u00fc b/\U0001f600 (1).JPG").name


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"target": (1, 2, 3)}, "CAMERA_PATH"),
        ({"up": (0, 0, 0)}, "CAMERA_PATH"),
        ({"eye": (0, math.nan, 1)}, "CAMERA_PATH"),
        ({"fov_y": 0}, "CAMERA_INVALID"),
    ],
)
def test_invalid_views_are_rejected(change: dict[str, object], code: str) -> None:
    good = {"eye": (1, 2, 3), "target": (0, 0, 0), "up": (0, 0, 1), "width": 4, "height": 3, "fov_y": 1.0}
    with pytest.raises(SceneError, match=code):
        Camera.look_at(**(good | change))


@pytest.mark.parametrize("factor", [0, -1, math.nan, math.inf, 1e9])
def test_invalid_scales_are_rejected(factor: float) -> None:
    with pytest.raises(SceneError, match="CAMERA_INVALID"):
        FRONT.scaled(factor)


def test_opengl_axes_become_opencv_axes() -> None:
    # An OpenGL camera at (0, 0, 5) looks along -z. The origin is in the middle of the image, and +y is up.
    to_world = np.eye(4)
    to_world[2, 3] = 5
    camera = Camera.from_fov(100, 100, from_opengl(to_world), fov_x=math.pi / 2)
    pixels, depth = camera.project([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_allclose(pixels, [[50, 50], [60, 50], [50, 40]])
    assert depth.tolist() == [5, 5, 5]
    with pytest.raises(SceneError, match="CAMERA_INVALID"):
        from_opengl(np.diag([1.0, 1, -1, 1]))
    with pytest.raises(SceneError, match="CAMERA_INVALID"):
        invert_pose(pose(0).T)


def test_rotations_equal_quaternion_products() -> None:
    for seed in range(100):
        q = quaternion(seed)
        np.testing.assert_allclose(rotation_from_quaternion(q * 1e-5), rotation(q), atol=1e-14)
        np.testing.assert_allclose(np.abs(quaternion_from_rotation(rotation(q)) @ q), 1, atol=1e-14)
    for half_turn in ((0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1), (0, 0.6, 0.8, 0)):
        back = quaternion_from_rotation(rotation_from_quaternion(half_turn))
        assert abs(back @ half_turn) == pytest.approx(1)


def cameras_called(*names: str | None) -> list[Camera]:
    return [Camera(1, 1, 1, 1, 0, 0, np.eye(4), name) for name in names]


def test_the_stem_ends_at_the_first_dot_and_has_no_folder() -> None:
    cameras = cameras_called("a.b/img.c.png", "plain", None, ".hidden.png")
    assert [stem(camera) for camera in cameras] == ["img", "plain", "", ""]


def test_the_order_is_by_code_point_and_stable() -> None:
    cameras = cameras_called(
        "z/DSC_2.png", "img.b.png", "b.png", "img.a.png", "DSC_10.png", "a/DSC_02.png", "Z.png"
    )
    assert [camera.name for camera in sorted_by_stem(cameras)] == [
        "a/DSC_02.png", "DSC_10.png", "z/DSC_2.png", "Z.png", "b.png", "img.b.png", "img.a.png"
    ]  # fmt: skip


def test_every_eighth_is_for_testing() -> None:
    cameras = cameras_called(*(f"{index:02d}.png" for index in reversed(range(18))))
    train, test = split_every_8th(cameras)
    assert [camera.name for camera in test] == ["00.png", "08.png", "16.png"]
    assert {camera.split for camera in test} == {"test"}
    assert {camera.split for camera in train} == {"train"}
    assert len(train) == 15
    assert split_every_8th([]) == ([], [])
    assert split_every_8th(test)[1][0].name == "00.png"

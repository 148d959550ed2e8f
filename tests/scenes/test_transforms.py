"""transforms_*.json: defaults, overrides by frames, and image sizes from files."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb

from .builders import dump, jpeg, png, pose, write

IDENTITY = np.eye(4).tolist()


def read(folder: Path, document: dict[str, Any], **files: bytes) -> list[msb.Camera]:
    images = {name.replace("__", "/").replace("_dot_", "."): data for name, data in files.items()}
    return msb.read_cameras(write(folder, {"transforms_test.json": dump(document)} | images))


def frame(path: str = "./test/r_0", **more: Any) -> dict[str, Any]:
    return {"file_path": path, "transform_matrix": IDENTITY} | more


def test_nerf_synthetic(tmp_path: Path) -> None:
    frames = [frame(f"./test/r_{index}", rotation=0.0125) for index in range(2)]
    document = {"camera_angle_x": 0.7, "frames": frames}
    files = {"test__r_0_dot_png": png(80, 40), "test__r_1_dot_png": png(60, 60)}
    first, second = read(tmp_path, document, **files)
    assert (first.name, first.split, first.width, first.height) == ("test/r_0.png", "test", 80, 40)
    assert first.image_path == tmp_path / "test" / "r_0.png"
    assert first.fx == first.fy == pytest.approx(40 / math.tan(0.35))
    assert (first.cx, first.cy) == (40, 20)
    assert (first.fov_x, second.fov_x) == pytest.approx((0.7, 0.7))
    assert second.fov_y == pytest.approx(0.7)
    # In OpenGL, a camera with the identity as its pose looks along -z with y up.
    assert first.world_to_camera.tolist() == np.diag([1.0, -1, -1, 1]).tolist()


def test_intrinsics_of_a_frame_override_the_document(tmp_path: Path) -> None:
    top = {"w": 100, "h": 50.0, "fl_x": 80, "cx": 49, "cy": 26, "camera_angle_x": 3.0, "k1": 0.0}
    frames = [frame("a.jpg"), frame("b.JPG", fl_x=90, fl_y=91, cx=40, w=101), frame("c", camera_angle_y=1)]
    a, b, c = read(tmp_path, top | {"frames": frames, "aabb_scale": 16, "is_fisheye": False})
    assert (a.width, a.height, a.fx, a.fy, a.cx, a.cy) == (100, 50, 80, 80, 49, 26)
    assert (b.name, b.width, b.fx, b.fy, b.cx, b.cy) == ("b.JPG", 101, 90, 91, 40, 26)
    assert c.name == "c.png"
    assert (c.fx, c.fy) == (80, pytest.approx(25 / math.tan(0.5)))


def test_a_missing_size_is_read_from_the_image(tmp_path: Path) -> None:
    document = {"fl_x": 10, "frames": [frame("images/a.jpg"), frame("images/b.v2")]}
    files = {"images__a_dot_jpg": jpeg(33, 21), "images__b_dot_v2_dot_png": png(5, 6)}
    a, b = read(tmp_path, document, **files)
    assert (a.width, a.height, a.cx, a.cy) == (33, 21, 16.5, 10.5)
    assert (b.name, b.width, b.height) == ("images/b.v2.png", 5, 6)


def test_a_pose_is_inverted_and_its_axes_converted(tmp_path: Path) -> None:
    to_world = pose(4)
    document = {"fl_x": 10, "w": 4, "h": 4, "frames": [frame(transform_matrix=to_world.tolist())]}
    (camera,) = read(tmp_path, document)
    np.testing.assert_allclose(camera.center, to_world[:3, 3])
    # A point in front of the camera has a negative z in its axes. A point above the axis has a smaller v.
    ahead = to_world @ [0, 0.1, -0.5, 1]
    pixels, depth = camera.project(ahead[:3])
    assert depth == pytest.approx(0.5)
    np.testing.assert_allclose(pixels, [2, 2 - 10 * 0.1 / 0.5], atol=1e-12)


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV"])
def test_a_model_without_distortion_is_a_pinhole_camera(model: str, tmp_path: Path) -> None:
    top = {"camera_model": model, "w": 4, "h": 4, "fl_x": 5, "k1": 0, "k2": 0.0, "p1": -0.0}
    assert len(read(tmp_path, top | {"frames": [frame()]})) == 1

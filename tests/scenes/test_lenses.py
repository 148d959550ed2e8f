"""Lens distortion and its removal, compared with OpenCV, COLMAP's formulas and a real capture."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import msb
from msb.errors import SceneError
from msb.scenes import Camera
from msb.scenes.distortion import DISTORTIONS, Distortion
from msb.scenes.lenses import undistort_image, undistorted

from .builders import dump, transforms, write

COEFFICIENTS: dict[str, tuple[float, ...]] = {
    "SIMPLE_RADIAL": (0.05,),
    "RADIAL": (-0.2, 0.05),
    "OPENCV": (-0.25, 0.08, 1e-3, -2e-3),
    "FULL_OPENCV": (-0.2, 0.05, 1e-3, -1e-3, 0.01, 0.02, 0.01, 0.003),
    "NERFSTUDIO": (0.05, -0.02, 0.01, 0.02, 1e-3, -1e-3),
    "OPENCV_FISHEYE": (0.03, -0.01, 0.005, 0.001),
    "SIMPLE_RADIAL_FISHEYE": (0.03,),
    "RADIAL_FISHEYE": (0.03, -0.01),
    "SIMPLE_FISHEYE": (),
    "FISHEYE": (),
    "THIN_PRISM_FISHEYE": (0.02, 0.01, 1e-3, -1e-3, 0.01, 0.001, 2e-3, -1e-3),
    "RAD_TAN_THIN_PRISM_FISHEYE": (0.02, -0.01, 0.01, 0, 0, 0, 1e-3, -1e-3, 2e-3, 1e-3, -1e-3, 1e-3),
    "FOV": (0.8,),
    "SIMPLE_DIVISION": (-0.1,),
    "DIVISION": (-0.1,),
    "EUCM": (0.5, 1.1),
}


def camera(
    model: str, *coefficients: float, cx: float = 200.0, cy: float = 150.0, f: float = 320.0
) -> Camera:
    distortion = Distortion(model, coefficients) if model else None
    return Camera(400, 300, f, f, cx, cy, np.eye(4), distortion=distortion)


def grid() -> tuple[Any, Any]:
    x, y = np.meshgrid(np.linspace(-0.6, 0.6, 13), np.linspace(-0.45, 0.45, 11))
    return x, y


@pytest.mark.parametrize("model", [name for name in DISTORTIONS if name != "NERFSTUDIO"])
def test_formulas_equal_colmap(model: str) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    peer = pycolmap.Camera.create_from_model_name(1, model, 320.0, 400, 300)
    coefficients = COEFFICIENTS[model]
    peer.params = [*peer.params[: len(peer.params) - len(coefficients)], *coefficients]
    x, y = grid()
    wanted = peer.img_from_cam(np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1))
    ours = np.stack([part.ravel() for part in Distortion(model, coefficients).apply(x, y)], axis=1)
    np.testing.assert_allclose(ours * 320 + (200, 150), wanted, atol=1e-9)


def test_nerfstudio_has_four_radial_terms() -> None:
    x, y = grid()
    right, down = Distortion("NERFSTUDIO", (0.1, 0.2, 0.3, 0.4, 0.01, 0.02)).apply(x, y)
    s = x**2 + y**2
    radial = 1 + 0.1 * s + 0.2 * s**2 + 0.3 * s**3 + 0.4 * s**4
    np.testing.assert_allclose(right, x * radial + 0.02 * x * y + 0.02 * (s + 2 * x * x))
    np.testing.assert_allclose(down, y * radial + 0.04 * x * y + 0.01 * (s + 2 * y * y))


@pytest.mark.parametrize("model", COEFFICIENTS)
@pytest.mark.parametrize("middle", [(200.0, 150.0), (180.0, 165.0)])
def test_undistorted_images_show_nothing_invented(model: str, middle: tuple[float, float]) -> None:
    lens = camera(model, *COEFFICIENTS[model], cx=middle[0], cy=middle[1])
    pinhole = undistorted(lens)
    assert pinhole.distortion is None
    assert (pinhole.fx, pinhole.fy) == (lens.fx, lens.fy)
    assert pinhole.cx / pinhole.width == pytest.approx(lens.cx / lens.width)
    # Every outer edge of the undistorted image lies between the centres of the outermost stored pixels.
    u, v = np.meshgrid(np.linspace(0, pinhole.width, 201), np.linspace(0, pinhole.height, 151))
    x, y = lens.distortion.apply((u - pinhole.cx) / lens.fx, (v - pinhole.cy) / lens.fy)  # type: ignore[union-attr]
    x, y = x * lens.fx + lens.cx, y * lens.fy + lens.cy
    assert min(x.min(), y.min()) > 0.499
    assert x.max() < 399.501
    assert y.max() < 299.501
    # It is the largest such image: two more columns or rows reach beyond, or the scale is at its limit.
    reach = min(x.min() - 0.5, 399.5 - x.max()), min(y.min() - 0.5, 299.5 - y.max())
    assert min(reach) < 1 or pinhole.width == 800 or pinhole.height == 600


def test_a_pinhole_camera_is_unchanged() -> None:
    lens = camera("")
    assert undistorted(lens) is lens
    pixels = np.zeros((300, 400, 3), np.uint8)
    assert undistort_image(pixels, lens) is pixels


def test_a_lens_that_folds_the_image_is_rejected_or_cut() -> None:
    small = undistorted(camera("RADIAL", -2.0, 0.0))
    assert small.width < 300
    with pytest.raises(SceneError, match="CAMERA_DISTORTED"):
        undistorted(camera("SIMPLE_RADIAL", -100.0))


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_pixels_are_those_of_opencv(channels: int) -> None:
    cv2 = pytest.importorskip("cv2")
    lens = camera("OPENCV", *COEFFICIENTS["OPENCV"], cx=210.0)
    target = undistorted(lens)
    pixels = np.random.default_rng(0).integers(0, 256, (300, 400, channels), np.uint8)
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    maps = cv2.initUndistortRectifyMap(
        lens.K - half, np.array(COEFFICIENTS["OPENCV"]), None, target.K - half,
        (target.width, target.height), cv2.CV_32FC1,
    )  # fmt: skip
    wanted = cv2.remap(pixels, *maps, cv2.INTER_LINEAR).reshape(target.height, target.width, channels)
    ours = undistort_image(pixels, lens)
    assert ours.shape == wanted.shape
    assert np.abs(ours.astype(int) - wanted).max() <= 1
    assert (ours == wanted).mean() > 0.999


@pytest.mark.parametrize(
    ("keys", "model", "coefficients"),
    [
        ({"k1": 0.1, "p2": 0.2}, "OPENCV", (0.1, 0, 0, 0.2)),
        ({"k1": 0.1, "k3": 0.3}, "OPENCV", (0.1, 0, 0, 0, 0.3)),
        ({"k1": 0.1, "k4": 0.4}, "NERFSTUDIO", (0.1, 0, 0, 0.4, 0, 0)),
        ({"camera_model": "full_opencv", "k4": 0.4}, "FULL_OPENCV", (0, 0, 0, 0, 0, 0.4, 0, 0)),
        ({"is_fisheye": True, "k1": 0.1}, "OPENCV_FISHEYE", (0.1, 0, 0, 0)),
        ({"fisheye": 1, "k4": 0.4}, "OPENCV_FISHEYE", (0, 0, 0, 0.4)),
        ({"camera_model": "OPENCV_FISHEYE"}, "OPENCV_FISHEYE", (0, 0, 0, 0)),
        ({"distortion_params": [1, 2, 3, 4, 5, 6]}, "NERFSTUDIO", (1, 2, 3, 4, 5, 6)),
        ({"distortion_params": [1, 2, 3, 4]}, "OPENCV", (1, 2, 3, 4)),
        ({"distortion_params": [1, 2, 3, 4, 5]}, "OPENCV", (1, 2, 3, 4, 5)),
        ({"distortion_params": [0.0] * 6, "k1": 0.5}, "OPENCV", (0.5, 0, 0, 0)),
        (
            {"camera_model": "FISHEYE624", "distortion_params": [0.1] * 12},
            "RAD_TAN_THIN_PRISM_FISHEYE",
            (0.1,) * 12,
        ),
    ],
)  # fmt: skip
@pytest.mark.parametrize("of_frame", [False, True])
def test_keys_of_transforms_json(
    keys: dict[str, Any], model: str, coefficients: tuple[float, ...], of_frame: bool, tmp_path: Path
) -> None:
    document = transforms([camera("")])
    document["frames"][0]["file_path"] = "a.png"
    (document["frames"][0] if of_frame else document).update(keys)
    (read,) = msb.read_cameras(write(tmp_path, {"transforms.json": dump(document)}))
    assert read.distortion == Distortion(model, tuple(map(float, coefficients)))


@pytest.mark.parametrize(
    "keys", [{"is_fisheye": 0}, {"camera_model": "pinhole"}, {"distortion_params": [0] * 6}]
)
def test_pinhole_cameras_of_transforms_json(keys: dict[str, Any], tmp_path: Path) -> None:
    document = transforms([camera("")]) | keys
    document["frames"][0]["file_path"] = "a.png"
    (read,) = msb.read_cameras(write(tmp_path, {"transforms.json": dump(document)}))
    assert read.distortion is None


@pytest.mark.parametrize("form", ["", "transforms.json"])
def test_the_plush_capture_is_undistorted_as_by_opencv_and_colmap(form: str, shared: Path) -> None:
    plush = shared / "captures/plush"
    if not plush.is_dir():
        pytest.skip("the plush capture is missing")
    lens = next(c for c in msb.read_cameras(plush / "raw" / form) if "20240212_003919" in str(c.name))
    pinhole = undistorted(lens)
    assert (pinhole.width, pinhole.height, pinhole.cx, pinhole.cy) == (784, 588, 392, 294)
    with Image.open(lens.image_path) as image:  # type: ignore[arg-type]
        ours = undistort_image(np.asarray(image), lens)
    for name, least in (("opencv/20240212_003919.png", 60), ("pycolmap/20240212_003919.jpg", 40)):
        with Image.open(plush / "undistorted" / name) as image:
            assert msb.metrics.psnr(ours, np.asarray(image.convert("RGB"))) > least

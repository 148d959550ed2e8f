"""PSNR and SSIM compared with golden values and formulas, rejected inputs, and the test helper."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import correlate1d
from skimage.metrics import peak_signal_noise_ratio

from msb import metrics
from msb.errors import MetricError
from msb.metrics.images import PSNR, SSIM
from msb.render.images import to_bytes
from tests.metrics.checks import check_metric
from tests.metrics.conftest import GOLDEN, golden

CASES = golden("psnr_ssim.json")["cases"]
IMAGES = np.load(GOLDEN / "psnr_ssim.npz")


def pair(case: dict[str, Any]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    return IMAGES[f"{case['id']}__pred"], IMAGES[f"{case['id']}__gt"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["id"])
def test_golden(case: dict[str, Any]) -> None:
    pred, gt = pair(case)
    for a, b in ((pred, gt), (pred / 255, gt / 255), (np.float32(pred / 255), gt)):
        assert metrics.psnr(a, b) == pytest.approx(float(case["psnr"]), abs=1e-6)
        assert metrics.ssim(a, b) == pytest.approx(case["ssim"], abs=1e-9)
    assert metrics.ssim(pred, gt) == pytest.approx(case["ssim_f32"], abs=5e-5)


def test_golden_values_differ_from_similar_definitions() -> None:
    case = next(case for case in CASES if case["id"] == "blurred_97x131")
    pred, gt = pair(case)
    assert abs(metrics.ssim(pred, gt) - case["ssim_interior"]) > 0.03
    assert abs(metrics.psnr(pred, gt) - case["psnr_mean_of_channels"]) > 1e-5


def ssim_by_the_formula(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    window = np.exp(-((np.arange(11) - 5) ** 2) / (2 * 1.5**2))
    window /= window.sum()

    def blur(image: NDArray[np.float64]) -> NDArray[np.float64]:
        for axis in (0, 1):
            image = correlate1d(image, window, axis=axis, mode="constant")
        return image

    ma, mb = blur(a), blur(b)
    saa, sbb, sab = blur(a * a) - ma * ma, blur(b * b) - mb * mb, blur(a * b) - ma * mb
    top = (2 * ma * mb + 0.01**2) * (2 * sab + 0.03**2)
    return float((top / ((ma * ma + mb * mb + 0.01**2) * (saa + sbb + 0.03**2))).mean())


def psnr_by_another(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    with np.errstate(divide="ignore"):  # for equal images
        return float(peak_signal_noise_ratio(a, b, data_range=1))


@pytest.mark.parametrize(
    ("metric", "expected"), [(PSNR, psnr_by_another), (SSIM, ssim_by_the_formula)], ids=["psnr", "ssim"]
)
def test_psnr_and_ssim_equal_their_formulas(metric: metrics.ImageMetric, expected: Any) -> None:
    check_metric(metric, expected)


@pytest.mark.parametrize("kind", [np.float16, np.float32, np.float64])
def test_floats_are_rounded_like_a_png(kind: Any) -> None:
    frame = np.random.default_rng(1).normal(0.5, 0.4, (32, 40, 3)).astype(kind)
    gt = np.random.default_rng(2).integers(0, 256, (32, 40, 3), dtype=np.uint8)
    assert metrics.psnr(frame, gt) == metrics.psnr(to_bytes(frame), gt)
    assert metrics.ssim(frame, gt) == metrics.ssim(to_bytes(frame), gt)


def test_half_a_level_rounds_up_unless_quantize_is_false() -> None:
    zero, half = np.zeros((4, 4, 3)), np.full((4, 4, 3), 0.5 / 255)
    assert metrics.psnr(half, zero) == pytest.approx(20 * math.log10(255))
    assert metrics.psnr(half * 0.99, zero) == math.inf
    assert metrics.psnr(half, zero, quantize=False) == pytest.approx(20 * math.log10(510))
    assert metrics.ssim(half, zero, quantize=False) < 1


def test_values_outside_0_to_1_are_clamped() -> None:
    gt = np.ones((4, 4, 3))
    assert metrics.psnr(gt * 1.7, gt) == math.inf
    assert metrics.psnr(-gt, gt) == 0


GOOD = np.zeros((6, 5, 3))
BAD: dict[str, tuple[Any, str]] = {
    "grey": (np.zeros((6, 5)), "METRIC_IMAGE"),
    "alpha": (np.zeros((6, 5, 4)), "METRIC_IMAGE"),
    "empty": (np.zeros((0, 5, 3)), "METRIC_IMAGE"),
    "nothing": (None, "METRIC_IMAGE"),
    "16 bits": (np.zeros((6, 5, 3), np.uint16), "METRIC_IMAGE"),
    "text": (np.full((6, 5, 3), "0"), "METRIC_IMAGE"),
    "nan": (np.full((6, 5, 3), np.nan), "METRIC_IMAGE"),
    "bytes as floats": (np.full((6, 5, 3), 200.0), "METRIC_IMAGE"),
    "larger": (np.zeros((6, 6, 3)), "METRIC_SIZES_DIFFER"),
}


@pytest.mark.parametrize("name", BAD)
@pytest.mark.parametrize("metric", [metrics.psnr, metrics.ssim])
def test_invalid_images_are_rejected(metric: Any, name: str) -> None:
    image, code = BAD[name]
    for arguments in ((image, GOOD), (GOOD, image)):
        with pytest.raises(MetricError, match=code):
            metric(*arguments)


def test_identity_records_name_libraries_and_parameters() -> None:
    for name in ("psnr", "ssim", "chamfer_dtu"):
        record = metrics.identity(name).to_dict()
        assert record["name"] == name
        assert record["libraries"]["numpy"] == np.__version__
        assert metrics.METRICS[name] == record["better"]
    assert "floor(255 x + 0.5)" in metrics.identity("psnr").parameters["input"]
    assert "floor" not in metrics.identity("ssim", quantize=False).parameters["input"]
    assert metrics.identity("chamfer_dtu", seed=3).parameters["seed"] == 3
    with pytest.raises(MetricError, match="METRIC_ARGUMENT"):
        metrics.identity("fid")

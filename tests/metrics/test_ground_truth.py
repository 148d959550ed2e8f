"""Photographs prepared for comparison, tested against the loader of the 3DGS family and against formulas."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from msb.errors import InputError, MetricError
from msb.metrics.ground_truth import ground_truth
from msb.scenes.datasets import Scene, read_scene
from tests.conftest import ROOT

GOLDEN = ROOT / "tests/golden/metrics/scenes"
LOADERS: dict[str, Any] = json.loads((GOLDEN / "cameras.json").read_text())
STUBS = ROOT / "tests" / "tiny" / "scenes"
WITH_PIXELS = [
    (layout, key)
    for layout in ("colmap_bin", "colmap_txt")
    for key, golden in LOADERS[layout].items()
    if "cameras" in golden
]


def levels(image: Any) -> Any:
    """Return 255 times the image, which must be integers."""
    assert image.dtype == np.float32
    whole = np.rint(image.astype(np.float64) * 255)
    assert np.abs(whole - image.astype(np.float64) * 255).max() < 1e-4
    return whole.astype(int)


@pytest.mark.parametrize(("layout", "key"), WITH_PIXELS)
def test_opaque_photographs_equal_the_loader_bit_for_bit(layout: str, key: str) -> None:
    _, folder, _, resolution = key.split()
    scene = read_scene(GOLDEN / layout, image_folder=folder, resolution=int(resolution))
    for wanted in LOADERS[layout][key]["cameras"]:
        (camera,) = (
            c for c in (*scene.test, *scene.train) if np.allclose(c.world_to_camera[:3, 3], wanted["T"])
        )
        image = ground_truth(scene, camera)
        assert image.shape == (wanted["height"], wanted["width"], 3)
        atol = LOADERS["tolerance"]["pixels_abs"]
        np.testing.assert_allclose(image[0, 0], wanted["pixel_0_0"], atol=atol)
        np.testing.assert_allclose(image[-1, -1], wanted["pixel_last"], atol=atol)
        assert image.mean(dtype=np.float64) == pytest.approx(wanted["image_mean"], abs=atol)
        assert levels(image).max() <= 255


@pytest.mark.parametrize(("name", "background"), [("white", (1, 1, 1)), ("black", (0, 0, 0))])
def test_masked_photographs_equal_the_loader_up_to_truncation(name: str, background: Any) -> None:
    scene = read_scene(
        GOLDEN / "nerf_synthetic", dataset="nerf_synthetic", resolution=1, background=background
    )
    assert not scene.gt_resized
    for wanted, camera in zip(LOADERS["nerf_synthetic"][name], scene.test, strict=True):
        result = levels(ground_truth(scene, camera))
        rows = np.array(wanted["uint8_composite_first_rows"])  # six pixels in each of the rows 0 and 6
        above = result[[0, 6], :6] - rows
        assert above.min() >= 0
        assert above.max() <= 1
        assert 0 <= result.sum() - wanted["uint8_composite_sum"] <= result.size


def masked_scene(tmp_path: Path, pixels: Any, **options: Any) -> tuple[Scene, Any]:
    """Return a scene that has `pixels` as every photograph, and its first test camera."""
    root = shutil.copytree(STUBS / "nerf_synthetic/pebble", tmp_path / "nerf_synthetic/toy")
    for path in (*(root / "test").iterdir(), *(root / "train").iterdir()):
        Image.fromarray(pixels).save(path)
    scene = read_scene(root, **options)
    return scene, scene.test[0]


def random_pixels(size: int = 32) -> Any:
    random = np.random.default_rng(0)
    pixels = random.integers(0, 256, (size, size, 4), dtype=np.uint8)
    pixels[: size // 2, :, 3] = random.choice([0, 255], (size // 2, size))
    return pixels


def test_alpha_is_composited_over_the_background_and_rounded_half_up(tmp_path: Path) -> None:
    pixels, background = random_pixels(), (0.25, 0.5, 1.0)
    scene, camera = masked_scene(tmp_path, pixels, resolution=1, background=background)
    alpha = pixels[..., 3:] / 255
    expected = np.floor(pixels[..., :3] * alpha + 255 * np.array(background) * (1 - alpha) + 0.5)
    assert np.array_equal(levels(ground_truth(scene, camera)), expected)


def cubic(x: Any) -> Any:
    """Return Keys' cubic with a = -1/2, which is Pillow's bicubic filter."""
    x = np.abs(x)
    near = (1.5 * x - 2.5) * x**2 + 1
    far = ((-0.5 * x + 2.5) * x - 4) * x + 2
    return np.where(x < 1, near, np.where(x < 2, far, 0))


def halved(image: Any) -> Any:
    """Return an image of even size at half the size.

    The cubic filter is twice as wide as for an unchanged size, and normalised at borders.
    """
    for axis in (0, 1):
        size = image.shape[axis]
        weights = cubic((np.arange(size) - (2 * np.arange(size // 2)[:, None] + 0.5)) / 2)
        weights /= weights.sum(axis=1, keepdims=True)
        image = np.moveaxis(np.tensordot(weights, image, (1, axis)), 0, axis)
    return image


def test_synthetic_photographs_are_composited_before_resizing(tmp_path: Path) -> None:
    pixels = random_pixels()
    scene, camera = masked_scene(tmp_path, pixels)
    assert (scene.compositing, scene.gt_resized) == ("before_resize", True)
    alpha = pixels[..., 3:] / 255
    over = pixels[..., :3] / 255 * alpha + 1 - alpha
    expected = np.clip(halved(over), 0, 1) * 255
    result = levels(ground_truth(scene, camera))
    assert result.shape == (16, 16, 3)
    assert np.abs(result - expected).max() < 0.501  # rounded only once


def test_dtu_photographs_are_resized_before_compositing() -> None:
    scene = read_scene(STUBS / "dtu/scan1")
    assert (scene.compositing, scene.mask_source) == ("after_resize", "png_alpha")
    camera = scene.test[0]
    with Image.open(str(camera.image_path)) as image:
        small = np.floor(np.clip(halved(np.asarray(image) / 255.0), 0, 1) * 255 + 0.5) / 255
    expected = (small[..., :3] * small[..., 3:] + 1 - small[..., 3:]) * 255
    result = levels(ground_truth(scene, camera))
    error = np.abs(result - expected)  # Pillow also rounds and clamps bytes between the axes
    assert error.max() < 5
    assert error.mean() < 0.2
    before = ground_truth(replace(scene, compositing="before_resize"), camera)
    assert np.abs(levels(before) - result).max() > 5  # the grey behind the mask shows at its border


@pytest.fixture
def dtu(tmp_path: Path) -> Path:
    return shutil.copytree(STUBS / "dtu/scan1", tmp_path / "dtu/scan1")


def test_mask_folder_equals_alpha(dtu: Path) -> None:
    by_alpha = read_scene(dtu, resolution=1)
    expected = [ground_truth(by_alpha, camera) for camera in by_alpha.test]
    masks = sorted((dtu / "mask").iterdir())
    for index, path in enumerate(sorted((dtu / "images").iterdir())):
        with Image.open(path) as image:
            color, alpha = image.convert("RGB"), np.asarray(image.getchannel("A"))
        Image.fromarray(alpha).save(masks[index])  # this mask is grey; those of the stub are RGB
        color.save(path)
    scene = read_scene(dtu, resolution=1)
    assert (scene.mask_source, len(scene.masks)) == ("mask_folder", 16)
    for camera, image in zip(scene.test, expected, strict=True):
        assert np.array_equal(ground_truth(scene, camera), image)


def test_rules_of_the_3dgs_family_ignore_dtu_masks() -> None:
    scene = read_scene(STUBS / "dtu/scan1", rules="triangle_splatting", resolution=1)
    assert scene.mask_source is None
    camera = scene.test[0]
    with Image.open(str(camera.image_path)) as image:
        color = np.asarray(image.convert("RGB"))
    assert np.array_equal(levels(ground_truth(scene, camera)), color)


def test_2dts_resizes_bilinearly_and_does_not_round() -> None:
    root = STUBS / "nerf_synthetic/pebble"
    scene = read_scene(root, rules="two_dts", resolution=2)
    image = ground_truth(scene, scene.test[0])
    assert image.shape == (72, 72, 3)
    assert np.abs(image * 255 - np.rint(image * 255)).max() > 0.1
    ours = ground_truth(read_scene(root), scene.test[0])
    assert 0 < np.abs(image - ours).mean() < 0.05


def test_unreadable_photograph_is_an_error(tmp_path: Path) -> None:
    scene = read_scene(STUBS / "mipnerf360/pebble")
    missing = replace(scene.test[0], image_path=tmp_path / "a.png")
    with pytest.raises(InputError, match="FILE_NOT_FOUND"):
        ground_truth(scene, missing)
    (tmp_path / "a.png").write_bytes(Path(str(scene.test[0].image_path)).read_bytes()[:300])
    with pytest.raises(MetricError, match="METRIC_IMAGE"):
        ground_truth(scene, missing)
    with pytest.raises(ValueError, match="no image_path"):
        ground_truth(scene, replace(missing, image_path=None))

"""Images whose making is known: `msb eval --lint` says from which photographs, by which program."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageFilter

from msb.bench.lint import RESAMPLERS, Version, lint_images
from msb.errors import MetricError
from msb.metrics.ground_truth import ground_truth
from msb.metrics.images import PSNR_CAP
from msb.scenes.datasets import Scene, read_scene
from tests.cli.conftest import Msb, msb
from tests.conftest import ROOT

__all__ = ["msb"]  # the fixture
STUB = ROOT / "data_stubs/scenes/mipnerf360/pebble"
FULL, QUARTER = (320, 240), (80, 60)
AS_IT_IS = Version("images_4", "")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Scene:
    """Return a scene with photographs of detail, and an images_4 made by no resampler that we know."""
    root = tmp_path_factory.mktemp("scenes") / "mipnerf360" / "pebble"
    shutil.copytree(STUB / "sparse", root / "sparse")
    names = sorted(path.name for path in (STUB / "images_4").iterdir())[::8]
    random = np.random.default_rng(42)
    for folder in ("images", "images_4"):
        (root / folder).mkdir()
    for name in names:
        rough = Image.fromarray(random.integers(0, 256, (30, 40, 3), dtype=np.uint8)).resize(FULL)
        grain = random.normal(0, 25, (FULL[1], FULL[0], 3))
        photograph = Image.fromarray(np.clip(np.asarray(rough) + grain, 0, 255).astype(np.uint8))
        photograph.save(root / "images" / name, quality=95)
        soft = Image.open(root / "images" / name).filter(ImageFilter.GaussianBlur(1.2))
        soft.resize(QUARTER, Image.Resampling.NEAREST).save(root / "images_4" / name, quality=95)
    return read_scene(root)


def made(scene: Scene, out: Path, make: Callable[[Image.Image], Image.Image], **options: int) -> Path:
    """Write images made from the full photographs of the test views, as PNG or as JPEG of a quality."""
    out.mkdir()
    for number, camera in enumerate(scene.test):
        image = make(Image.open(scene.root / "images" / str(camera.name)))
        name = Path(str(camera.name)).stem if not options else f"{number:05d}"
        image.save(out / f"{name}.{'jpg' if options else 'png'}", **options)
    return out


def resized(by: str) -> Callable[[Image.Image], Image.Image]:
    return lambda image: Image.fromarray(RESAMPLERS[by](np.asarray(image), QUARTER))


def test_the_package_s_own_are_known(scene: Scene) -> None:
    found = lint_images(scene.root / "images_4", scene)
    assert (found.best, found.wanted, found.is_wanted, found.told) == (AS_IT_IS, AS_IT_IS, True, True)
    assert found.views == 8
    assert found.sentence == "they are images_4 as the scene has them"


@pytest.mark.parametrize("by", RESAMPLERS)
def test_the_resampler_is_named(scene: Scene, tmp_path: Path, by: str) -> None:
    found = lint_images(made(scene, tmp_path / "gt", resized(by)), scene)
    assert Version("images", by) in found.same_as_best
    assert set(found.same_as_best) <= {Version("images", each) for each in (by, "PIL box", "OpenCV area")}
    assert (found.is_wanted, found.photographs, found.told) == (False, True, True)
    assert found.sentence.endswith(f", not {AS_IT_IS}: {found.versions[AS_IT_IS]:.2f} dB between the two")


def test_opencv_s_area_is_not_pil_s_box_where_pixels_are_cut(scene: Scene) -> None:
    image = np.asarray(Image.open(scene.test[0].image_path))  # 80 x 60
    ours = RESAMPLERS["OpenCV area"](image, (32, 24))  # 2.5 pixels each
    first = image[:3, :3].astype(float)
    weights = np.array([1, 1, 0.5])
    assert ours[0, 0] == pytest.approx(
        (first * np.outer(weights, weights)[..., None]).sum((0, 1)) / 6.25, abs=0.5
    )
    assert not np.array_equal(ours, RESAMPLERS["PIL box"](image, (32, 24)))


@pytest.mark.parametrize("quality", [75, 90])
def test_photographs_saved_again_as_jpeg(scene: Scene, tmp_path: Path, quality: int) -> None:
    jpeg = lint_images(made(scene, tmp_path / "gt", resized("PIL Lanczos"), quality=quality), scene)
    assert jpeg.best is not None
    assert jpeg.best[:2] == ("images", "PIL Lanczos")
    assert jpeg.best.jpeg
    assert (jpeg.told, jpeg.is_wanted, jpeg.photographs) == (True, False, True)


def test_masks_of_a_folder_are_those_of_training_views_as_well(tmp_path: Path) -> None:
    root = shutil.copytree(ROOT / "data_stubs/scenes/dtu/scan1", tmp_path / "dtu/scan1")
    for path, mask in zip(*(sorted((root / name).iterdir()) for name in ("images", "mask")), strict=True):
        with Image.open(path) as image:
            image.getchannel("A").save(mask)
            image.convert("RGB").save(path)
    masked = read_scene(root, resolution=1)
    camera = next(camera for camera in masked.train if str(camera.name) not in masked.masks)
    photograph = (ground_truth(masked, camera) * 255 + 0.5).astype(np.uint8)
    (tmp_path / "gt").mkdir()
    Image.fromarray(photograph).save(tmp_path / "gt" / "00000.png")
    found = lint_images(tmp_path / "gt", replace(masked, test=(), train=(camera,)))
    assert (found.best, found.is_wanted) == (Version("images", ""), True)
    assert found.versions[Version("images", "")] == PSNR_CAP


def test_other_sizes_scenes_and_orders(scene: Scene, tmp_path: Path) -> None:
    found = lint_images(scene.root / "images", scene)
    size = "at 320 x 240, where the scene is compared at 80 x 60 (images_4)"
    assert found.sentence == f"they are images as the scene has them; {size}"
    assert not found.is_wanted
    folder = made(scene, tmp_path / "turned", resized("PIL bicubic"))
    files = sorted(folder.iterdir())
    for number, file in enumerate(files):
        file.rename(folder / f"{(number + 1) % len(files):05d}.png")
    assert lint_images(folder, scene).strangers
    (folder / "00000.png").rename(folder / "other.png")
    with pytest.raises(MetricError, match=r"METRIC_IMAGE_NAMES: .*8 images have no view's name"):
        lint_images(folder, scene)


@pytest.mark.slow
def test_renderings_are_held_against_each_version(scene: Scene, tmp_path: Path, msb: Msb) -> None:
    """A model that has learned the photographs of one version, but for a little noise."""
    random = np.random.default_rng(1)

    def learned(image: Image.Image) -> Image.Image:
        pixels = np.asarray(resized("PIL bicubic")(image)).astype(float)
        return Image.fromarray(np.clip(pixels + random.normal(0, 10, pixels.shape), 0, 255).astype(np.uint8))

    folder = tmp_path / "ours_1"
    folder.mkdir()
    renders = made(scene, folder / "renders", learned)
    alone = lint_images(renders, scene)
    assert (alone.best, alone.photographs, alone.is_wanted) == (
        Version("images", "PIL bicubic"),
        False,
        False,
    )
    made(scene, folder / "gt", resized("PIL bicubic"))
    found = lint_images(folder, scene)
    assert found.cost is not None
    assert alone.best is not None
    assert found.cost == pytest.approx(alone.versions[alone.best] - alone.versions[AS_IT_IS], abs=0.1)
    told = msb("eval", "--lint", folder, scene.root)
    assert told.status == 1
    assert f"images resized by PIL bicubic, not {AS_IT_IS}: the renderings score" in told.out
    assert msb("eval", "-q", "--json", "-", "--lint", scene.root / "images_4", scene.root).json["is_wanted"]


def test_a_rendering_is_held_against_the_photograph_of_its_own_view(scene: Scene, tmp_path: Path) -> None:
    folder = tmp_path / "ours_1"
    folder.mkdir()
    renders = made(scene, folder / "renders", resized("PIL bicubic"))
    shutil.copytree(renders, folder / "gt")
    views = sorted(renders.iterdir())
    whole = lint_images(folder, scene)
    assert whole.cost is not None
    views[-1].unlink()
    said = rf"METRIC_IMAGE_NAMES: {re.escape(str(folder))}: .*{views[-1].stem}.* in one of gt and renders"
    with pytest.raises(MetricError, match=said):
        lint_images(folder, scene)
    # As many images of other views are no pairs, either.
    (folder / "gt" / views[0].name).unlink()
    with pytest.raises(MetricError, match="METRIC_IMAGE_NAMES"):
        lint_images(folder, scene)


def test_renderings_between_two_versions_tell_nothing(scene: Scene, tmp_path: Path) -> None:
    random = np.random.default_rng(2)

    def between(image: Image.Image) -> Image.Image:
        pixels = [np.asarray(resized(by)(image), float) for by in ("PIL bicubic", "PIL Lanczos")]
        noisy = np.mean(pixels, axis=0) + random.normal(0, 10, pixels[0].shape)
        return Image.fromarray(np.clip(noisy, 0, 255).astype(np.uint8))

    found = lint_images(made(scene, tmp_path / "renders", between), scene)
    assert (found.told, found.is_wanted) == (False, True)
    assert found.sentence.startswith("it cannot be told; nearest is images resized by PIL ")

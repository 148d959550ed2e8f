"""Empty paths, and file names in another Unicode normal form."""

import shutil
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import msb
from msb import metrics
from msb.adapters.exporter import detect
from msb.asset import validate
from msb.base.paths import SpelledFiles
from msb.errors import InputError, MetricError
from msb.metrics.dtu_data import read_dtu_scan
from msb.render.options import ViewOptions
from msb.scenes.datasets import read_scene
from tests.conftest import ROOT

SCENE = ROOT / "tests" / "tiny" / "scenes" / "nerf_synthetic" / "pebble"
COLMAP = ROOT / "tests" / "tiny" / "scenes" / "tanksandtemples" / "pebble"
COMPOSED, DECOMPOSED = (unicodedata.normalize(form, "caf\u00e9") for form in ("NFC", "NFD"))


# --- empty paths ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "read",
    [
        msb.load,
        msb.export,
        msb.read_cameras,
        validate,
        detect,
        read_scene,
        metrics.read_image,
        lambda path: metrics.pair_images(path, ROOT),
        lambda path: metrics.pair_images(ROOT, path),
        lambda path: read_dtu_scan(path, 1),
    ],
)
def test_an_empty_path_is_not_the_current_folder(
    read: Callable[[str], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(COLMAP)
    with pytest.raises(InputError, match="FILE_NOT_FOUND"):
        read("")


# --- normal forms --------------------------------------------------------------------------------------


@pytest.fixture
def both_forms(tmp_path: Path) -> None:
    """Skip the test if the file system treats both Unicode forms as the same name (macOS)."""
    (tmp_path / COMPOSED).touch()
    if (tmp_path / DECOMPOSED).exists():
        pytest.skip("this file system treats both forms as the same name")
    (tmp_path / COMPOSED).unlink()


def picture(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return shutil.copy(ROOT / "tests" / "golden" / "metrics" / "gt" / "r_0.png", path)


@pytest.mark.usefixtures("both_forms")
def test_images_are_paired_across_normal_forms(tmp_path: Path) -> None:
    pred = picture(tmp_path / "pred" / DECOMPOSED / f"{DECOMPOSED}.png")
    gt = picture(tmp_path / "gt" / COMPOSED / f"{COMPOSED}.png")
    pairs = metrics.pair_images(tmp_path / "pred", tmp_path / "gt")
    assert pairs == [(f"{COMPOSED}/{COMPOSED}", pred, gt)]


@pytest.mark.usefixtures("both_forms")
def test_two_images_with_the_same_name_in_two_normal_forms_are_rejected(tmp_path: Path) -> None:
    for name in (COMPOSED, DECOMPOSED):
        picture(tmp_path / "pred" / f"{name}.png")
    with pytest.raises(MetricError, match="METRIC_IMAGE_NAMES"):
        metrics.pair_images(tmp_path / "pred", tmp_path / "pred")
    with pytest.raises(InputError, match="FILE_UNREADABLE"):
        SpelledFiles(tmp_path / "pred").find(f"{COMPOSED}.png")


def renamed(folder: Path, file: str, old: str, new: str) -> None:
    (folder / file).write_text((folder / file).read_text("utf-8").replace(old, new), "utf-8")


@pytest.mark.usefixtures("both_forms")
def test_cameras_find_photographs_across_normal_forms(tmp_path: Path) -> None:
    scene = shutil.copytree(SCENE, tmp_path / "pebble")
    renamed(scene, "transforms_test.json", "test/r_0", f"{COMPOSED}/r_{COMPOSED}_0")
    for photograph in (scene / "test").glob("r_0*"):
        picture = scene / DECOMPOSED / photograph.name.replace("r_0", f"r_{DECOMPOSED}_0")
        picture.parent.mkdir(exist_ok=True)
        photograph.rename(picture)
    for cameras in (read_scene(scene, dataset="nerf_synthetic").test, msb.read_cameras(scene)):
        (camera,) = (one for one in cameras if COMPOSED in str(one.name))
        assert camera.image_path.is_file()
    assert ViewOptions(camera=(f"r_{DECOMPOSED}_0",)).of(list(cameras)) == [camera]
    (view,) = pytest.importorskip("msb_viewers.deployment.views").dataset_views([camera], scene)
    assert view.photograph == camera.image_path

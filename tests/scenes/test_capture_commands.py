"""`msb scenes --undistort` and `msb capture`: the scenes that they write."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from msb.metrics.ground_truth import ground_truth
from msb.scenes import read_cameras, read_points, read_scene
from msb.scenes.datasets import Scene
from tests.cli.conftest import Msb, msb
from tests.conftest import ROOT
from tests.scenes.datasets.test_captures import HEIGHT, NAMES, WIDTH, capture, pixels, save

__all__ = ["msb"]  # fixture
TINY = ROOT / "tests" / "tiny" / "scenes"


def photographs(scene: Scene) -> dict[str, np.ndarray]:
    """Return the prepared photographs of a scene by file name."""
    return {Path(str(c.name)).name: ground_truth(scene, c) for c in (*scene.train, *scene.test)}


def test_the_undistorted_copy_gives_the_same_images(msb: Msb, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    lists = {"train_filenames": NAMES[3:], "test_filenames": NAMES[:3]}
    root = capture(tmp_path / "raw", edit=lambda document: document.update(k1=0.2, p1=0.01, **lists))
    (root / "images" / NAMES[5]).unlink()
    for index, name in enumerate(NAMES):
        save(pixels(index)[..., 0], root / "masks" / name)
    msb("scenes --undistort", tmp_path / "out", root, status=0)
    raw, copy = read_scene(root), read_scene(tmp_path / "out")
    assert (copy.layout, copy.readings, copy.split, copy.mask_source) == (
        "colmap", {}, "recorded", "mask_folder"
    )  # fmt: skip
    assert [Path(str(c.name)).name for c in raw.test] == [str(c.name) for c in copy.test] == NAMES[:3]
    ours, theirs = photographs(raw), photographs(copy)
    assert len(ours) == len(NAMES) - 1
    for name, image in ours.items():
        np.testing.assert_array_equal(image, theirs[name])
    for before, after in zip(raw.test, copy.test, strict=True):
        np.testing.assert_allclose(before.K, after.K)
        np.testing.assert_allclose(before.world_to_camera, after.world_to_camera, atol=1e-12)


def test_a_benchmark_scene_is_copied_in_its_full_size(msb: Msb, tmp_path: Path) -> None:
    msb("scenes --undistort", tmp_path / "out", TINY / "dtu/scan1", status=0)
    copy = read_scene(tmp_path / "out")
    assert (copy.test[0].width, copy.test[0].height, copy.mask_source) == (144, 108, "png_alpha")
    np.testing.assert_array_equal(read_points(tmp_path / "out")[0], read_points(TINY / "dtu/scan1")[0])


def test_kinds_of_images_are_converted(msb: Msb, tmp_path: Path) -> None:
    names = [name.replace(".png", ".webp") for name in NAMES]
    root = capture(tmp_path / "raw", names)
    refused = msb("scenes", root, status=3)
    assert "--undistort" in refused.err
    msb("scenes --undistort", tmp_path / "out", root, status=0)
    scene = read_scene(tmp_path / "out")
    assert {str(camera.name) for camera in (*scene.train, *scene.test)} == set(names)


@pytest.mark.slow
def test_folders_of_others_are_not_replaced(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "diary.txt").write_text("dear diary")
    for force in ("", "--force"):
        result = msb(f"scenes {force} --undistort", tmp_path / "mine", TINY / "dtu/scan1", status=2)
        assert "OUTPUT_EXISTS" in result.err
    msb("scenes --undistort", tmp_path / "out", TINY / "dtu/scan1", status=0)
    msb("scenes --undistort", tmp_path / "out", TINY / "dtu/scan1", status=2)
    msb("scenes --force --undistort", tmp_path / "out", TINY / "dtu/scan1", status=0)


def test_two_photographs_are_not_enough(msb: Msb, tmp_path: Path) -> None:
    for index in range(2):
        save(pixels(index), tmp_path / f"{index}.png")
    assert "CAPTURE_FAILED" in msb("capture -o", tmp_path / "out", tmp_path, status=3).err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_photographs_without_texture_have_no_poses(msb: Msb, tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    for index in range(3):
        save(np.full((HEIGHT, WIDTH, 3), 90 + index, np.uint8), tmp_path / "in" / f"{index}.png")
    assert "CAPTURE_FAILED" in msb("capture -o", tmp_path / "out", tmp_path / "in", status=3).err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_every_third_photograph_of_the_plush_is_placed(msb: Msb, shared: Path, tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    raw = shared / "captures/plush/raw"
    if not raw.is_dir():
        pytest.skip("the plush capture is missing")
    (tmp_path / "in").mkdir()
    for photograph in sorted((raw / "images").iterdir())[::3]:
        shutil.copy(photograph, tmp_path / "in")
    result = msb("capture --json - -o", tmp_path / "out", tmp_path / "in", status=0)
    report = json.loads(result.out)
    assert (report["photographs"], report["lens"]["model"]) == (33, "SIMPLE_RADIAL")
    assert report["registered"] >= 30
    assert report["reprojection_error"] < 1
    # Align the centres of the cameras to the given ones by a similarity, then compare.
    given = {camera.name: camera for camera in read_cameras(raw)}
    pairs = [(camera, given[camera.name]) for camera in read_cameras(tmp_path / "out")]
    ours, theirs = (np.stack([pair[k].center for pair in pairs]) for k in (0, 1))
    a, b = ours - ours.mean(axis=0), theirs - theirs.mean(axis=0)
    left, stretch, right = np.linalg.svd(b.T @ a)
    sign = np.diag([1, 1, np.linalg.det(left @ right)])
    turn = left @ sign @ right
    scale = np.trace(np.diag(stretch) @ sign) / (a**2).sum()
    error = np.linalg.norm(scale * a @ turn.T - b, axis=1)
    assert error.mean() < 0.006 * np.linalg.norm(b, axis=1).max()
    angles = [
        np.degrees(np.arccos(np.clip((np.trace(t[:3, :3] @ turn @ o[:3, :3].T) - 1) / 2, -1, 1)))
        for o, t in ((o.world_to_camera, t.world_to_camera) for o, t in pairs)
    ]
    assert np.mean(angles) < 0.5
    # The scene is one that all commands read.
    with Image.open(tmp_path / "out/images" / str(pairs[0][0].name)) as image:
        assert image.size == (pairs[0][0].width, pairs[0][0].height)
    assert len(read_scene(tmp_path / "out").test) == 5

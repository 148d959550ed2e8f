"""Scenes with a file missing or wrong: one error that names it and says what would be right."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from msb.errors import InputError, SceneError
from msb.scenes.datasets import find_scenes, read_scene

from .conftest import SCENES, STUBS, Copy, text_model


def picture(path: Path, size: tuple[int, int], mode: str = "RGB") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new(mode, size).save(path)


def no_model(root: Path) -> None:
    for file in (root / "sparse/0").iterdir():
        file.unlink()


def one_image(lens: str) -> Callable[[Path], None]:
    return lambda root: text_model(root, f"1 {lens}\n", "1 1 0 0 0 0 0 4 1 DSC07950.JPG\n\n")


def same_name_twice(root: Path) -> None:
    data = (root / "sparse/0/images.bin").read_bytes()
    (root / "sparse/0/images.bin").write_bytes(data.replace(b"DSC07951", b"DSC07950"))


def remove(*names: str) -> Callable[[Path], None]:
    def run(root: Path) -> None:
        for name in names:
            path = root / name
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    return run


def opaque(folder: str) -> Callable[[Path], None]:
    def run(root: Path) -> None:
        for path in (root / folder).glob("*.png"):
            with Image.open(path) as image:
                rgb = image.convert("RGB")
            rgb.save(path)

    return run


def both(*changes: Callable[[Path], None]) -> Callable[[Path], None]:
    def run(root: Path) -> None:
        for change in changes:
            change(root)

    return run


MIP, _, NERF, DTU = SCENES
BAD: dict[str, tuple[str, Callable[[Path], Any], str, str, str]] = {
    "no layout": (MIP, remove("sparse"), "SCENE_LAYOUT", "", "it holds no scene: no sparse/0"),
    "empty sparse": (MIP, no_model, "SCENE_LAYOUT", "", "sparse/0 holds no COLMAP model"),
    "half a model": (MIP, remove("sparse/0/cameras.bin"), "COLMAP_FILE_MISSING", "sparse/0", "cameras.bin"),
    "test JSON missing": (
        NERF,
        remove("transforms_test.json"),
        "SCENE_LAYOUT",
        "",
        "transforms_test.json is",
    ),
    "photograph of a JSON missing": (
        NERF,
        remove("test/r_1.png"),
        "CAMERA_IMAGE",
        "transforms_test.json",
        "r_1",
    ),
    "all photographs missing": (
        MIP,
        lambda root: [path.unlink() for path in (root / "images_4").iterdir()],
        "SCENE_IMAGE_MISSING",
        "images_4",
        "16 of 16 photographs are not there: DSC07951.JPG, DSC07952.JPG, DSC07953.JPG, DSC07954.JPG, ...",
    ),
    "folder of photographs missing": (
        MIP,
        remove("images_4", "images"),
        "SCENE_IMAGE_MISSING",
        "",
        "taken from images_4, which is not there; there is images_2",
    ),
    "photograph of another size": (
        MIP,
        lambda root: picture(root / "images_4/DSC07953.JPG", (64, 47)),
        "SCENE_IMAGE",
        "images_4/DSC07953.JPG",
        "it is 64 x 47 pixels, DSC07951.JPG 64 x 48",
    ),
    "photograph that is none": (
        MIP,
        lambda root: (root / "images_4/DSC07953.JPG").write_bytes(b"GIF89a"),
        "CAMERA_IMAGE",
        "images_4/DSC07953.JPG",
        "neither a PNG nor a JPEG",
    ),
    "distorted": (
        MIP,
        one_image("SIMPLE_RADIAL 256 192 270 128 96 0.01"),
        "CAMERA_DISTORTED",
        "sparse/0/cameras.txt",
        "SIMPLE_RADIAL",
    ),
    "same name twice": (MIP, same_name_twice, "CAMERA_FILE", "sparse/0", "DSC07950.JPG"),
    "one image": (
        MIP,
        one_image("PINHOLE 256 192 270 270 128 96"),
        "SCENE_LAYOUT",
        "",
        "none of its 1 views is a training view",
    ),
    "no alpha": (
        NERF,
        opaque("test"),
        "SCENE_IMAGE",
        "",
        "4 of 4 test photographs have no alpha channel, test/r_0.png for one; they must be RGBA PNG",
    ),
    "neither alpha nor masks": (
        DTU,
        both(opaque("images"), remove("mask")),
        "SCENE_IMAGE",
        "",
        "or have masks in a folder mask",
    ),
    "a mask missing": (
        DTU,
        both(opaque("images"), remove("mask/003.png")),
        "SCENE_IMAGE",
        "mask",
        "there are 15 masks in it for 16 photographs",
    ),
    "a mask of another size": (
        DTU,
        both(opaque("images"), lambda root: picture(root / "mask/000.png", (20, 20))),
        "SCENE_IMAGE",
        "mask/000.png",
        "it is 20 x 20 pixels, its photograph 144 x 108",
    ),
    "more views than photographs": (
        DTU,
        remove("sparse", "images/0003.png"),
        "SCENE_LAYOUT",
        "cameras.npz",
        "it has 16 views for 15 photographs",
    ),
}
ARGUMENTS: dict[str, tuple[str, dict[str, Any], str, str]] = {
    "no rule": (DTU, {"rules": "two_dts"}, "SCENE_UNKNOWN", "2DTS has no rule for the dataset dtu"),
    "rules": (MIP, {"rules": "nerf"}, "SCENE_ARGUMENT", "there are no rules 'nerf'; there are ours"),
    "convention": (MIP, {"camera_convention": "K"}, "SCENE_ARGUMENT", "gs_fov or full_K"),
    "resolution": (MIP, {"resolution": 0}, "SCENE_ARGUMENT", "1, 2, 4 or 8"),
    "background": (MIP, {"background": (1, 2, 0)}, "SCENE_ARGUMENT", "from 0 to 1"),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_bad_scene(name: str, copy: Copy) -> None:
    place, change, code, file, message = BAD[name]
    root = copy(place)
    change(root)
    assert_refused(root, code, str(root / file), message)


@pytest.mark.parametrize("name", ARGUMENTS)
def test_bad_arguments(name: str) -> None:
    place, options, code, message = ARGUMENTS[name]
    root = STUBS / place
    assert_refused(root, code, None if code == "SCENE_ARGUMENT" else str(root), message, **options)


def assert_refused(root: Path, code: str, file: str | None, message: str, **options: Any) -> None:
    with pytest.raises(SceneError) as caught:
        read_scene(root, **options)
    error = caught.value
    assert (error.code, error.file) == (code, file)
    assert message in error.message
    assert str(error).isprintable()
    assert len(error.message) < 300


def test_every_error_code_is_met() -> None:
    warnings = {"SCENE_IMAGE_RESIZED", "SCENE_PRINCIPAL_POINT"}
    registered = {code for code in SceneError.codes if code.startswith("SCENE_")}
    assert {bad[2] for bad in (*BAD.values(), *ARGUMENTS.values())} | warnings >= registered


def test_a_folder_of_scenes_is_no_scene() -> None:
    with pytest.raises(SceneError, match=r"SCENE_LAYOUT: .* holds 4: dtu/scan1, mipnerf360/pebble, ner"):
        read_scene(STUBS)


def test_no_folder(tmp_path: Path) -> None:
    for find in (read_scene, find_scenes):
        with pytest.raises(InputError, match="FILE_NOT_FOUND"):
            find(tmp_path / "nowhere")

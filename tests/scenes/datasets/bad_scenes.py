"""Invalid scenes by name: stub scene, modification, error code, and the file that the error names."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

from msb.scenes.datasets import read_scene

from .conftest import SCENES, STUBS, text_model


def write_image(path: Path, size: tuple[int, int], mode: str = "RGB") -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new(mode, size).save(path)


def keep_one_image(lens: str) -> Callable[[Path], None]:
    return lambda root: text_model(root, f"1 {lens}\n", "1 1 0 0 0 0 0 4 1 DSC07950.JPG\n\n")


def repeat_name(root: Path) -> None:
    data = (root / "sparse/0/images.bin").read_bytes()
    (root / "sparse/0/images.bin").write_bytes(data.replace(b"DSC07951", b"DSC07950"))


def remove(*names: str) -> Callable[[Path], None]:
    def run(root: Path) -> None:
        for name in names:
            path = root / name
            shutil.rmtree(path) if path.is_dir() else path.unlink()

    return run


def remove_alpha(folder: str) -> Callable[[Path], None]:
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
BAD: dict[str, tuple[str, Callable[[Path], Any], str, str]] = {
    "no layout": (MIP, remove("sparse"), "SCENE_LAYOUT", ""),
    "half a model": (MIP, remove("sparse/0/cameras.bin"), "COLMAP_FILE_MISSING", "sparse/0"),
    "test JSON missing": (NERF, remove("transforms_test.json"), "SCENE_LAYOUT", ""),
    "photograph of a JSON missing": (NERF, remove("test/r_1.png"), "SCENE_IMAGE_MISSING", "test"),
    "all photographs missing": (
        MIP,
        lambda root: [path.unlink() for path in (root / "images_4").iterdir()],
        "SCENE_IMAGE_MISSING",
        "images_4",
    ),
    "folder of photographs missing": (MIP, remove("images_4", "images"), "SCENE_IMAGE_MISSING", ""),
    "photograph of another size": (
        MIP,
        lambda root: write_image(root / "images_4/DSC07953.JPG", (64, 47)),
        "SCENE_IMAGE",
        "images_4/DSC07953.JPG",
    ),
    "panorama": (
        MIP,
        keep_one_image("EQUIRECTANGULAR 256 192"),
        "CAMERA_DISTORTED",
        "sparse/0/cameras.txt",
    ),
    "same name twice": (MIP, repeat_name, "CAMERA_FILE", "sparse/0"),
    "one image": (MIP, keep_one_image("PINHOLE 256 192 270 270 128 96"), "SCENE_LAYOUT", ""),
    "no alpha": (NERF, remove_alpha("test"), "SCENE_IMAGE", ""),
    "a mask missing": (DTU, both(remove_alpha("images"), remove("mask/003.png")), "SCENE_IMAGE", "mask"),
    "a mask of another size": (
        DTU,
        both(remove_alpha("images"), lambda root: write_image(root / "mask/000.png", (20, 20))),
        "SCENE_IMAGE",
        "mask/000.png",
    ),
    "more views than photographs": (DTU, remove("sparse", "images/0003.png"), "SCENE_LAYOUT", "cameras.npz"),
}


def read_case(name: str, root: Path) -> Any:
    """Write the scene of a case below `root`, and read it."""
    place, change, *_ = BAD[name]
    scene = shutil.copytree(STUBS / place, root / place)
    change(scene)
    return read_scene(scene)

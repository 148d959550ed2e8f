"""Captures as they come: lenses, EXIF orientations, missing frames, masks, splits and misleading names."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from msb.errors import SceneError
from msb.metrics.ground_truth import ground_truth
from msb.scenes import Camera
from msb.scenes.datasets import Scene, read_scene
from msb.scenes.upright import find_up
from tests.scenes.builders import transforms

WIDTH, HEIGHT = 48, 36
NAMES = [f"im_{index:02d}.png" for index in range(17)]


def pixels(index: int) -> NDArray[np.uint8]:
    """Return a smooth image that differs between views."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    planes = (u * 5 + index, v * 7, (u + v) * 2 + 3 * index)
    return np.stack([plane % 256 for plane in planes], axis=-1).astype(np.uint8)


def cameras(names: Sequence[str] = NAMES, size: tuple[int, int] = (WIDTH, HEIGHT)) -> list[Camera]:
    views = []
    for index, name in enumerate(names):
        angle = 2 * np.pi * index / len(names)
        eye = (5 * np.cos(angle), 5 * np.sin(angle), 1.5)
        camera = Camera.look_at(eye, (0, 0, 0), up=(0, 0, 1), width=size[0], height=size[1], fov_y=0.7)
        views.append(Camera(*size, 60, 60, size[0] / 2, size[1] / 2, camera.world_to_camera, name))
    return views


def save(image: NDArray[np.uint8], place: Path, **options: Any) -> None:
    place.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(image).save(place, **options)


def capture(
    root: Path,
    names: Sequence[str] = NAMES,
    *,
    folder: str = "images",
    edit: Callable[[dict[str, Any]], object] = lambda document: None,
) -> Path:
    """Write transforms.json and its photographs; `edit` changes the document."""
    document = transforms(cameras(names))
    for frame, name in zip(document["frames"], names, strict=True):
        frame["file_path"] = f"{folder}/{name}"
    edit(document)
    for index, name in enumerate(names):
        save(pixels(index), root / folder / name)
    (root / "transforms.json").write_text(json.dumps(document))
    return root


def colmap(root: Path, names: Sequence[str], lens: str) -> Path:
    """Write a COLMAP model in text format with one camera."""
    (root / "sparse/0").mkdir(parents=True)
    (root / "sparse/0/cameras.txt").write_text(f"1 {lens}\n")
    lines = [f"{i} 1 0 0 0 {i} 0 5 1 {name}\n\n" for i, name in enumerate(names, 1)]
    (root / "sparse/0/images.txt").write_text("".join(lines))
    return root


def held_out(scene: Scene) -> list[str]:
    return [str(camera.name).removeprefix("images/") for camera in scene.test]


def messages(scene: Scene, code: str) -> list[str]:
    return [warning.message for warning in scene.warnings if warning.code == code]


# --- lenses


@pytest.mark.parametrize("layout", ["colmap", "transforms"])
def test_photographs_of_a_lens_are_undistorted(layout: str, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    root = capture(tmp_path, edit=lambda document: document.update(k1=-0.4))
    if layout == "colmap":
        colmap(root, NAMES, f"SIMPLE_RADIAL {WIDTH} {HEIGHT} 60 24 18 -0.4")
    scene = read_scene(root)
    view = scene.test[0]
    assert scene.lens is not None
    assert scene.lens.distortion is not None
    assert view.distortion is None
    assert view.width > WIDTH  # barrel distortion
    image = ground_truth(scene, view)
    assert image.shape == (view.height, view.width, 3)
    assert not scene.gt_resized
    # The middle of the image is unchanged.
    np.testing.assert_allclose(
        image[view.height // 2, view.width // 2] * 255, pixels(0)[HEIGHT // 2, WIDTH // 2], atol=3
    )
    half = read_scene(root, resolution=2)
    assert (half.test[0].width, half.test[0].height) == (round(view.width / 2), round(view.height / 2))
    assert half.gt_resized
    assert ground_truth(half, half.test[0]).shape[:2] == (half.test[0].height, half.test[0].width)


# --- EXIF orientations


@pytest.mark.parametrize(("orientation", "turn"), [(5, "T"), (6, "L"), (7, "A"), (8, "R")])
def test_an_orientation_is_applied_if_the_cameras_are_of_the_turned_size(
    orientation: int, turn: str, tmp_path: Path
) -> None:
    stored = {
        "T": lambda image: image.swapaxes(0, 1),
        "L": lambda image: np.rot90(image, 1),
        "A": lambda image: np.rot90(image, 2).swapaxes(0, 1),
        "R": lambda image: np.rot90(image, -1),
    }[turn]
    exif = Image.Exif()
    exif[0x0112] = orientation
    root = colmap(tmp_path, NAMES, f"PINHOLE {WIDTH} {HEIGHT} 60 60 24 18")
    for index, name in enumerate(NAMES):
        save(np.ascontiguousarray(stored(pixels(index))), root / "images" / name, exif=exif)
    scene = read_scene(root)
    assert (scene.test[0].width, scene.test[0].height) == (WIDTH, HEIGHT)
    assert np.array_equal(np.rint(ground_truth(scene, scene.test[0]) * 255), pixels(0))
    (note,) = messages(scene, "SCENE_IMAGE")
    assert "EXIF" in note
    # Cameras of the stored size, as COLMAP records them, keep the stored pixels.
    root = colmap(tmp_path / "stored", NAMES, f"PINHOLE {HEIGHT} {WIDTH} 60 60 18 24")
    for index, name in enumerate(NAMES):
        save(np.ascontiguousarray(stored(pixels(index))), root / "images" / name, exif=exif)
    scene = read_scene(root)
    assert np.array_equal(np.rint(ground_truth(scene, scene.test[0]) * 255), stored(pixels(0)))
    assert {warning.severity for warning in scene.warnings} == {"info"}


@pytest.mark.parametrize(("orientation", "size"), [(3, (WIDTH, HEIGHT)), (6, (HEIGHT, HEIGHT))])
def test_an_undecided_orientation_is_reported(
    orientation: int, size: tuple[int, int], tmp_path: Path
) -> None:
    exif = Image.Exif()
    exif[0x0112] = orientation
    root = colmap(tmp_path, NAMES, f"PINHOLE {size[0]} {size[1]} 60 60 {size[0] / 2} {size[1] / 2}")
    for index, name in enumerate(NAMES):
        save(pixels(index)[:, : size[0]], root / "images" / name, exif=exif)
    (warning,) = read_scene(root).warnings
    assert (warning.code, warning.severity) == ("SCENE_IMAGE", "warning")
    assert "EXIF" in warning.message


# --- missing frames and kinds of files


def test_frames_without_a_photograph_are_left_out_before_the_split(tmp_path: Path) -> None:
    root = capture(tmp_path)
    assert held_out(read_scene(root)) == NAMES[::8]
    for name in (NAMES[0], NAMES[3]):
        (root / "images" / name).unlink()
    scene = read_scene(root)
    kept = [name for name in NAMES if name not in (NAMES[0], NAMES[3])]
    assert held_out(scene) == kept[::8]
    assert len(scene.train) + len(scene.test) == 15
    assert scene.missing == {"training": 1, "test": 1}
    assert len(messages(scene, "SCENE_IMAGE_MISSING")) == 1


def test_a_frame_without_size_and_photograph_is_left_out(tmp_path: Path) -> None:
    def edit(document: dict[str, Any]) -> None:
        for frame in document["frames"]:
            del frame["w"], frame["h"]

    root = capture(tmp_path, edit=edit)
    (root / "images" / NAMES[0]).unlink()
    assert read_scene(root).missing == {"training": 0, "test": 1}


@pytest.mark.parametrize("other", ["im_{:02d}.jpg", "IM_{:02d}.PNG", "im_{:02d}.PNG"])
def test_near_misses_are_named(other: str, tmp_path: Path) -> None:
    root = colmap(tmp_path, NAMES, f"PINHOLE {WIDTH} {HEIGHT} 60 60 24 18")
    for index in range(len(NAMES)):
        save(pixels(index), root / "images" / other.format(index))
    if (root / "images" / NAMES[0]).exists():
        pytest.skip("this file system ignores case")
    with pytest.raises(SceneError) as caught:
        read_scene(root)
    assert caught.value.code == "SCENE_IMAGE_MISSING"
    assert other.format(1) in caught.value.message


@pytest.mark.parametrize(("kind", "mode"), [("WebP", "RGB"), ("grey", "L"), ("PNG", "P")])
def test_kinds_that_are_not_compared_are_named(kind: str, mode: str, tmp_path: Path) -> None:
    names = [name.replace(".png", ".webp") if kind == "WebP" else name for name in NAMES]
    root = colmap(tmp_path, names, f"PINHOLE {WIDTH} {HEIGHT} 60 60 24 18")
    (root / "images").mkdir()
    for index, name in enumerate(names):
        Image.fromarray(pixels(index)).convert(mode).save(root / "images" / name)
    with pytest.raises(SceneError, match="SCENE_IMAGE") as caught:
        read_scene(root)
    if mode != "P":
        assert kind in caught.value.message
        assert len(read_scene(root, converts=True).test) == 3


def test_tiff_photographs_are_read(tmp_path: Path) -> None:
    names = [name.replace(".png", ".tif") for name in NAMES]
    scene = read_scene(capture(tmp_path, names))
    assert np.array_equal(np.rint(ground_truth(scene, scene.test[0]) * 255), pixels(0))


def test_a_smaller_copy_takes_the_place_of_the_folder_in_file_path(tmp_path: Path) -> None:
    root = capture(tmp_path)
    for index, name in enumerate(NAMES):
        save(pixels(index)[::2, ::2], root / "images_2" / name)
    scene = read_scene(root, image_folder="images_2")
    assert (scene.test[0].width, scene.test[0].height) == (WIDTH // 2, HEIGHT // 2)
    assert held_out(scene) == NAMES[::8]


# --- masks


@pytest.mark.parametrize("how", ["mask_path", "masks/{}", "masks/{}.png", "mask/{}"])
@pytest.mark.parametrize("scale", [1, 2])
def test_masks_replace_the_outside_by_the_background(how: str, scale: int, tmp_path: Path) -> None:
    def edit(document: dict[str, Any]) -> None:
        if how == "mask_path":
            for frame, name in zip(document["frames"], NAMES, strict=True):
                frame["mask_path"] = f"./cut/{name}"

    root = capture(tmp_path, edit=edit)
    mask = np.zeros((HEIGHT * scale, WIDTH * scale), np.uint8)
    mask[:, : WIDTH * scale // 2] = 255
    for name in NAMES:
        save(mask, root / (f"cut/{name}" if how == "mask_path" else how.format(name)))
    scene = read_scene(root, background=(0, 0, 1))
    assert scene.mask_source == ("mask_path" if how == "mask_path" else "mask_folder")
    image = np.rint(ground_truth(scene, scene.train[0]) * 255)
    assert np.array_equal(image[:, : WIDTH // 2 - 2], pixels(1)[:, : WIDTH // 2 - 2])
    assert (image[:, WIDTH // 2 + 2 :] == (0, 0, 255)).all()


def test_views_without_a_mask_are_not_masked(tmp_path: Path) -> None:
    root = capture(tmp_path)
    save(np.zeros((HEIGHT, WIDTH), np.uint8), root / "masks" / NAMES[0])
    scene = read_scene(root)
    assert np.array_equal(np.rint(ground_truth(scene, scene.train[0]) * 255), pixels(1))
    assert not ground_truth(scene, scene.test[0]).any()
    assert len(messages(scene, "SCENE_IMAGE")) == 1


def test_a_mask_of_another_shape_is_an_error(tmp_path: Path) -> None:
    root = capture(tmp_path)
    save(np.zeros((HEIGHT, HEIGHT // 2), np.uint8), root / "masks" / NAMES[0])
    with pytest.raises(SceneError, match="SCENE_IMAGE"):
        read_scene(root)


def test_masks_are_undistorted_like_their_photographs(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    root = capture(tmp_path, edit=lambda document: document.update(k1=0.3))
    for index, name in enumerate(NAMES):
        save(np.where(pixels(index)[..., 0] > 100, 255, 0).astype(np.uint8), root / "masks" / name)
    scene = read_scene(root, background=(0, 0, 0))
    masked, whole = (
        ground_truth(replace(scene, mask_source=source), scene.test[0]) * 255
        for source in (scene.mask_source, None)
    )
    red = whole[..., 0]
    assert not masked[red < 90].any()
    assert np.array_equal(masked[red > 110], whole[red > 110])


# --- splits


@pytest.mark.parametrize("spelling", ["images/{}", "./images/{}", "{}", "stem"])
def test_the_split_of_transforms_json_is_used(spelling: str, tmp_path: Path) -> None:
    def spell(name: str) -> str:
        return name.removesuffix(".png") if spelling == "stem" else spelling.format(name)

    chosen = NAMES[4:8]
    lists = {
        "train_filenames": [spell(name) for name in NAMES[8:]],
        "val_filenames": [spell(name) for name in NAMES[:2]],
        "test_filenames": [spell(name) for name in chosen],
    }
    scene = read_scene(capture(tmp_path, edit=lambda document: document.update(lists)))
    assert scene.split == "recorded"
    assert held_out(scene) == chosen
    assert len(scene.train) == 9
    (note,) = messages(scene, "SCENE_LAYOUT")  # four views are in no list, or for validation only
    assert "4 of 17" in note


def test_validation_views_are_test_views_if_there_are_no_others(tmp_path: Path) -> None:
    lists = {"train_filenames": NAMES[2:], "val_filenames": NAMES[:2], "test_filenames": []}
    scene = read_scene(capture(tmp_path, edit=lambda document: document.update(lists)))
    assert (held_out(scene), scene.split) == (NAMES[:2], "recorded")


@pytest.mark.parametrize("file", ["test_list.txt", "sparse/0/test.txt"])
def test_lists_beside_a_colmap_model_are_used(file: str, tmp_path: Path) -> None:
    root = colmap(tmp_path, NAMES, f"PINHOLE {WIDTH} {HEIGHT} 60 60 24 18")
    for index, name in enumerate(NAMES):
        save(pixels(index), root / "images" / name)
    (root / file).write_text("im_05\r\nim_06.png\n\nnot_there.png\n")
    scene = read_scene(root)
    assert (held_out(scene), len(scene.train), scene.split) == (["im_05.png", "im_06.png"], 15, "recorded")
    assert len(messages(scene, "SCENE_LAYOUT")) == 1
    assert read_scene(root, rules="two_dgs").split == "benchmark"


def test_transforms_of_training_and_validation_are_a_split(tmp_path: Path) -> None:
    root = capture(tmp_path)
    document = json.loads((root / "transforms.json").read_text())
    (root / "transforms.json").unlink()
    for part, frames in (("train", document["frames"][:10]), ("val", document["frames"][10:])):
        (root / f"transforms_{part}.json").write_text(json.dumps(document | {"frames": frames}))
    scene = read_scene(root)
    assert (len(scene.train), held_out(scene), scene.split) == (10, NAMES[10:], "recorded")


# --- names


@pytest.mark.parametrize("place", ["room", "garden", "chair", "scan24", "360_v2/mine", "dtu/mine", "train"])
def test_names_of_benchmark_scenes_do_not_matter(place: str, tmp_path: Path) -> None:
    root = colmap(tmp_path / place, NAMES, f"PINHOLE {WIDTH} {HEIGHT} 60 60 24 18")
    for index, name in enumerate(NAMES):
        save(pixels(index), root / "images" / name)
    scene = read_scene(root)
    assert (scene.dataset, scene.test[0].width) == ("custom", WIDTH)
    if place == "room":
        assert [warning.code for warning in scene.warnings] == ["SCENE_UNKNOWN"]
        assert read_scene(root, dataset="mipnerf360").test[0].width == WIDTH // 2


@pytest.mark.parametrize(("side", "evaluated"), [(800, 400), (400, 400), (200, 100)])
def test_a_halved_copy_of_nerf_synthetic_is_not_halved_again(
    side: int, evaluated: int, tmp_path: Path
) -> None:
    root = tmp_path / "nerf_synthetic" / "chair"
    frame = {"transform_matrix": np.eye(4).tolist()}
    for part in ("train", "test"):
        frames = [frame | {"file_path": f"./{part}/r_{index}"} for index in range(2)]
        for index in range(2):
            save(np.zeros((side, side, 4), np.uint8), root / part / f"r_{index}.png")
        document = {"camera_angle_x": 0.7, "frames": frames}
        (root / f"transforms_{part}.json").write_text(json.dumps(document))
    scene = read_scene(root)
    assert (scene.dataset, scene.test[0].width) == ("nerf_synthetic", evaluated)
    renamed = root.parent.rename(tmp_path / "other") / "chair"
    assert read_scene(renamed).dataset == ("custom" if side == 200 else "nerf_synthetic")


# --- up


def test_up_is_square_to_the_right_vectors() -> None:
    level = cameras()
    np.testing.assert_allclose(find_up(level), (0, 0, 1), atol=1e-12)
    # Cameras that all look down from one side: their mean up vector is far from the vertical.
    some = [camera for camera in level if camera.center[0] > 1]
    mean = -np.mean([camera.camera_to_world[:3, 1] for camera in some], axis=0)
    assert mean[2] / np.linalg.norm(mean) < 0.98
    np.testing.assert_allclose(find_up(some), (0, 0, 1), atol=1e-12)


def test_up_of_cameras_in_one_direction_is_their_up() -> None:
    camera = Camera.look_at((0, -5, 0), (0, 0, 0), up=(0, 0, 1), width=4, height=3, fov_y=1)
    np.testing.assert_allclose(find_up([camera] * 3), (0, 0, 1), atol=1e-12)

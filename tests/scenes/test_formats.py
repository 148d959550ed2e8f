"""Every format returns the cameras that were written, and each path is read by the right reader."""

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb import Camera
from msb.errors import OutputError, SceneError
from msb.scenes import read_views, views_json, write_cameras
from tests.conftest import ROOT

from . import builders
from .builders import dump, some_cameras, write

CAMERAS = some_cameras(4)
CENTERED = some_cameras(4, centered=True)
WRITERS = {
    "colmap_bin": (lambda: builders.colmap_bin(CAMERAS), CAMERAS),
    "colmap_txt": (lambda: builders.colmap_txt(CAMERAS), CAMERAS),
    "transforms": (lambda: {"transforms.json": dump(builders.transforms(CAMERAS))}, CAMERAS),
    "cameras_json": (lambda: {"cameras.json": dump(builders.cameras_json(CENTERED))}, CENTERED),
    "views": (lambda: {"views.json": dump(builders.views(CAMERAS))}, CAMERAS),
}


def assert_same(cameras: Sequence[Camera], wanted: Sequence[Camera]) -> None:
    assert len(cameras) == len(wanted)
    for a, b in zip(cameras, wanted, strict=True):
        assert (a.name, a.width, a.height) == (b.name, b.width, b.height)
        np.testing.assert_allclose(a.K, b.K, rtol=1e-14)
        np.testing.assert_allclose(a.world_to_camera, b.world_to_camera, atol=1e-14)


@pytest.mark.parametrize("form", WRITERS)
def test_cameras_are_read_as_written_and_survive_a_round_trip(form: str, tmp_path: Path) -> None:
    make, wanted = WRITERS[form]
    cameras = msb.read_cameras(str(write(tmp_path / "a", make())))
    assert_same(cameras, wanted)
    write_cameras(cameras, tmp_path / "b" / "views.json")
    again = msb.read_cameras(tmp_path / "b" / "views.json")
    assert again == [replace(camera, image_path=None) for camera in cameras]


def test_views_json_keeps_everything_except_paths(tmp_path: Path) -> None:
    cameras = [
        replace(CAMERAS[0], split="test", source_size=(400, 300)),
        replace(CAMERAS[1], name=None, image_path=Path("a.png"), fx=1 / 3),
        replace(CAMERAS[2], name=None),
    ]
    write_cameras(iter(cameras), tmp_path / "views.json", background=(1, 0.5, 0))
    views = read_views(tmp_path / "views.json")
    assert views.background == (1.0, 0.5, 0.0)
    assert views.cameras == [cameras[0], replace(cameras[1], image_path=None), cameras[2]]
    assert (tmp_path / "views.json").read_text().count("\n") == 3 + 2
    write_cameras(cameras, tmp_path / "views.json")
    assert read_views(tmp_path / "views.json").background is None


@pytest.mark.parametrize(
    ("cameras", "background", "code"),
    [
        ([], None, "CAMERA_NONE"),
        ([CAMERAS[0], CAMERAS[0]], None, "CAMERA_FILE"),
        (CAMERAS, (1, 1), "CAMERA_FILE"),
        (CAMERAS, (1, 1, 2), "CAMERA_FILE"),
        (CAMERAS, (1, 1, float("nan")), "CAMERA_FILE"),
    ],
)
def test_unreadable_views_are_not_written(
    cameras: list[Camera], background: Any, code: str, tmp_path: Path
) -> None:
    with pytest.raises(SceneError) as caught:
        write_cameras(cameras, tmp_path / "views.json", background=background)
    assert caught.value.code == code
    assert list(tmp_path.iterdir()) == []


def test_views_too_large_to_be_read_are_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(views_json, "MAX_BYTES", 100)
    with pytest.raises(OutputError, match="OUTPUT_FORMAT_LIMIT"):
        write_cameras(CAMERAS, tmp_path / "views.json")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", ["", "sparse", "sparse/0"])
def test_a_colmap_model_is_found_in_its_scene(place: str, tmp_path: Path) -> None:
    write(tmp_path / place, builders.colmap_bin(CAMERAS))
    assert_same(msb.read_cameras(tmp_path), CAMERAS)
    assert_same(msb.read_cameras(tmp_path / place), CAMERAS)


def test_images_are_expected_beside_sparse(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "sparse" / "0", builders.colmap_bin(CAMERAS))
    wanted = tmp_path / "images" / "part" / "view_0.png"
    assert msb.read_cameras(tmp_path)[0].image_path == wanted
    monkeypatch.chdir(tmp_path / "sparse" / "0")
    assert msb.read_cameras(".")[0].image_path == wanted
    write(tmp_path / "loose", builders.colmap_bin(CAMERAS))
    assert msb.read_cameras(tmp_path / "loose")[0].image_path is None


def test_binary_models_take_precedence_over_text(tmp_path: Path) -> None:
    write(tmp_path, builders.colmap_txt(CAMERAS) | builders.colmap_bin(CAMERAS[:2]))
    assert len(msb.read_cameras(tmp_path)) == 2
    (tmp_path / "images.bin").unlink()
    assert len(msb.read_cameras(tmp_path)) == 4


def test_sources_in_a_folder_have_an_order(tmp_path: Path) -> None:
    names = ["views.json", "cameras.json", "transforms.json", "transforms_train.json", "sparse/0"]
    for count, name in enumerate(names, 1):
        cameras = some_cameras(count)
        files = {
            "views.json": lambda c=cameras: {"views.json": dump(builders.views(c))},
            "cameras.json": lambda c=cameras: {"cameras.json": dump(builders.cameras_json(c))},
            "sparse/0": lambda c=cameras: {
                f"sparse/0/{part}": data for part, data in builders.colmap_bin(c).items()
            },
        }
        default = {name: dump(builders.transforms(cameras))}
        write(tmp_path, files[name]() if name in files else default)
        assert len(msb.read_cameras(tmp_path)) == count


def test_a_scene_in_two_files_is_read_as_one(tmp_path: Path) -> None:
    files = {
        "transforms_test.json": dump(builders.transforms(CAMERAS[:1])),
        "transforms_train.json": dump(builders.transforms(CAMERAS[1:])),
        "transforms_val.json": b"not read",
    }
    cameras = msb.read_cameras(write(tmp_path, files))
    assert [camera.split for camera in cameras] == ["train", "train", "train", "test"]
    assert_same(cameras, CAMERAS[1:] + CAMERAS[:1])
    (tmp_path / "transforms_train.json").unlink()
    assert [camera.split for camera in msb.read_cameras(tmp_path)] == ["test"]


def test_json_files_are_recognised_by_content(tmp_path: Path) -> None:
    (tmp_path / "a.JSON").write_bytes(dump(builders.cameras_json(CENTERED)))
    assert_same(msb.read_cameras(tmp_path / "a.JSON"), CENTERED)
    (tmp_path / "cameras.json").write_bytes(dump(builders.transforms(CAMERAS)))
    assert_same(msb.read_cameras(tmp_path / "cameras.json"), CAMERAS)
    assert msb.read_cameras(tmp_path / "cameras.json")[0].split is None


def test_repeated_image_names_of_cameras_json_get_their_id(tmp_path: Path) -> None:
    # 3DGS cuts names at the first dot, so "img.a.png" and "img.b.png" are both "img".
    entries = builders.cameras_json(CENTERED)
    for entry in entries[1:3]:
        entry["img_name"] = "img"
    (tmp_path / "cameras.json").write_bytes(dump(entries))
    names = [camera.name for camera in msb.read_cameras(tmp_path)]
    assert names == ["part/view_0.png", "img-1", "img-2", "part/view_3.png"]


# --- docs/cameras.md

PAGE = (ROOT / "docs" / "cameras.md").read_text(encoding="utf-8")


def test_the_example_of_the_documentation_is_read(tmp_path: Path) -> None:
    (example,) = re.findall(r"```json\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "views.json").write_text(example)
    views = read_views(tmp_path / "views.json")
    assert len(views.cameras) == 2
    keys = {key for camera in json.loads(example)["cameras"] for key in camera}
    assert keys == {*views_json._REQUIRED, *views_json._OPTIONAL}

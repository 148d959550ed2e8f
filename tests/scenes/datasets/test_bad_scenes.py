"""Scenes with a file missing or wrong: one error that names it and says what would be right."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from msb.errors import InputError, SceneError
from msb.scenes.datasets import find_scenes, read_scene
from tests.corpus.refusals import kept, own_words

from .bad_scenes import BAD, DTU, MIP
from .conftest import STUBS, Copy

WORDS = kept()
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
    place, change, code, file = BAD[name]
    root = copy(place)
    change(root)
    said = refused(root, code, str(root / file))
    assert own_words(said) == WORDS[f"scene/{name}"]


@pytest.mark.parametrize("name", ARGUMENTS)
def test_bad_arguments(name: str) -> None:
    place, options, code, message = ARGUMENTS[name]
    root = STUBS / place
    assert message in refused(root, code, None if code == "SCENE_ARGUMENT" else str(root), **options)


def refused(root: Path, code: str, file: str | None, **options: Any) -> str:
    """Return what is said of a scene that is not read."""
    with pytest.raises(SceneError) as caught:
        read_scene(root, **options)
    error = caught.value
    assert (error.code, error.file) == (code, file)
    assert str(error).isprintable()
    assert len(error.message) < 300
    return error.message


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

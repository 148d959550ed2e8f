"""Scenes that are not read because of the arguments; tests/corpus has those with bad files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from msb.errors import InputError, SceneError
from msb.scenes.datasets import find_scenes, read_scene

from .bad_scenes import DTU, MIP
from .conftest import STUBS

ARGUMENTS: dict[str, tuple[str, dict[str, Any], str]] = {
    "no rule": (DTU, {"rules": "two_dts"}, "SCENE_UNKNOWN"),
    "rules": (MIP, {"rules": "nerf"}, "SCENE_ARGUMENT"),
    "convention": (MIP, {"camera_convention": "K"}, "SCENE_ARGUMENT"),
    "resolution": (MIP, {"resolution": 0}, "SCENE_ARGUMENT"),
    "background": (MIP, {"background": (1, 2, 0)}, "SCENE_ARGUMENT"),
    "several": ("", {}, "SCENE_LAYOUT"),
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_bad_arguments(name: str) -> None:
    place, options, code = ARGUMENTS[name]
    with pytest.raises(SceneError, match=code):
        read_scene(STUBS / place, **options)


def test_no_folder(tmp_path: Path) -> None:
    for find in (read_scene, find_scenes):
        with pytest.raises(InputError, match="FILE_NOT_FOUND"):
            find(tmp_path / "nowhere")

"""The tiny scenes and models equal the output of their script and have the expected structure."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import msb
from data_stubs import captures
from data_stubs.captures import Y_DOWN
from data_stubs.photographs import averaged, to_bytes
from data_stubs.surface import icosphere, pebble, walled
from tests.tiny import MODELS, SCENES
from tests.tiny.make import PEBBLE, photograph, write_models


def read_files(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def test_models_equal_the_output_of_their_script(tmp_path: Path) -> None:
    write_models(tmp_path)
    assert read_files(tmp_path) == read_files(MODELS)


class PhotographRecorder:
    """Replaces the rendering of photographs, the slow part of the script, and records their paths."""

    def __init__(self) -> None:
        self.photographs: set[Path] = set()

    def write(self, path: Path, image: Any, quality: int = 0) -> None:
        self.photographs.add(path)
        path.parent.mkdir(parents=True, exist_ok=True)

    def render(self, surface: Any, camera: Any) -> Any:
        return np.zeros((camera.height, camera.width, 4))


@pytest.mark.slow
@pytest.mark.parametrize("dataset", captures.WRITERS)
def test_scenes_equal_the_output_of_their_script_except_for_photographs(
    dataset: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replacement = PhotographRecorder()
    monkeypatch.setattr(captures, "write_photograph", replacement.write)
    captures.WRITERS[dataset](replace(PEBBLE, photograph=replacement.render), tmp_path)
    stored = read_files(SCENES / captures.place_of(dataset, PEBBLE))
    written = read_files(tmp_path)
    photographs = {path.relative_to(tmp_path).as_posix() for path in replacement.photographs}
    assert set(stored) == set(written) | photographs
    assert {name: stored[name] for name in written} == written


def pixels(path: Path) -> Any:
    with Image.open(path) as image:
        return np.asarray(image).astype(int)


@pytest.mark.slow
def test_photographs_equal_renderings_of_the_reference() -> None:
    camera = captures.nerf_synthetic_cameras(PEBBLE)["test"][2]
    stored = pixels(SCENES / f"nerf_synthetic/pebble/{camera.name}.png")
    assert np.abs(stored - to_bytes(photograph(pebble(), camera))).max() <= 1
    camera = captures.mipnerf360_cameras(PEBBLE)[3]
    rendered = photograph(walled().turned(Y_DOWN), camera)[..., :3]
    for folder, factor in (("images", 1), ("images_2", 2), ("images_4", 4)):
        stored = pixels(SCENES / "mipnerf360/pebble" / folder / str(camera.name))
        assert np.abs(stored - to_bytes(averaged(rendered, factor))).mean() < 3


def test_the_pebble_is_a_closed_mesh_and_the_wall_an_open_one() -> None:
    for frequency in (1, 2, 5):
        vertices, faces = icosphere(frequency)
        assert (len(vertices), len(faces)) == (10 * frequency**2 + 2, 20 * frequency**2)
        np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 1)
    stone = msb.audit(pebble().vertices, pebble().faces).to_dict()
    assert stone["counts"]["boundary_edges"] == stone["counts"]["nonmanifold_edges"] == 0
    assert stone["metrics"]["euler_characteristic"] == 2
    assert msb.audit(walled().vertices, walled().faces).to_dict()["counts"]["components"] == 2

"""`msb.save` has the same options as `msb convert` and writes the same files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb import Asset, MsbError, save
from msb import open as open_any
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import asset_from_mesh
from tests.cli.conftest import Msb, msb
from tests.conftest import ROOT

__all__ = ["msb"]

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)
FACES = np.array([[0, 1, 2]])


def colored_asset() -> Asset:
    return asset_from_mesh(Mesh(CORNERS, FACES, np.array([[90, 9, 200], [0, 0, 0], [255, 3, 8]], np.uint8)))


@pytest.mark.parametrize("color", ["linear", "srgb"])
@pytest.mark.parametrize("suffix", [".glb", ".ply"])
def test_colors(msb: Msb, tmp_path: Path, color: Any, suffix: str) -> None:
    save(colored_asset(), tmp_path / f"a{suffix}", color=color)
    save(colored_asset(), tmp_path / "a.triasset")
    msb("convert", "--color", color, tmp_path / "a.triasset", tmp_path / f"b{suffix}", status=0)
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_images_of_textures(tmp_path: Path) -> None:
    image = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    asset = asset_from_mesh(Mesh(CORNERS, FACES, vertex_uvs=CORNERS[:, :2].copy(), textures=(image,)))
    asset.save(tmp_path / "a.glb", texture="jpeg")
    asset.save(tmp_path / "a.obj", texture="webp")
    assert b"image/jpeg" in (tmp_path / "a.glb").read_bytes()
    assert (tmp_path / "a.webp").is_file()


@pytest.mark.slow
def test_files_for_the_web_equal_those_of_the_command(msb: Msb, tmp_path: Path) -> None:
    model = ROOT / "data_stubs/models/pebble/two_dts"
    asset = open_any(model)
    save(asset, tmp_path / "a.glb", engine="web")
    msb("convert", "--for", "web", model, tmp_path / "b.glb", status=0)
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    assert len(read_mesh(tmp_path / "a.glb").faces) == asset.manifest.face_count


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a.glb", {"color": "blue"}),
        ("a.glb", {"texture": "gif"}),
        ("a.glb", {"engine": "quake"}),
        ("a.glb", {"engine": "web", "texture": "png"}),
        ("a.ply", {"engine": "web"}),
        ("a.triasset", {"color": "srgb"}),
    ],
)
def test_invalid_arguments_are_rejected(tmp_path: Path, name: str, options: Any) -> None:
    with pytest.raises(MsbError) as caught:
        save(colored_asset(), tmp_path / name, **options)
    assert caught.value.code in ("USAGE", "NAME_UNKNOWN")
    assert not list(tmp_path.iterdir())

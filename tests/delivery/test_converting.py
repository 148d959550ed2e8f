"""`msb.convert` writes the files of `msb convert`, and reports the same contents and losses."""

from pathlib import Path
from typing import Any

import pytest

import msb
from msb.errors import MsbError, UsageError
from tests.adapters.models import GOLDEN
from tests.cli.conftest import Here, here
from tests.conftest import ROOT

__all__ = ["here"]

MODEL = ROOT / "data_stubs" / "models" / "walled" / "mesh_splatting"
OBJ = "v 0 0 0\nv 1 0 0\nv 0 1 0.1000000001\nvn 0 0 1\nf 1//1 2//1 3//1\n"


@pytest.mark.parametrize(
    ("name", "options", "flags"),
    [
        ("a.glb", {}, []),
        ("a.obj", {"up": "-y"}, ["--up", "-y"]),
        ("a.ply", {"color": "linear"}, ["--color", "linear"]),
        ("a.triasset", {}, []),
        ("official.ply", {"official": True}, ["--official"]),
    ],
)
def test_the_function_does_what_the_command_does(
    here: Here, tmp_path: Path, name: str, options: dict[str, Any], flags: list[str]
) -> None:
    (tmp_path / "command").mkdir()
    result = here("convert", *flags, MODEL, tmp_path / "command" / name)
    done = msb.convert(MODEL, tmp_path / name, **options)
    assert done.path.read_bytes() == (tmp_path / "command" / name).read_bytes()
    assert result.out.strip().endswith(", ".join(done.contents))
    assert len(done.notes) == len(result.err.strip().splitlines())


def test_a_mesh_file_keeps_its_precision_and_its_losses_are_returned(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(OBJ)
    done = msb.convert(str(tmp_path / "a.obj"), str(tmp_path / "b.off"))
    assert "0.1000000001" in done.path.read_text()
    assert any("normals" in note for note in done.notes)


@pytest.mark.parametrize(
    ("target", "options"),
    [
        ("a.exe", {}),
        ("a.spz", {}),
        ("a.splat", {"official": True}),
        ("a.glb", {"form": "folder"}),
        ("a.triasset", {"color": "srgb"}),
        ("a.glb", {"up": "z"}),
        ("a.stl", {"color": "linear"}),
        ("a.off", {"texture": "png"}),
        ("a.ply", {"official": True, "up": "+z"}),
        ("a.glb", {"engine": "web", "color": "srgb"}),
    ],
)
def test_invalid_arguments_are_rejected(tmp_path: Path, target: str, options: dict[str, Any]) -> None:
    with pytest.raises(UsageError):
        msb.convert(MODEL, tmp_path / target, **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("options", [{}, {"official": True}])
def test_existing_files_and_the_source_are_kept(tmp_path: Path, options: dict[str, Any]) -> None:
    (tmp_path / "a.ply").write_bytes((GOLDEN / "meshes" / "synthetic_splat_small.ply").read_bytes())
    before = (tmp_path / "a.ply").read_bytes()
    with pytest.raises(UsageError, match="OUTPUT_EXISTS"):
        msb.convert(MODEL, tmp_path / "a.ply", **options)
    with pytest.raises(MsbError):
        msb.convert(tmp_path / "a.ply", tmp_path / "a.ply", overwrite=True, **options)
    assert (tmp_path / "a.ply").read_bytes() == before
    msb.convert(MODEL, tmp_path / "a.ply", overwrite=True, **options)
    assert (tmp_path / "a.ply").read_bytes() != before

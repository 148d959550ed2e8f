"""From a path to a mesh: what is opened, by which name, and what a `Mesh` is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import msb
from msb.errors import InputError, MeshError, MeshFileError
from msb.meshes import Mesh, read_mesh

from .builders import SMALL, SQUARE, SQUARE_FACES, SUFFIXES


def test_the_suffix_says_the_format_in_any_case(tmp_path: Path) -> None:
    for suffix in SUFFIXES:
        for name in (f"a{suffix}", f"b{suffix.upper()}", f"c.d{suffix.title()}"):
            (tmp_path / name).write_bytes(SMALL[suffix])
            assert len(read_mesh(tmp_path / name).faces) == 2
            assert len(read_mesh(str(tmp_path / name)).faces) == 2


@pytest.mark.parametrize("name", ["mesh", "mesh.txt", ".ply", "mesh.ply.gz"])
def test_other_suffixes_are_not_recognised_whoever_reads(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(SMALL[".ply"])
    for read in (read_mesh, msb.open, msb.audit, msb.export):
        with pytest.raises(InputError, match="FILE_NOT_RECOGNISED") as caught:
            read(tmp_path / name)
        assert caught.value.file == str(tmp_path / name)


@pytest.mark.parametrize("name", ["absent.ply", "absent/mesh.ply", "file/mesh.ply", "nul\0.ply"])
def test_missing_files(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="FILE_NOT_FOUND"):
        read_mesh(f"{tmp_path}/{name}")


CONTENTS = {".ply": "PLY", ".off": "OFF", ".STL": "STL", ".glb": "GLB"}


@pytest.mark.parametrize("content", CONTENTS)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_content_of_another_format_is_named(tmp_path: Path, suffix: str, content: str) -> None:
    if suffix == content.lower():
        return
    path = tmp_path / f"mesh{suffix}"
    path.write_bytes(SMALL[content])
    with pytest.raises(MeshFileError, match=f"MESH_FILE_INVALID: .* {CONTENTS[content]}"):
        read_mesh(path)


def test_a_mesh_is_what_it_says() -> None:
    vertices, faces = np.array(SQUARE), np.array(SQUARE_FACES)
    assert (
        Mesh(vertices, faces, np.zeros((4, 3), np.uint8), np.ones((2, 4), np.float32)).face_colors is not None
    )
    for wrong in (
        (vertices[:, :2], faces),
        (vertices.astype(np.int64), faces),
        (vertices, faces.astype(np.int32)),
        (vertices, faces.ravel()),
        (vertices, faces, np.zeros((3, 3), np.uint8)),
        (vertices, faces, np.zeros((4, 2), np.uint8)),
        (vertices, faces, np.zeros((4, 3))),
        (vertices, faces, None, np.zeros((4, 3), np.uint8)),
    ):
        with pytest.raises(MeshError, match="MESH_ARRAY"):
            Mesh(*wrong)

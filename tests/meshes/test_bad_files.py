"""Files that are not valid: one error with the right code. How much memory they take, tests/fuzz sees."""

from __future__ import annotations

from pathlib import Path

import pytest

from msb.errors import MeshFileError
from msb.meshes import read_mesh
from msb.meshes.formats import FORMATS

from .bad_files import BAD
from .builders import SMALL
from .checks import check_bad


@pytest.mark.parametrize("name", BAD)
def test_bad_file(name: str, tmp_path: Path) -> None:
    suffix, content, code, message = BAD[name]
    check_bad(FORMATS[suffix], content, code, message, tmp_path)


def test_every_code_of_mesh_files_has_a_bad_file() -> None:
    of_errors = MeshFileError.codes - {"MESH_FILE_LEFT_OUT"}  # that is of a note
    assert {bad[2] for bad in BAD.values()} == of_errors


def test_a_glb_of_too_many_nodes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("msb.meshes.gltf.MAX_NODES", 0)
    (tmp_path / "nodes.glb").write_bytes(SMALL[".glb"])
    with pytest.raises(MeshFileError, match=r"MESH_FILE_TOO_LARGE: .*there are 1 nodes, more than 0"):
        read_mesh(tmp_path / "nodes.glb")

"""Files that are not valid: one error with the right code, soon, and without much memory."""

from __future__ import annotations

import time
import tracemalloc
from typing import TYPE_CHECKING

import pytest

from msb.errors import CODES, MeshFileError
from msb.meshes import read_mesh

from .bad_files import BAD
from .builders import SMALL

if TYPE_CHECKING:
    from pathlib import Path

SECONDS = 2.0
"""Of processor time: far more than a small file takes."""


@pytest.fixture(autouse=True, scope="module")
def _library_of_binary_stl_is_loaded(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Import, before any time is taken, what the reader of binary STL imports when it is first used."""
    path = tmp_path_factory.mktemp("warm") / "mesh.stl"
    path.write_bytes(SMALL[".stl"])
    read_mesh(path)


@pytest.mark.parametrize("name", BAD)
def test_bad_file(name: str, tmp_path: Path) -> None:
    suffix, content, code, message = BAD[name]
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    start = time.process_time()
    with pytest.raises(MeshFileError) as caught:
        read_mesh(path)
    assert time.process_time() - start < SECONDS
    error = caught.value
    assert error.code == code
    assert message in error.message
    assert error.file == str(path)
    assert str(error) == f"{code}: {path}: {error.message}"
    assert str(error).isprintable()
    assert len(error.message) < 300
    assert error.__cause__ is None


def test_every_code_of_mesh_files_has_a_bad_file() -> None:
    codes = {code for code, entry in CODES.items() if entry.kind is MeshFileError}
    assert {bad[2] for bad in BAD.values()} == codes


@pytest.mark.parametrize(
    "name",
    [name for name in BAD if any(word in name for word in ("huge", "deep", "times", "endless", "zero-size"))],
)
def test_what_is_declared_takes_no_memory(name: str, tmp_path: Path) -> None:
    suffix, content, *_ = BAD[name]
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(MeshFileError):
            read_mesh(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 20 * len(content) + (1 << 22)


def test_a_glb_of_too_many_nodes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("msb.meshes.gltf_nodes.MAX_NODES", 0)
    (tmp_path / "nodes.glb").write_bytes(SMALL[".glb"])
    with pytest.raises(MeshFileError, match=r"MESH_FILE_TOO_LARGE: .*there are 1 nodes, more than 0"):
        read_mesh(tmp_path / "nodes.glb")

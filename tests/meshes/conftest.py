"""Fixtures of the tests of mesh files."""

from collections.abc import Callable
from pathlib import Path

import pytest

from msb.meshes import Mesh, read_mesh


@pytest.fixture
def read(tmp_path: Path) -> Callable[[bytes, str], Mesh]:
    """Return a function that writes content to a file with a suffix, and reads the mesh."""

    def read_content(content: bytes, suffix: str) -> Mesh:
        path = tmp_path / f"mesh{suffix}"
        path.write_bytes(content)
        return read_mesh(path)

    return read_content

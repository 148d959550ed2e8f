"""What the tests of mesh files share."""

from collections.abc import Callable
from pathlib import Path

import pytest

from msb.meshes import Mesh, read_mesh


@pytest.fixture
def read(tmp_path: Path) -> Callable[[bytes, str], Mesh]:
    """Return a function that reads a mesh from the content of a file and its suffix."""

    def read_content(content: bytes, suffix: str) -> Mesh:
        path = tmp_path / f"mesh{suffix}"
        path.write_bytes(content)
        return read_mesh(path)

    return read_content

"""Fixtures of the tests of bakes: devices, the command line, and a small model for quick bakes."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import msb as library
from msb.cl import Device
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from msb.scenes import write_cameras
from tests.bake.soups import ring
from tests.cl.conftest import STYLES, open_styled
from tests.cli.conftest import here, msb
from tests.conftest import TETRAHEDRON

__all__ = ["here", "msb"]
COLORS = np.linspace(0.1, 0.9, 12, dtype=np.float32).reshape(4, 3)


@pytest.fixture(scope="module", params=STYLES)
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    with open_styled(request.param) as opened:
        yield opened


def solid(faces: int = 4, at: float = 0.0) -> library.Asset:
    """Return the first faces of a tetrahedron with vertex colours."""
    points, corners = TETRAHEDRON
    points = points + np.float32(at)
    return asset_from_mesh(Mesh(points, corners[:faces].astype(np.int64), vertex_colors=COLORS))


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """Return the path of the tetrahedron; `cameras.json` beside it has nine views of it."""
    solid().save(tmp_path / "solid.triasset")
    write_cameras(ring(9), tmp_path / "cameras.json")
    return tmp_path / "solid.triasset"


def bake_words(model: Path, *words: object, out: str = "a.glb") -> list[object]:
    """Return the words of a quick bake with the given cameras."""
    cameras = model.parent / "cameras.json"
    return ["bake", "--geometry", "kept", "--cameras", cameras, model, "-o", model.parent / out, *words]

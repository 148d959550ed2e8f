"""Fixtures of the viewers: meshes with known defects, and a check for OpenGL."""

import importlib.util
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.errors import UsageError
from msb.topology import audit_arrays
from msb_viewers.gl import GlProbe
from msb_viewers.model import ViewModel, build_model
from msb_viewers.viewed_mesh import Colors, ViewedMesh, read_viewed_mesh
from tests.conftest import ROOT

HAS_PYVISTA = importlib.util.find_spec("pyvista") is not None


@pytest.hookimpl(tryfirst=True)  # this must run before tests are selected by marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests that open a window as slow."""
    for item in items:
        if "gl" in getattr(item, "fixturenames", ()):
            item.add_marker("slow")


@pytest.fixture(scope="session")
def gl() -> None:
    """Skip the test if VTK cannot draw, with the message of the command."""
    try:
        probe = GlProbe.start()
        try:
            probe.check()
        finally:
            probe.close()
    except UsageError as error:
        pytest.skip(str(error))


def model_of(vertices: Any, faces: Any, *, colors: Colors | None = None, up: str = "+y") -> ViewModel:
    points, rows = np.asarray(vertices, np.float64), np.asarray(faces, np.int64).reshape(-1, 3)
    mesh = ViewedMesh("made.ply", None, points, rows, colors, None, up)
    return build_model(mesh, *audit_arrays(points, rows))


def square(size: float, depth: float, *, left: float = 0.0) -> list[list[float]]:
    half = size / 2
    return [[left + x, y, depth] for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))]


def mouse(viewer: Any, x: float, y: float, *events: str) -> None:
    """Move the mouse to a pixel (from the top left), and send events to the window."""
    interactor = viewer.plotter.iren.interactor
    interactor.SetEventInformation(int(x), viewer.size[1] - 1 - int(y), 0, 0, "\0", 0, None)
    for event in events:
        interactor.InvokeEvent(event)


PRESS, RELEASE, MOVE = "LeftButtonPressEvent", "LeftButtonReleaseEvent", "MouseMoveEvent"
RED, GREEN = (200, 30, 30), (30, 160, 60)


@pytest.fixture(scope="session")
def faults() -> ViewModel:
    """A mesh with one defect of each kind. All faces point towards +z; y is up.

    Vertices 0 to 4: two triangles that only share vertex 2 (a bow-tie). 5 to 9: three faces at the edge
    (5, 6). 10 to 12: a duplicate face. 13 and 14: a face that lists a vertex twice. 15: unused.
    """
    points = [
        *([-3, 0, 0], [-3, 1, 0], [-2, 0.5, 0], [-1, 0, 0], [-1, 1, 0]),
        *([0, 0, 0.3], [0, 1, 0.3], [1, 0.5, 0], [-0.6, 0.5, 0], [0.5, 0.5, -1]),
        *([2, 0, 0], [3, 0, 0], [2.5, 1, 0]),
        *([-3, -2, 0], [-2, -2, 0], [3, -2, 0]),
    ]
    faces = [[0, 2, 1], [2, 3, 4], [5, 6, 7], [5, 6, 8], [5, 6, 9], [10, 11, 12], [10, 11, 12], [13, 14, 14]]
    colors = np.full((16, 3), RED, np.uint8)
    colors[10:13] = GREEN
    return model_of(points, faces, colors=Colors(colors, "vertex"))


@pytest.fixture(scope="session")
def demo(demo_asset: Path) -> ViewModel:
    mesh = read_viewed_mesh(demo_asset)
    return build_model(mesh, *audit_arrays(mesh.vertices, mesh.faces))


@pytest.fixture
def no_pyvista(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Return environment variables that make imports of VTK and pyvista fail."""
    folder = tmp_path_factory.mktemp("blocked")
    (folder / "sitecustomize.py").write_text(
        "import importlib.util as u, sys\n"
        "find = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name in ('pyvista', 'vtkmodules') else find(name, *a)\n"
        "class Block:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.partition('.')[0] in ('pyvista', 'vtkmodules', 'vtk'):\n"
        "            raise ModuleNotFoundError(name)\n"
        "sys.meta_path.insert(0, Block())\n"
    )
    return {"PYTHONPATH": os.pathsep.join((str(folder), str(ROOT), str(ROOT / "viewers")))}


__all__ = ["HAS_PYVISTA", "ROOT"]

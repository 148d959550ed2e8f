"""The standard tier beside a renderer of other people: VTK, a rasterizer."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.cl import Device
from msb.render.frame import interior
from tests.render.standard_scenes import Arrays, camera, draw, mesh_asset, random_colors, scene, unshared

pytestmark = [pytest.mark.slow, pytest.mark.oracle]

VIEW = camera(320, 240, 300.0)

VTK = """
import sys
import numpy as np
import pyvista as pv

folder, width, height, focal = sys.argv[1], *map(float, sys.argv[2:])
positions, indices, colors = (np.load(f"{folder}/{name}.npy") for name in ("positions", "indices", "colors"))
cells = np.concatenate([np.full((len(indices), 1), 3), indices], axis=1)
mesh = pv.PolyData(positions, cells.ravel())
mesh.point_data["rgb"] = colors
plotter = pv.Plotter(off_screen=True, window_size=(int(width), int(height)), lighting=None)
plotter.add_mesh(mesh, scalars="rgb", rgb=True, lighting=False)
plotter.render_window.SetMultiSamples(0)
plotter.background_color = "black"
plotter.camera.position = (0, 0, 0)
plotter.camera.focal_point = (0, 0, 1)
plotter.camera.up = (0, -1, 0)
plotter.camera.view_angle = np.degrees(2 * np.arctan(height / 2 / focal))
plotter.camera.clipping_range = (0.01, 1000)
np.save(f"{folder}/image.npy", np.asarray(plotter.screenshot(None, return_img=True))[..., :3])
"""


def square_camera() -> Any:
    """Return a camera with one focal length, which is all VTK has."""
    return type(VIEW)(VIEW.width, VIEW.height, 300.0, 300.0, VIEW.cx, VIEW.cy, np.eye(4))


def without_crossings(mesh: Arrays) -> Arrays:
    """Keep faces apart: where they cross, whose depths are how exact decides what is seen."""
    triangles = mesh[0].reshape(-1, 3, 3).copy()
    triangles[..., 2] = 3 + np.arange(len(triangles))[:, None] * 0.002 + triangles[..., 2] * 0.0001
    return unshared(triangles)


def test_vtk(cpu: Device, tmp_path: Path) -> None:
    pytest.importorskip("pyvista")
    parts = [scene(kind, 31)[0].reshape(-1, 3, 3) for kind in ("small", "large")]
    mesh = without_crossings(unshared(np.concatenate(parts)))
    colors = random_colors(31, len(mesh[0]))
    for name, array in zip(("positions", "indices", "colors"), (*mesh, colors), strict=True):
        np.save(tmp_path / f"{name}.npy", array)
    view = square_camera()
    # In a process of its own: without a software OpenGL, VTK ends the process it is in.
    command = [sys.executable, "-c", VTK, str(tmp_path), str(view.width), str(view.height), str(view.fy)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        pytest.skip("VTK does not answer")
    if done.returncode:
        pytest.skip(f"VTK cannot render here: {(done.stderr.strip().splitlines() or ['no reason'])[-1]}")
    theirs = np.load(tmp_path / "image.npy").astype(np.float64) / 255
    if not theirs.any():
        pytest.skip("VTK renders nothing here")
    frame = draw(cpu, mesh_asset(mesh, colors), view)
    ours = np.where(frame.alpha[..., None] > 0, frame.image, 0)
    difference = np.abs(np.round(ours * 255) / 255 - theirs).max(axis=2)
    # VTK snaps corners to 1/256 pixel: edges may differ by a pixel, interiors by a level of rounding.
    inner = interior(frame.face_id)
    assert inner.sum() > 1000
    assert difference[inner].max() <= 1.01 / 255
    assert (difference > 1.01 / 255).mean() < 0.002

"""The standard tier against VTK, a rasterizer that shares no code with ours."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from msb.cl import Device
from msb.render.frame import interior
from tests.render.standard_scenes import camera, draw, mesh_asset, random_colors, scene, unshared

pytestmark = [pytest.mark.slow, pytest.mark.oracle]

# Draw positions.npy, indices.npy and colors.npy of a folder, and write image.npy. There is no light and no
# multisampling.
SCRIPT = """
import sys
import numpy as np
import pyvista as pv

folder, width, height, focal = sys.argv[1], *map(float, sys.argv[2:])
positions, indices, colors = (np.load(f"{folder}/{name}.npy") for name in ("positions", "indices", "colors"))
mesh = pv.PolyData(positions, np.insert(indices, 0, 3, axis=1).ravel())
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


def test_images_match_vtk(cpu: Device, tmp_path: Path) -> None:
    pytest.importorskip("pyvista")
    triangles = np.concatenate([scene(kind, 31)[0].reshape(-1, 3, 3) for kind in ("small", "large")])
    # Each face has one depth. If faces crossed, the precision of the depths would decide which face is
    # visible.
    triangles[..., 2] = 3 + np.arange(len(triangles))[:, None] * 0.002 + triangles[..., 2] * 0.0001
    mesh = unshared(triangles)
    colors = random_colors(31, len(mesh[0]))
    view = replace(camera(320, 240, 300.0), fy=300.0)  # VTK has one focal length for both axes
    for name, array in zip(("positions", "indices", "colors"), (*mesh, colors), strict=True):
        np.save(tmp_path / f"{name}.npy", array)
    # VTK runs in a separate process, because it aborts the process if it finds no OpenGL.
    command = [sys.executable, "-c", SCRIPT, str(tmp_path), str(view.width), str(view.height), str(view.fy)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        pytest.skip("VTK does not answer")
    if done.returncode:
        pytest.skip(f"VTK cannot render here: {(done.stderr.strip().splitlines() or ['no reason'])[-1]}")
    theirs = np.load(tmp_path / "image.npy").astype(np.float64) / 255
    frame = draw(cpu, mesh_asset(mesh, colors), view)
    ours = np.where(frame.alpha[..., None] > 0, frame.image, 0)
    difference = np.abs(np.round(ours * 255) / 255 - theirs).max(axis=2)
    # VTK snaps corners to 1/256 pixel, so edges may move by a pixel. Interiors differ by one level due to
    # rounding.
    inner = interior(frame.face_id)
    assert inner.sum() > 1000
    assert difference[inner].max() <= 1.01 / 255
    assert (difference > 1.01 / 255).mean() < 0.002

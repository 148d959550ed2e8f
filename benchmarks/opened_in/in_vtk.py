"""Render a file in VTK through PyVista, with the glTF importer and a camera. Runs in a separate process.

Arguments: the file, the image to write, and the view as JSON.
"""

from __future__ import annotations

import json
import sys

import pyvista
from PIL import Image

file, picture, wanted = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
plotter = pyvista.Plotter(off_screen=True, window_size=wanted["size"])
plotter.import_gltf(file)
plotter.set_background("black")
plotter.camera.position, plotter.camera.focal_point = wanted["eye"], wanted["target"]
plotter.camera.up, plotter.camera.view_angle = (0, 1, 0), wanted["degrees"]
plotter.camera.clipping_range = wanted["near"], wanted["far"]
Image.fromarray(plotter.screenshot(return_img=True)[..., :3]).save(picture)
lines = plotter.render_window.ReportCapabilities().splitlines()
device = next(line.partition(":")[2].strip() for line in lines if "renderer string" in line)
print(json.dumps({"version": ".".join(map(str, pyvista.vtk_version_info)), "device": device}))

"""Render a file in pygfx with its offscreen renderer, its glTF loader, and a camera.

Runs in a separate process. Arguments: the file, the image to write, and the view as JSON.
"""

from __future__ import annotations

import json
import sys
from math import atan, degrees, radians, tan

import numpy as np
import pygfx
from PIL import Image
from rendercanvas.offscreen import RenderCanvas

file, picture, wanted = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
width, height = wanted["size"]
canvas = RenderCanvas(size=(width, height), pixel_ratio=1)
renderer = pygfx.renderers.WgpuRenderer(canvas, **({"pixel_ratio": 1} if wanted["mended"] else {}))
scene = pygfx.Scene()
scene.add(pygfx.load_gltf(file, quiet=True).scene)
scene.add(pygfx.Background.from_color("#000"))
# pygfx's field of view applies to the mean of width and height.
angle = degrees(2 * atan(tan(radians(wanted["degrees"]) / 2) * (1 + width / height) / 2))
camera = pygfx.PerspectiveCamera(angle, width / height, depth_range=(wanted["near"], wanted["far"]))
camera.local.position = wanted["eye"]
camera.look_at(wanted["target"])
canvas.request_draw(lambda: renderer.render(scene, camera))
Image.fromarray(np.asarray(canvas.draw())[..., :3]).save(picture)
print(json.dumps({"version": pygfx.__version__, "device": renderer.device.adapter_info["description"]}))

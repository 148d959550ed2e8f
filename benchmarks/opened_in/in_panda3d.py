"""Render a file in Panda3D with a default window, its glTF loader, and a camera. Runs in a separate process.

Arguments: the file, the image to write, and the view as JSON.
"""

from __future__ import annotations

import json
import sys
from math import atan, degrees, radians, tan

from direct.showbase.ShowBase import ShowBase
from panda3d.core import PandaSystem, Point3, loadPrcFileData

file, picture, wanted = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
width, height = wanted["size"]
loadPrcFileData("", f"window-type offscreen\nwin-size {width} {height}\naudio-library-name null")
if wanted["mended"]:
    loadPrcFileData("", "framebuffer-srgb true")
base = ShowBase()
base.setBackgroundColor(0, 0, 0)
base.loader.loadModel(file).reparentTo(base.render)
base.disableMouse()
# Panda3D's field of view is horizontal.
across = degrees(2 * atan(tan(radians(wanted["degrees"]) / 2) * width / height))
base.camLens.setFov(across, wanted["degrees"])
base.camLens.setNearFar(wanted["near"], wanted["far"])


def turned(x, y, z):
    """Convert a glTF point (y up) to the loader's axes (z up)."""
    return Point3(x, -z, y)


base.camera.setPos(turned(*wanted["eye"]))
base.camera.lookAt(turned(*wanted["target"]))
for _ in range(3):
    base.graphicsEngine.renderFrame()
base.win.saveScreenshot(picture)
print(
    json.dumps({"version": PandaSystem.getVersionString(), "device": base.win.getGsg().getDriverRenderer()})
)

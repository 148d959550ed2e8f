"""Render a file in Blender with the default start-up scene, the default importer, and a camera.

Runs in a separate process with bpy. Arguments: the file, the image to write, and the view as JSON.
"""

from __future__ import annotations

import json
import os
import sys
from math import radians
from pathlib import Path

import bpy
from mathutils import Vector

file, picture, wanted = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)  # Blender's own output
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=file)
scene = bpy.context.scene
render = scene.render
render.resolution_x, render.resolution_y = wanted["size"]
scene.eevee.taa_render_samples = 8  # default 64; it would take minutes without a graphics card
world = bpy.data.worlds.new("black")
scene.world = world
if not world.node_tree:  # before Blender 5
    world.use_nodes = True
world.node_tree.nodes["Background"].inputs["Color"].default_value = (0, 0, 0, 1)
if wanted["mended"]:
    scene.view_settings.view_transform = "Standard"
    render.filter_size = 0.01
    render.dither_intensity = 0


def turned(x, y, z):
    """Convert a glTF point (y up) to the importer's axes (z up)."""
    return Vector((x, -z, y))


camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera = camera
camera.data.sensor_fit = "VERTICAL"
camera.data.angle = radians(wanted["degrees"])
camera.data.clip_start, camera.data.clip_end = wanted["near"], wanted["far"]
eye, target = turned(*wanted["eye"]), turned(*wanted["target"])
camera.location = eye
camera.rotation_euler = (target - eye).to_track_quat("-Z", "Y").to_euler()
render.filepath = str(Path(picture).absolute())
bpy.ops.render.render(write_still=True)
device = "CPU" if render.engine == "CYCLES" else __import__("gpu").platform.renderer_get()
answers.write(json.dumps({"version": bpy.app.version_string, "device": f"{render.engine}, {device}"}) + "\n")
answers.flush()
os._exit(0)  # bpy may crash at interpreter exit

# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes of Blender as models: how one looks, what an audit says of it, and the arrays that go back."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

VARIABLE = "MSB_PYTHON"
"""The environment variable with a Python that has meshsplatbench, if not Blender's with our wheels."""
ABOUT = "meshsplatbench"
"""The property of an object with what its mesh does not hold, as JSON."""
COLOR, GREY, UVS = "Color", "Grey", "UVMap"
MARKS = {"boundary": (1.0, 0.6, 0.0, 1.0), "nonmanifold": (0.9, 0.0, 0.9, 1.0)}
"""Attribute of edges -> the colour they are drawn in over the mesh."""
SRGB_KNEE, SRGB_SLOPE, SRGB_OFFSET, SRGB_POWER = 0.04045, 12.92, 0.055, 2.4
WRAPS = {"repeat": "REPEAT", "clamp": "EXTEND", "mirror": "MIRROR"}


class Failed(Exception):
    """What the package said of a model that it cannot take, in one line."""


def ask(verb: str, source: str | dict[str, Any], target: str | None = None) -> dict[str, Any]:
    """Have `worker.py` read a path, or audit or save arrays; return the arrays that it answers."""
    python = os.environ.get(VARIABLE)
    paths = {} if python else {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    with tempfile.TemporaryDirectory(prefix="msb-") as folder:
        if isinstance(source, dict):
            given, source = source, str(Path(folder, "mesh.npz"))
            np.savez(source, **given)
        answer = target or str(Path(folder, "answer.npz"))
        command = [python or sys.executable, str(Path(__file__).with_name("worker.py")), verb, source, answer]
        done = subprocess.run(
            command,
            capture_output=True,
            env={**os.environ, **paths},
            encoding="utf-8",
            errors="replace",
            check=False,
        )
        if done.returncode:
            words = [line for line in done.stderr.splitlines() if line.strip()]
            raise Failed(words[-1] if words else f"the process ended with status {done.returncode}")
        if target:
            return {}
        with np.load(answer) as file:
            return dict(file)


def add_model(name: str, found: dict[str, Any]) -> tuple[bpy.types.Object, int]:
    """Return an object with the mesh that `ask` found, as it looks, and how many faces Blender refuses."""
    about, faces = json.loads(str(found["about"])), found["faces"]
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(found["vertices"]))
    mesh.vertices.foreach_set("co", np.float32(found["vertices"]).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", np.int32(faces).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    colors = None
    if "colors" in found:
        colors = mesh.color_attributes.new(GREY if about.get("grey") else COLOR, "FLOAT_COLOR", "CORNER")
        colors.data.foreach_set("color", found["colors"].ravel())
    images = [found[key] for key in (f"texture.{number}" for number in range(len(found))) if key in found]
    if images:
        mesh.uv_layers.new(name=UVS).data.foreach_set("uv", found["uvs"].ravel())
    if "face_texture" in found:
        mesh.polygons.foreach_set("material_index", np.int32(found["face_texture"]))
    for number, pixels in enumerate(images or [None]):
        title = f"{name} {number}" if len(images) > 1 else name
        image = None if pixels is None else add_image(title, pixels)
        mesh.materials.append(unlit(title, colors and colors.name, image, about.get("sampler", {})))
    mesh.update(calc_edges=True)
    mesh.validate(clean_customdata=False)
    thing = bpy.data.objects.new(name, mesh)
    thing.matrix_world = Matrix(about["turn"]).to_4x4()
    show_audit(thing, found, about)
    return thing, len(faces) - len(mesh.polygons)


def add_image(name: str, texels: Any) -> bpy.types.Image:
    """Return an image of `texels` (H, W, 4) of linear light, lowest row first; alpha does not touch colours.

    It holds floats because Cycles filters bytes before it makes them linear, engines and msb afterwards.
    """
    height, width, _ = texels.shape
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=True, is_data=True)
    image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set(texels.ravel())
    image.update()
    image.pack()
    return image


def unlit(
    name: str, colors: str | None, image: bpy.types.Image | None, sampler: dict[str, Any]
) -> bpy.types.Material:
    """Return a material that shines in the attribute `colors` times `image`; below the cut-off it is clear.

    Colours without a texture are stored as they go to the screen, and interpolated so: the shader makes them
    linear afterwards, which the view transform Standard undoes. Those that a texture is times are linear.
    """
    material = bpy.data.materials.new(name)
    if not material.node_tree:  # before Blender 5
        material.use_nodes = True
    nodes, link = material.node_tree.nodes, material.node_tree.links.new
    nodes.clear()

    def vector(operation: str, *inputs: Any) -> Any:
        node = nodes.new("ShaderNodeVectorMath")
        node.operation = operation
        for socket, value in zip(node.inputs, inputs, strict=False):
            if isinstance(value, bpy.types.NodeSocket):
                link(value, socket)
            else:
                socket.default_value = (value, value, value)
        return node.outputs[0]

    color = alpha = None
    if colors is not None:
        stored = nodes.new("ShaderNodeAttribute")
        stored.attribute_name = colors
        color, alpha = stored.outputs["Color"], stored.outputs["Alpha"]
    if image is not None:
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = image
        texture.interpolation = "Closest" if sampler.get("filter") == "nearest" else "Linear"
        texture.extension = WRAPS[sampler.get("wrap_u", "repeat")]
        own, own_alpha = texture.outputs["Color"], texture.outputs["Alpha"]
        if color is not None:
            both = nodes.new("ShaderNodeMath")
            both.operation = "MULTIPLY"
            link(own_alpha, both.inputs[0])
            link(alpha, both.inputs[1])
            own, own_alpha = vector("MULTIPLY", own, color), both.outputs[0]
        color, alpha = own, own_alpha
    else:
        # sRGB in one sum: ((max(c, knee) + offset) / (1 + offset)) ** power + (min(c, knee) - knee) / slope.
        above = vector("MAXIMUM", color, SRGB_KNEE)
        above = vector("MULTIPLY_ADD", above, 1 / (1 + SRGB_OFFSET), SRGB_OFFSET / (1 + SRGB_OFFSET))
        power = nodes.new("ShaderNodeGamma")
        power.inputs["Gamma"].default_value = SRGB_POWER
        link(above, power.inputs["Color"])
        below = vector("MINIMUM", color, SRGB_KNEE)
        below = vector("MULTIPLY_ADD", below, 1 / SRGB_SLOPE, -SRGB_KNEE / SRGB_SLOPE)
        color = vector("ADD", power.outputs[0], below)
    emission, output = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    link(color, emission.inputs["Color"])
    shown = emission.outputs[0]
    if sampler.get("alpha_cutoff") is not None:
        below, clear, mix = (
            nodes.new(f"ShaderNode{kind}") for kind in ("Math", "BsdfTransparent", "MixShader")
        )
        below.operation, below.inputs[1].default_value = "LESS_THAN", sampler["alpha_cutoff"]
        link(alpha, below.inputs[0])
        link(below.outputs[0], mix.inputs[0])
        link(shown, mix.inputs[1])
        link(clear.outputs[0], mix.inputs[2])
        shown = mix.outputs[0]
    link(shown, output.inputs["Surface"])
    return material


def show_exactly(context: bpy.types.Context) -> None:
    """Let colours reach the screen as stored: no tone mapping, no dithering, materials in viewports."""
    scene = context.scene
    scene.display_settings.display_device = "sRGB"
    view = scene.view_settings
    view.view_transform, view.look, view.exposure, view.gamma = "Standard", "None", 0, 1
    scene.render.dither_intensity = 0
    for area in context.screen.areas if context.screen else ():
        if area.type == "VIEW_3D" and area.spaces.active.shading.type in {"SOLID", "WIREFRAME"}:
            area.spaces.active.shading.type = "MATERIAL"


def show_audit(thing: bpy.types.Object, found: dict[str, Any], about: dict[str, Any]) -> None:
    """Keep what an audit `found`: the verdict as a property of `thing`, edges as attributes of its mesh."""
    thing[ABOUT] = json.dumps(about)
    mesh = thing.data
    ends = _column(mesh.edges, "vertices", np.int32, 2)
    base = np.array([len(mesh.vertices), 1], np.int64)
    keys = np.sort(found["number"][ends], axis=1) @ base
    for name in MARKS:
        marks = mesh.attributes.get(name) or mesh.attributes.new(name, "BOOLEAN", "EDGE")
        marks.data.foreach_set("value", np.isin(keys, np.sort(found[name], axis=1) @ base))


def mesh_arrays(thing: bpy.types.Object, mesh: bpy.types.Mesh) -> dict[str, Any]:
    """Return `mesh`, that of `thing` with modifiers or without, for `worker.py`: in the model's own axes."""
    about = json.loads(thing.get(ABOUT, "{}"))
    turn = Matrix(about.setdefault("turn", np.eye(3).tolist())).to_4x4()
    moved = np.array(turn.inverted() @ thing.matrix_world)
    vertices = _column(mesh.vertices, "co", np.float32, 3)
    if not np.allclose(moved, np.eye(4), atol=1e-6):  # else they stay what they are, to the last bit
        vertices = np.float32(vertices @ moved[:3, :3].T + moved[:3, 3])
    mesh.calc_loop_triangles()
    triangles = mesh.loop_triangles
    loops = _column(triangles, "loops", np.int32, 3).ravel()
    arrays = {"vertices": vertices, "faces": _column(triangles, "vertices", np.int32, 3).astype(np.int64)}
    nodes = [[] if slot is None or not slot.node_tree else slot.node_tree.nodes for slot in mesh.materials]
    images = [
        next((node.image for node in tree if node.bl_idname == "ShaderNodeTexImage"), None) for tree in nodes
    ]
    if images and all(images) and mesh.uv_layers.active:
        arrays["uvs"] = _column(mesh.uv_layers.active.data, "uv", np.float32, 2)[loops]
        arrays["face_texture"] = np.uint32(_column(triangles, "material_index", np.int32, 1).ravel())
        for number, image in enumerate(images):
            texels = np.zeros((image.size[1], image.size[0], 4), np.float32)
            image.pixels.foreach_get(texels.ravel())
            # What is stored as bytes Blender gives as they are, floats as linear light.
            arrays[f"texture.{number}"] = texels if image.is_float else np.uint8(np.rint(255 * texels))
    colors = mesh.color_attributes.get(COLOR) if about.get("method") else mesh.color_attributes.active_color
    if colors is not None:
        # Ours, and those beside textures, go as they are stored; of others, linear light, Blender makes sRGB.
        kept = about.get("method") or "uvs" in arrays
        values = _column(colors.data, "color" if kept else "color_srgb", np.float32, 4)
        arrays["colors"] = values[loops if colors.domain == "CORNER" else arrays["faces"].ravel()]
    arrays["about"] = np.array(json.dumps({"up": "+z", "bytes": False, **about}))
    return arrays


def _column(rows: Any, name: str, dtype: type, width: int) -> Any:
    """Return a property of all of Blender's `rows`, (n, width)."""
    values = np.zeros(width * len(rows), dtype)
    rows.foreach_get(name, values)
    return values.reshape(-1, width)


def marked_lines(mesh: bpy.types.Mesh, name: str) -> Any:
    """Return the ends (2n, 3) of the edges of `mesh` with the mark `name`."""
    marks = mesh.attributes.get(name)
    if marks is None or len(marks.data) != len(mesh.edges):
        return np.zeros((0, 3), np.float32)
    ends = _column(mesh.edges, "vertices", np.int32, 2)[_column(marks.data, "value", bool, 1)[:, 0]]
    return _column(mesh.vertices, "co", np.float32, 3)[ends.ravel()]

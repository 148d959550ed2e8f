# SPDX-License-Identifier: GPL-3.0-or-later
"""Conversion of models to Blender meshes with exact colours, and back; display of audits."""

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

# This environment variable is the path of a Python with the package meshsplatbench. By default Blender's
# Python runs the wheels of the extension.
VARIABLE = "MSB_PYTHON"
# A custom property of an object stores data as JSON that the mesh cannot store.
ABOUT = "meshsplatbench"
# Names of the colour attributes (GREY for models without colours) and of the UV map.
COLOR, GREY, UVS = "Color", "Grey", "UVMap"
# Edges with one of these attributes are marked by lines of this colour (RGBA).
MARKS = {"boundary": (1.0, 0.6, 0.0, 1.0), "nonmanifold": (0.9, 0.0, 0.9, 1.0)}
# Constants of the sRGB curve (IEC 61966-2-1).
SRGB_KNEE, SRGB_SLOPE, SRGB_OFFSET, SRGB_POWER = 0.04045, 12.92, 0.055, 2.4
WRAPS = {"repeat": "REPEAT", "clamp": "EXTEND", "mirror": "MIRROR"}


class WorkerError(Exception):
    """An error in the other process, with a message of one line."""


def ask(verb: str, source: str | dict[str, Any], target: str | None = None) -> dict[str, Any]:
    """Run `worker.py` to "read" a path, or to "audit" or "save" arrays; return the answer as arrays."""
    python = os.environ.get(VARIABLE)
    paths = {} if python else {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    with tempfile.TemporaryDirectory(prefix="msb-") as folder:
        if isinstance(source, dict):
            arrays, source = source, str(Path(folder, "mesh.npz"))
            np.savez(source, **arrays)
        answer = target or str(Path(folder, "answer.npz"))
        command = [python or sys.executable, str(Path(__file__).with_name("worker.py")), verb, source, answer]
        process = subprocess.run(
            command,
            capture_output=True,
            env={**os.environ, **paths},
            encoding="utf-8",
            errors="replace",
            check=False,
        )
        if process.returncode:
            lines = [line for line in process.stderr.splitlines() if line.strip()]
            raise WorkerError(lines[-1] if lines else f"the process ended with status {process.returncode}")
        if target:
            return {}
        with np.load(answer) as file:
            return dict(file)


def add_model(name: str, arrays: dict[str, Any]) -> tuple[bpy.types.Object, int]:
    """Return an object with the mesh and materials of a model, and the number of faces that Blender rejects.

    `arrays` is the answer of `ask("read", ...)`; worker.py describes the arrays.
    """
    about, faces = json.loads(str(arrays["about"])), arrays["faces"]
    # Add the vertices, and polygons of three consecutive loops (corners).
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(arrays["vertices"]))
    mesh.vertices.foreach_set("co", np.float32(arrays["vertices"]).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", np.int32(faces).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    # Add colours and UV coordinates of the corners, and one material for each texture.
    colors = None
    if "colors" in arrays:
        colors = mesh.color_attributes.new(GREY if about.get("grey") else COLOR, "FLOAT_COLOR", "CORNER")
        colors.data.foreach_set("color", arrays["colors"].ravel())
    keys = (f"texture.{number}" for number in range(len(arrays)))
    images = [arrays[key] for key in keys if key in arrays]
    if images:
        mesh.uv_layers.new(name=UVS).data.foreach_set("uv", arrays["uvs"].ravel())
    if "face_texture" in arrays:
        mesh.polygons.foreach_set("material_index", np.int32(arrays["face_texture"]))
    for number, pixels in enumerate(images or [None]):
        title = f"{name} {number}" if len(images) > 1 else name
        image = None if pixels is None else add_image(title, pixels)
        mesh.materials.append(
            make_unlit_material(title, colors and colors.name, image, about.get("sampler", {}))
        )
    mesh.update(calc_edges=True)
    mesh.validate(clean_customdata=False)
    thing = bpy.data.objects.new(name, mesh)
    thing.matrix_world = Matrix(about["turn"]).to_4x4()
    show_audit(thing, arrays, about)
    return thing, len(faces) - len(mesh.polygons)


def add_image(name: str, texels: Any) -> bpy.types.Image:
    """Return an image of `texels` (H, W, 4) in linear light, lowest row first; alpha is not premultiplied.

    The image stores floats, because Cycles filters byte images before the conversion to linear light.
    Engines and msb convert to linear light before they filter.
    """
    height, width, _ = texels.shape
    image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=True, is_data=True)
    image.alpha_mode = "CHANNEL_PACKED"
    image.pixels.foreach_set(texels.ravel())
    image.update()
    image.pack()
    return image


def make_unlit_material(
    name: str, colors: str | None, image: bpy.types.Image | None, sampler: dict[str, Any]
) -> bpy.types.Material:
    """Return a material that emits the attribute `colors` times `image`, transparent below the alpha cutoff.

    Without a texture, colours are sRGB and are interpolated as sRGB. The shader then converts to linear
    light, and the view transform Standard converts to sRGB again. With a texture, colours are linear light.
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
        texel, texel_alpha = texture.outputs["Color"], texture.outputs["Alpha"]
        if color is not None:
            product = nodes.new("ShaderNodeMath")
            product.operation = "MULTIPLY"
            link(texel_alpha, product.inputs[0])
            link(alpha, product.inputs[1])
            texel, texel_alpha = vector("MULTIPLY", texel, color), product.outputs[0]
        color, alpha = texel, texel_alpha
    else:
        # Convert sRGB to linear light by a sum of two terms without a condition:
        # ((max(c, knee) + offset) / (1 + offset)) ** power + (min(c, knee) - knee) / slope.
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
    surface = emission.outputs[0]
    if sampler.get("alpha_cutoff") is not None:
        below, clear, mix = (
            nodes.new(f"ShaderNode{kind}") for kind in ("Math", "BsdfTransparent", "MixShader")
        )
        below.operation, below.inputs[1].default_value = "LESS_THAN", sampler["alpha_cutoff"]
        link(alpha, below.inputs[0])
        link(below.outputs[0], mix.inputs[0])
        link(surface, mix.inputs[1])
        link(clear.outputs[0], mix.inputs[2])
        surface = mix.outputs[0]
    link(surface, output.inputs["Surface"])
    return material


def show_exactly(context: bpy.types.Context) -> None:
    """Set up the scene for exact colours: no tone mapping or dithering, and viewports that show materials."""
    scene = context.scene
    scene.display_settings.display_device = "sRGB"
    view = scene.view_settings
    view.view_transform, view.look, view.exposure, view.gamma = "Standard", "None", 0, 1
    scene.render.dither_intensity = 0
    for area in context.screen.areas if context.screen else ():
        if area.type == "VIEW_3D" and area.spaces.active.shading.type in {"SOLID", "WIREFRAME"}:
            area.spaces.active.shading.type = "MATERIAL"


def show_audit(thing: bpy.types.Object, arrays: dict[str, Any], about: dict[str, Any]) -> None:
    """Store an audit: the verdict as a custom property of the object, marked edges as mesh attributes."""
    thing[ABOUT] = json.dumps(about)
    mesh = thing.data
    ends = _column(mesh.edges, "vertices", np.int32, 2)
    # Compare edges by a key: lower vertex number * V + higher vertex number.
    base = np.array([len(mesh.vertices), 1], np.int64)
    keys = np.sort(arrays["number"][ends], axis=1) @ base
    for name in MARKS:
        marks = mesh.attributes.get(name) or mesh.attributes.new(name, "BOOLEAN", "EDGE")
        marks.data.foreach_set("value", np.isin(keys, np.sort(arrays[name], axis=1) @ base))


def make_mesh_arrays(thing: bpy.types.Object, mesh: bpy.types.Mesh) -> dict[str, Any]:
    """Return the arrays of `mesh`, the mesh of `thing` with or without modifiers, in the axes of the model.

    worker.py describes the arrays.
    """
    about = json.loads(thing.get(ABOUT, "{}"))
    turn = Matrix(about.setdefault("turn", np.eye(3).tolist())).to_4x4()
    # Apply the transform of the object since the import.
    moved = np.array(turn.inverted() @ thing.matrix_world)
    vertices = _column(mesh.vertices, "co", np.float32, 3)
    if not np.allclose(moved, np.eye(4), atol=1e-6):  # else keep the exact vertices
        vertices = np.float32(vertices @ moved[:3, :3].T + moved[:3, 3])
    mesh.calc_loop_triangles()
    triangles = mesh.loop_triangles
    loops = _column(triangles, "loops", np.int32, 3).ravel()
    arrays = {"vertices": vertices, "faces": _column(triangles, "vertices", np.int32, 3).astype(np.int64)}
    # Add textures if every material has an image.
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
            # Blender returns byte images unchanged (sRGB), and float images as linear light.
            arrays[f"texture.{number}"] = texels if image.is_float else np.uint8(np.rint(255 * texels))
    colors = mesh.color_attributes.get(COLOR) if about.get("method") else mesh.color_attributes.active_color
    if colors is not None:
        # Colours of our models and colours with textures are read as stored. Blender stores other colours in
        # linear light, and `color_srgb` converts them to sRGB.
        as_stored = about.get("method") or "uvs" in arrays
        values = _column(colors.data, "color" if as_stored else "color_srgb", np.float32, 4)
        arrays["colors"] = values[loops if colors.domain == "CORNER" else arrays["faces"].ravel()]
    arrays["about"] = np.array(json.dumps({"up": "+z", "bytes": False, **about}))
    return arrays


def _column(rows: Any, name: str, dtype: type, width: int) -> Any:
    """Return a property of all `n` elements of a Blender collection as an array (n, width)."""
    values = np.zeros(width * len(rows), dtype)
    rows.foreach_get(name, values)
    return values.reshape(-1, width)


def find_marked_lines(mesh: bpy.types.Mesh, name: str) -> Any:
    """Return the end points (2n, 3) of the edges of `mesh` that have the mark `name`."""
    marks = mesh.attributes.get(name)
    if marks is None or len(marks.data) != len(mesh.edges):
        return np.zeros((0, 3), np.float32)
    ends = _column(mesh.edges, "vertices", np.int32, 2)[_column(marks.data, "value", bool, 1)[:, 0]]
    return _column(mesh.vertices, "co", np.float32, 3)[ends.ravel()]

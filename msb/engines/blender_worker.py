"""The program in Blender's process imports a mesh file, sets up exact colours, and renders on request.

`blender.py` starts this program with a Python interpreter that only needs bpy. Each line on standard input is
a request (a JSON object); the answer is a line on standard output. The messages of Blender go to standard
error.
"""

import json
import os
import sys
import time
from pathlib import Path
from typing import Any


def main() -> None:
    """Answer requests until standard input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    worker: Worker | None = None
    for line in sys.stdin:
        request = json.loads(line)
        try:
            if worker is None:
                worker = Worker(request)
                answer = worker.about
            else:
                answer = worker.render(request)
            answer["resident"] = resident()
        except Exception as error:  # forward Blender's message
            answer = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
    answers.close()
    os._exit(0)  # bpy may crash when the interpreter ends


class Worker:
    """A scene with one mesh and one camera.

    The first request has `file` (.ply or .glb), `engine` ("cycles" or "workbench"), `textured`, `cutoff`
    (alpha cutoff or null) and `exact`. If `exact` is false, Blender's defaults for colour management and for
    imported colours remain.
    """

    def __init__(self, request: dict[str, Any]) -> None:
        import bpy

        self._bpy, self._exact = bpy, request["exact"]
        self._textured, self._cutoff = request["textured"], request["cutoff"]
        self.about = {"version": bpy.app.version_string, "baseline": resident()}
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene = bpy.context.scene
        self._import(request["file"])
        self.mesh = next(thing for thing in bpy.data.objects if thing.type == "MESH")
        self._set_output()
        self.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        self.scene.collection.objects.link(self.camera)
        self.scene.camera = self.camera
        if request["engine"] == "cycles":
            self._set_cycles()
        else:
            self._set_workbench()

    def _import(self, name: str) -> None:
        operators = self._bpy.ops
        if name.endswith(".ply"):
            # With "LINEAR", the importer keeps the colours of the file; by default, it converts colours from
            # sRGB.
            operators.wm.ply_import(filepath=name, import_colors="LINEAR" if self._exact else "SRGB")
        else:
            operators.import_scene.gltf(filepath=name)

    def _set_output(self) -> None:
        scene = self.scene
        if self._exact:
            scene.display_settings.display_device = "sRGB"
            scene.view_settings.view_transform = "Raw"
            scene.view_settings.look = "None"
            scene.view_settings.exposure = 0
            scene.view_settings.gamma = 1
        render = scene.render
        render.resolution_percentage = 100
        render.dither_intensity = 0
        render.filter_size = 0
        render.film_transparent = True  # `opaque_frame` adds the background later
        render.use_compositing = render.use_sequencer = False
        self.scene.view_layers[0].use_pass_z = True

    def _set_cycles(self) -> None:
        scene, bpy = self.scene, self._bpy
        scene.render.engine = "CYCLES"
        scene.render.use_persistent_data = True
        cycles = scene.cycles
        cycles.device = "CPU"
        cycles.samples = 1
        cycles.use_adaptive_sampling = cycles.use_denoising = False
        cycles.max_bounces = 0
        # Use one sample at the centre of each pixel.
        cycles.pixel_filter_type = "BOX"
        cycles.filter_width = 0.01
        if self._textured:
            cycles.transparent_max_bounces = 1024
            for material in self.mesh.data.materials:
                self._make_unlit(material)
            return
        material = bpy.data.materials.new("unlit")
        if not material.node_tree:  # before Blender 5
            material.use_nodes = True
        material.node_tree.nodes.clear()
        self._make_unlit(material)
        self.mesh.data.materials.clear()
        self.mesh.data.materials.append(material)

    def _make_unlit(self, material: Any) -> None:
        """Make `material` emit vertex colours times the texture, and be transparent below the alpha cutoff.

        The importer's nodes that wrap texture coordinates are kept.
        """
        nodes, links = material.node_tree.nodes, material.node_tree.links
        image = next((node for node in nodes if node.bl_idname == "ShaderNodeTexImage"), None)
        output = next((node for node in nodes if node.bl_idname == "ShaderNodeOutputMaterial"), None)
        output = output or nodes.new("ShaderNodeOutputMaterial")
        emission, attribute = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = self.mesh.data.color_attributes[0].name
        color, alpha = attribute.outputs["Color"], attribute.outputs["Alpha"]
        if image is not None:
            image.image.alpha_mode = "CHANNEL_PACKED"  # filter colours that are not premultiplied by alpha
            if self._exact:
                image.image = self._linear_copy(image.image)
            # Multiply the texture with the vertex colour, and the texture's alpha with the vertex alpha.
            product, alphas = nodes.new("ShaderNodeVectorMath"), nodes.new("ShaderNodeMath")
            product.operation = alphas.operation = "MULTIPLY"
            for node, channel, stored in ((product, "Color", color), (alphas, "Alpha", alpha)):
                links.new(image.outputs[channel], node.inputs[0])
                links.new(stored, node.inputs[1])
            color, alpha = product.outputs[0], alphas.outputs[0]
        links.new(color, emission.inputs["Color"])
        surface = emission.outputs["Emission"]
        if self._cutoff is not None:
            # Mix with a transparent shader: the factor is 1 where alpha < cutoff.
            below, clear, mix = (
                nodes.new(f"ShaderNode{name}") for name in ("Math", "BsdfTransparent", "MixShader")
            )
            below.operation, below.inputs[1].default_value = "LESS_THAN", self._cutoff
            links.new(alpha, below.inputs[0])
            links.new(below.outputs[0], mix.inputs[0])
            links.new(surface, mix.inputs[1])
            links.new(clear.outputs[0], mix.inputs[2])
            surface = mix.outputs[0]
        links.new(surface, output.inputs["Surface"])

    def _linear_copy(self, image: Any) -> Any:
        """Return a float copy of an image in linear light.

        Cycles would filter an 8-bit image before converting it to linear light.
        """
        import numpy as np

        texels = np.zeros((image.size[0] * image.size[1], 4), np.float32)
        image.pixels.foreach_get(texels.ravel())
        colors = texels[:, :3]
        colors[:] = np.where(colors > 0.04045, ((colors + 0.055) / 1.055) ** 2.4, colors / 12.92)
        copy = self._bpy.data.images.new("linear", *image.size, alpha=True, float_buffer=True, is_data=True)
        copy.alpha_mode = "CHANNEL_PACKED"
        copy.pixels.foreach_set(texels.ravel())
        copy.update()
        return copy

    def _set_workbench(self) -> None:
        import gpu

        scene = self.scene
        scene.render.engine = "BLENDER_WORKBENCH"
        scene.display.render_aa = "OFF"
        shading = scene.display.shading
        shading.light = "FLAT"
        shading.color_type = "TEXTURE" if self._textured else "VERTEX"
        for name in ("show_shadows", "show_cavity", "show_object_outline", "show_specular_highlight"):
            setattr(shading, name, False)
        shading.show_backface_culling = False
        # Draw a small image first, because Blender reports the graphics device only after drawing.
        scene.render.resolution_x = scene.render.resolution_y = 8
        self._bpy.ops.render.render()
        self.about["gpu"] = gpu.platform.renderer_get()

    def render(self, request: dict[str, Any]) -> dict[str, Any]:
        """Render with the camera of the request; write the files `png` and `exr` (with depths) if given."""
        from mathutils import Matrix

        scene, camera = self.scene, self.camera.data
        render = scene.render
        render.resolution_x, render.resolution_y = request["size"]
        render.pixel_aspect_x, render.pixel_aspect_y = request["aspect"]
        camera.sensor_fit = "HORIZONTAL"
        camera.sensor_width, camera.lens = request["sensor_width"], request["lens"]
        camera.shift_x, camera.shift_y = request["shift"]
        camera.clip_start, camera.clip_end = request["clip"]
        self.camera.matrix_world = Matrix(request["matrix"])
        settings = render.image_settings
        target = request.get("exr") or request.get("png")
        if target:
            render.filepath = target
            layered = bool(request.get("exr"))
            if hasattr(settings, "media_type"):  # since Blender 5
                settings.media_type = "MULTI_LAYER_IMAGE" if layered else "IMAGE"
            settings.file_format = "OPEN_EXR_MULTILAYER" if layered else "PNG"
            settings.color_depth = "32" if layered else "8"
            if layered:
                settings.exr_codec = "NONE"
                if hasattr(settings, "use_exr_interleave"):
                    settings.use_exr_interleave = True  # multi-part files fail if pixels are not square
            else:
                settings.color_mode = "RGBA"
        start = time.perf_counter()
        self._bpy.ops.render.render(write_still=bool(target))
        return {"ms": 1000 * (time.perf_counter() - start)}


def resident() -> int:
    """Return the resident memory of this process in bytes; 0 if the system does not report it."""
    status = Path("/proc/self/statm")
    return int(status.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if status.exists() else 0


if __name__ == "__main__":
    main()

"""A script for Blender's Python that tests the extension: it imports, audits, draws and exports models.

Usage: ``blender_extension.py FOLDER JOBS``. FOLDER contains the package of the extension. JOBS is a JSON
list; each job has the paths `model`, `image` and `saved`, and a `camera` (`blender_camera` with `clip`
distances). The script prints a JSON list with a result for each job.
"""

import json
import os
import sys
from types import SimpleNamespace
from typing import Any

import bpy
from mathutils import Matrix


def run_job(job: dict[str, Any]) -> dict[str, Any]:
    """Import, draw, export and audit a model; return the results of the extension."""
    import meshsplatbench as extension
    from meshsplatbench.model import ABOUT, MARKS, find_marked_lines

    bpy.ops.wm.read_factory_settings(use_empty=True)
    try:
        bpy.ops.import_scene.meshsplatbench(filepath=job["model"])
    except RuntimeError as error:
        return {"error": str(error)}
    thing = bpy.context.object
    draw(bpy.context.scene, thing, job["camera"], job["image"])
    about = json.loads(thing[ABOUT])
    bpy.ops.export_scene.meshsplatbench(filepath=job["saved"])
    bpy.ops.object.meshsplatbench_audit()
    return {
        "again": json.loads(thing[ABOUT])["audit"],
        "audit": about["audit"],
        "marks": {name: len(find_marked_lines(thing.data, name)) // 2 for name in MARKS},
        "panel": panel_lines(extension.Panel),
        "transform": bpy.context.scene.view_settings.view_transform,
    }


def panel_lines(panel: Any) -> list[str]:
    """Return the texts of the panel for the active object."""
    lines: list[str] = []
    layout = SimpleNamespace(
        label=lambda text, icon="": lines.append(text),
        column=lambda align: layout,
        prop=lambda owner, name: lines.append(owner.bl_rna.properties[name].name),
        operator=lines.append,
    )
    context = SimpleNamespace(
        object=bpy.context.object,
        region=SimpleNamespace(width=300),
        window_manager=bpy.context.window_manager,
    )
    panel.draw(SimpleNamespace(layout=layout), context)
    return lines


def draw(scene: Any, thing: Any, request: dict[str, Any], path: str) -> None:
    """Render with Cycles, with one ray through the centre of each pixel.

    The camera is given in the axes of the model.
    """
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.max_bounces = "CPU", 1, 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 0.01
    cycles.transparent_max_bounces = 1024
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    render, lens = scene.render, camera.data
    render.film_transparent = True
    render.resolution_x, render.resolution_y = request["size"]
    render.pixel_aspect_x, render.pixel_aspect_y = request["aspect"]
    lens.sensor_fit, lens.sensor_width, lens.lens = "HORIZONTAL", request["sensor_width"], request["lens"]
    lens.shift_x, lens.shift_y = request["shift"]
    lens.clip_start, lens.clip_end = request["clip"]
    camera.matrix_world = thing.matrix_world @ Matrix(request["matrix"])
    render.filepath = path
    settings = render.image_settings
    if hasattr(settings, "media_type"):  # since Blender 5
        settings.media_type = "IMAGE"
    settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGBA", "8"
    bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # Blender's own output goes to standard error
    sys.path.insert(0, sys.argv[1])
    import meshsplatbench

    bpy.ops.wm.read_factory_settings(use_empty=True)
    meshsplatbench.register()
    answers.write(json.dumps([run_job(job) for job in json.loads(sys.argv[2])]))
    meshsplatbench.unregister()
    answers.close()
    os._exit(0)  # bpy may crash when the interpreter ends

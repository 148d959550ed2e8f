# SPDX-License-Identifier: GPL-3.0-or-later
"""MeshSplatBench in Blender: import, audit and export of trained triangle and mesh splatting models.

The extension contains the package meshsplatbench, which runs in another process (`worker.py`) and exchanges
arrays with Blender (`model.py`). Blender's importers are not used, because they lose faces, vertices and
colours.
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any

import bpy
import gpu
from bpy_extras.io_utils import ExportHelper, ImportHelper
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix

from .model import (
    ABOUT,
    MARKS,
    WorkerError,
    add_model,
    ask,
    find_marked_lines,
    make_mesh_arrays,
    show_audit,
    show_exactly,
)

# Marked edges as (colour, batch of lines), by the session UID of a mesh. Cleared when any object changes.
_lines: dict[int, list[tuple[Any, Any]]] = {}


@bpy.app.handlers.persistent
def _forget_lines(*_: Any) -> None:
    _lines.clear()


def _draw_lines() -> None:
    """Draw the marked edges of visible meshes, if the panel option is on."""
    if not bpy.context.window_manager.msb_marks:
        return
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    gpu.state.depth_test_set("LESS_EQUAL")
    for thing in bpy.context.visible_objects:
        if thing.type != "MESH" or ABOUT not in thing or thing.mode == "EDIT":
            continue
        key = thing.data.session_uid
        if key not in _lines:
            ends = [(color, find_marked_lines(thing.data, name)) for name, color in MARKS.items()]
            _lines[key] = [
                (color, batch_for_shader(shader, "LINES", {"pos": points}))
                for color, points in ends
                if len(points)
            ]
        shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
        shader.uniform_float("lineWidth", 2.5)
        with gpu.matrix.push_pop_projection(), gpu.matrix.push_pop():
            nearer = Matrix.Translation((0, 0, -1e-5)) @ gpu.matrix.get_projection_matrix()
            gpu.matrix.load_projection_matrix(nearer)  # draws lines in front of the faces
            gpu.matrix.multiply_matrix(thing.matrix_world)
            for color, batch in _lines[key]:
                shader.uniform_float("color", color)
                batch.draw(shader)
    gpu.state.depth_test_set("NONE")


class ImportModel(bpy.types.Operator, ImportHelper):
    """Import a checkpoint, its folder, a .triasset or a mesh file with exact colours, and audit it"""

    bl_idname = "import_scene.meshsplatbench"
    bl_label = "Import Model"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender requires a set

    def execute(self, context: bpy.types.Context) -> set[str]:
        path = Path(self.filepath)
        try:
            thing, rejected = add_model(path.stem, ask("read", str(path)))
        except WorkerError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        context.collection.objects.link(thing)
        bpy.ops.object.select_all(action="DESELECT")
        thing.select_set(True)
        context.view_layer.objects.active = thing
        show_exactly(context)
        if rejected:
            self.report(
                {"WARNING"},
                f"{rejected:,} duplicate or degenerate faces were skipped; Blender cannot store them",
            )
        return {"FINISHED"}


class AuditMesh(bpy.types.Operator):
    """Audit the current mesh without modifiers; polygons are split into triangles"""

    bl_idname = "object.meshsplatbench_audit"
    bl_label = "Audit"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.mode == "OBJECT" and context.object is not None and context.object.type == "MESH"

    def execute(self, context: bpy.types.Context) -> set[str]:
        thing = context.object
        try:
            arrays = ask("audit", make_mesh_arrays(thing, thing.data))
        except WorkerError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        about = {**json.loads(thing.get(ABOUT, "{}")), "audit": json.loads(str(arrays["about"]))["audit"]}
        show_audit(thing, arrays, about)
        _lines.clear()
        return {"FINISHED"}


class ExportModel(bpy.types.Operator, ExportHelper):
    """Export the current mesh with modifiers, colours and textures as a .triasset"""

    bl_idname = "export_scene.meshsplatbench"
    bl_label = "Export .triasset"
    filename_ext = ".triasset"
    poll = AuditMesh.poll

    def execute(self, context: bpy.types.Context) -> set[str]:
        thing = context.object.evaluated_get(context.evaluated_depsgraph_get())
        try:
            ask("save", make_mesh_arrays(context.object, thing.to_mesh()), self.filepath)
        except WorkerError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        finally:
            thing.to_mesh_clear()
        return {"FINISHED"}


class Panel(bpy.types.Panel):
    """Shows the audit of the active mesh."""

    bl_idname = "VIEW3D_PT_meshsplatbench"
    bl_label = "MeshSplatBench"
    bl_space_type, bl_region_type, bl_category = "VIEW_3D", "UI", "MeshSplatBench"

    def draw(self, context: bpy.types.Context) -> None:
        layout, thing = self.layout, context.object
        audit = json.loads(thing.get(ABOUT, "{}")).get("audit") if thing else None
        if audit:
            layout.label(text=audit["level"].upper(), icon="CHECKMARK" if audit["level"] == "ok" else "ERROR")
            lines = layout.column(align=True)
            for line in textwrap.wrap(audit["sentence"], max(20, context.region.width // 8)):
                lines.label(text=line)
            for name, count in audit["counts"].items():
                layout.label(text=f"{name.replace('_', ' ')}: {count:,}")
        layout.prop(context.window_manager, "msb_marks")
        for operator in (AuditMesh, ImportModel, ExportModel):
            layout.operator(operator.bl_idname)


CLASSES = (ImportModel, AuditMesh, ExportModel, Panel)
_handles: list[Any] = []


def _add_import(menu: bpy.types.Menu, _: Any) -> None:
    menu.layout.operator(ImportModel.bl_idname, text="Triangle or mesh splatting model (MeshSplatBench)")


def _add_export(menu: bpy.types.Menu, _: Any) -> None:
    menu.layout.operator(ExportModel.bl_idname, text="MeshSplatBench (.triasset)")


def register() -> None:
    """Add the operators, menus, the panel and the drawing of marked edges."""
    for entry in CLASSES:
        bpy.utils.register_class(entry)
    text = "Show boundary edges in orange and non-manifold edges in magenta"
    bpy.types.WindowManager.msb_marks = bpy.props.BoolProperty(
        name="Mark edges", description=text, default=True
    )
    bpy.types.TOPBAR_MT_file_import.append(_add_import)
    bpy.types.TOPBAR_MT_file_export.append(_add_export)
    bpy.app.handlers.depsgraph_update_post.append(_forget_lines)
    _handles.append(bpy.types.SpaceView3D.draw_handler_add(_draw_lines, (), "WINDOW", "POST_VIEW"))


def unregister() -> None:
    """Remove everything that `register` added."""
    bpy.types.SpaceView3D.draw_handler_remove(_handles.pop(), "WINDOW")
    bpy.app.handlers.depsgraph_update_post.remove(_forget_lines)
    bpy.types.TOPBAR_MT_file_export.remove(_add_export)
    bpy.types.TOPBAR_MT_file_import.remove(_add_import)
    del bpy.types.WindowManager.msb_marks
    for entry in reversed(CLASSES):
        bpy.utils.unregister_class(entry)

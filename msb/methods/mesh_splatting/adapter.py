"""Read MeshSplatting: ``point_cloud/iteration_N/point_cloud_state_dict.pt`` or a mesh PLY.

Layout: meshsplatting/mesh-splatting at 608e5d0 (scene/triangle_model.py, create_ply.py). All parameters are
per vertex, except sigma, which is global. This adapter also reads files of Triangle Splatting+. Files of
Triangle Splatting+ have the same layout without `pixel_count`.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from msb.adapters.locate import Place
from msb.adapters.model import Content, Model, Options, Settings, domains_of, sh_appearance
from msb.adapters.tensors import Tensors
from msb.adapters.training_config import read_cfg_args, trained_up, training_of
from msb.asset import Description
from msb.asset.manifest import CoordinateFrame
from msb.asset.sh import SH_C0
from msb.errors import CheckpointError, about
from msb.meshes.assets import make_mesh_buffers
from msb.meshes.files import read_mesh
from msb.meshes.mesh import report_origin

KEYS = ("triangles_points", "_triangle_indices", "vertex_weight", "features_dc", "sigma")
# The opacity floor that the official code sets when it imports a PLY.
_FLOOR_OF_MESHES = 0.9999


def recognises(content: Content) -> bool:
    """Return whether `content` is a state dict with shared vertices and pixel counts."""
    return shares_vertices(content) and "pixel_count" in content.value


def shares_vertices(content: Content) -> bool:
    """Return whether `content` is a state dict with shared vertices."""
    value = content.value
    return isinstance(value, dict) and bool({"_triangle_indices", "vertex_weight"} & value.keys())


def read(place: Place, content: Content, options: Options, method: str = "mesh_splatting") -> Model:
    """Return the model at `place`. `method` is MeshSplatting, or a method with the same file layout.

    The opacity of a vertex is floor + (1 - floor) sigmoid(logit). Files do not store the opacity floor. The
    official loader of each method defines the floor.
    """
    if place.kind in ("ply", "mesh"):
        return _read_mesh(method, place, options)
    settings = Settings(method, options.settings)
    tensors = Tensors(content.mapping(place.file), place.file, options.check_values)
    positions = tensors.floats("triangles_points", "V", 3)
    count = len(positions)
    degree = 0
    if "features_rest" in tensors:  # the official exporter may omit this array
        degree = tensors.degree("features_rest", tensors.axis("features_rest", 1))
    buffers: dict[str, Any] = {
        "positions": positions,
        "indices": tensors.indices("_triangle_indices", count, "F", 3),
        "f_dc": tensors.floats("features_dc", "V", 1, 3).reshape(count, 3),
        "opacity": tensors.floats("vertex_weight", "V", 1, infinite=True).reshape(count),
    }
    if degree:
        buffers["f_rest"] = tensors.floats("features_rest", "V", "K", 3).reshape(count, -1)
    if "active_sh_degree" in tensors:
        highest = degree if "features_rest" in tensors else 3
        active = min(tensors.integer("active_sh_degree", 0, highest), degree)
        settings.add("sh_degree", active, "checkpoint", place.file)
    settings.add("sigma", _exp(tensors.number("sigma")), "checkpoint", place.file, "exp(sigma)")
    arguments, files, warnings = read_cfg_args(place.root)
    description = _description(method, settings, degree, arguments, trained_up(arguments))
    files = (place.file, *files)
    return Model(
        buffers, domains_of(buffers, "vertex"), description, place.root, files, (*tensors.warnings, *warnings)
    )


def _read_mesh(method: str, place: Place, options: Options) -> Model:
    """Return the model that the official code builds from an exported mesh: opaque, with SH degree 0.

    f_dc is clip((rgb - 0.5) / C0, -4, 4), and opacity logits are infinite.
    """
    settings = Settings(method, options.settings)
    mesh = read_mesh(place.file)
    with about(place.file):
        made = make_mesh_buffers(mesh)
    if mesh.vertex_colors is None:
        text = "vertex colours are missing; the PLY of the official exporter has red, green, blue, alpha"
        raise CheckpointError("CHECKPOINT_LAYOUT", text, file=place.file, pointer="red")
    colors = mesh.vertex_colors[:, :3].astype(np.float32)
    if mesh.vertex_colors.dtype == np.uint8:
        colors /= np.float32(255)
    buffers = {name: values for name, values in made.buffers.items() if name != "color"}
    buffers["f_dc"] = np.clip((colors - np.float32(0.5)) / np.float32(SH_C0), -4, 4)
    buffers["opacity"] = np.full(len(colors), np.inf, np.float32)
    settings.add("opacity_floor", _FLOOR_OF_MESHES, "default")
    description = _description(method, settings, 0, {}, mesh.up or "unknown")
    description = replace(description, origin=made.origin)
    notes = report_origin(mesh)
    return Model(buffers, domains_of(buffers, "vertex"), description, place.root, (place.file,), notes)


def _description(
    method: str, settings: Settings, degree: int, arguments: Mapping[str, Any], up: str
) -> Description:
    """Return the description of a model for its manifest."""
    stored = settings.finish(degree)
    return Description(
        method=method,
        sh_degree=degree,
        coverage={"kernel": "edge_window", "sigma": stored["sigma"].value},
        opacity={"encoding": "logit", "floor": stored["opacity_floor"].value, "of_face": "minimum"},
        appearance=sh_appearance(degree, arguments.get("white_background")),
        compositing={"kind": "front_to_back"},
        settings=stored,
        training=training_of(arguments),
        coordinate_frame=CoordinateFrame(up=up),
    )


def _exp(logarithm: float) -> float:
    """Return exp(logarithm), or infinity if it overflows."""
    return math.exp(logarithm) if logarithm < 700 else math.inf

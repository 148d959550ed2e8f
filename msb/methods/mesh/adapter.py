"""Read any other mesh file; files of the methods' own exporters are among them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.adapters.model import Content, Model, Options
from msb.adapters.setting_sources import Settings
from msb.asset import Description
from msb.asset.manifest import CoordinateFrame
from msb.errors import about
from msb.meshes.assets import mesh_buffers
from msb.meshes.files import read_mesh
from msb.meshes.mesh import left_out_finding

if TYPE_CHECKING:
    from msb.adapters.locate import Place


def recognises(content: Content) -> bool:
    """Return whether `content` is a mesh file, and no table of primitives."""
    if content.place.kind == "ply":
        return not {"rot_0", "x1"} & set(content.ply_names)
    return content.place.kind == "mesh"


def read(place: Place, content: Content, options: Options) -> Model:
    """Return the mesh at `place`, every row and its colours as stored."""
    Settings("mesh", options.settings)  # it has none: any name is an error
    mesh = read_mesh(place.file)
    with about(place.file):
        buffers, domains, appearance = mesh_buffers(mesh)
    description = Description(
        appearance=appearance, coordinate_frame=CoordinateFrame(up=mesh.up or "unknown")
    )
    return Model(buffers, domains, description, place.root, (place.file,), left_out_finding(mesh))

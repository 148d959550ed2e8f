"""Read Triangle Splatting+: ``point_cloud/iteration_N/point_cloud_state_dict.pt`` without `pixel_count`.

Layout: trianglesplatting2/triangle-splatting2 at fcde03d (scene/triangle_model.py), that of MeshSplatting but
for the missing counts; its loader imposes an opacity floor of 0.9999.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.methods.mesh_splatting.adapter import KEYS, read_as, shares_vertices

if TYPE_CHECKING:
    from msb.adapters.locate import Place
    from msb.adapters.model import Content, Model, Options

__all__ = ["KEYS", "read", "recognises"]


def recognises(content: Content) -> bool:
    """Return whether `content` is a state dict with shared vertices, without counts of pixels."""
    return shares_vertices(content) and "pixel_count" not in content.value


def read(place: Place, content: Content, options: Options) -> Model:
    """Return the model at `place`; a mesh file as MeshSplatting re-imports one."""
    return read_as("triangle_splatting_plus", place, content, options)

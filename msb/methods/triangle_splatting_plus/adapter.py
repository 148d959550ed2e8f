"""Read Triangle Splatting+: ``point_cloud/iteration_N/point_cloud_state_dict.pt`` without `pixel_count`.

Layout: trianglesplatting2/triangle-splatting2 at fcde03d (scene/triangle_model.py), that of MeshSplatting but
for the missing counts; its loader imposes an opacity floor of 0.9999.
"""

from functools import partial

from msb.adapters.model import Content
from msb.methods.mesh_splatting import adapter as sibling

KEYS = sibling.KEYS
# Return the model at a place, as MeshSplatting's adapter does; a mesh file as that re-imports one.
read = partial(sibling.read, method="triangle_splatting_plus")


def recognises(content: Content) -> bool:
    """Return whether `content` is a state dict with shared vertices, without counts of pixels."""
    return sibling.shares_vertices(content) and "pixel_count" not in content.value

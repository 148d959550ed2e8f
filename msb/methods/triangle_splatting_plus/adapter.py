"""Read Triangle Splatting+: ``point_cloud/iteration_N/point_cloud_state_dict.pt`` without `pixel_count`.

Layout: trianglesplatting2/triangle-splatting2 at fcde03d (scene/triangle_model.py). The files equal
MeshSplatting's files without pixel counts. The official loader sets an opacity floor of 0.9999.
"""

from functools import partial

from msb.adapters.model import Content
from msb.methods.mesh_splatting import adapter as sibling

KEYS = sibling.KEYS
# MeshSplatting's adapter also reads models of Triangle Splatting+. Mesh files are read by the code for
# MeshSplatting.
read = partial(sibling.read, method="triangle_splatting_plus")


def recognises(content: Content) -> bool:
    """Return whether `content` is a state dict with shared vertices but without pixel counts."""
    return sibling.shares_vertices(content) and "pixel_count" not in content.value

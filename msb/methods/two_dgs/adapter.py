"""Read 2DGS: its Gaussians, or the mesh from its TSDF fusion, ``train/ours_N/fuse_post.ply``.

Layout: hbb1/2d-gaussian-splatting at 1920a23 (scene/gaussian_model.py, render.py, utils/mesh_utils.py).
"""

from dataclasses import replace

from msb.adapters.locate import FUSED, Place
from msb.adapters.model import Content, Model, Options
from msb.methods.mesh import adapter as mesh
from msb.methods.three_dgs.adapter import captured_axes, read_splats
from msb.splats.ply import holds_discs


def recognises(content: Content) -> bool:
    """Return whether `content` has the name of a fused mesh, or contains Gaussians with two axes."""
    return _holds_discs(content) or content.place.file.name in FUSED


def read(place: Place, content: Content, options: Options) -> Model:
    """Return the Gaussians or the extracted mesh at `place`."""
    if _holds_discs(content):
        return read_splats(place, content, options, method="two_dgs")
    model = mesh.read(place, content, options)
    return replace(model, description=replace(model.description, method="two_dgs"))


def _holds_discs(content: Content) -> bool:
    if content.place.kind == "ply":
        return holds_discs(content.ply_names)
    return content.place.kind == "torch" and captured_axes(content) == 2

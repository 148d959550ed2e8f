"""Read 2DGS: the mesh of its TSDF fusion, ``train/ours_N/fuse_post.ply``, not the splats.

Layout: hbb1/2d-gaussian-splatting at 1920a23 (render.py, utils/mesh_utils.py).
"""

from dataclasses import replace

from msb.adapters.locate import FUSED, Place
from msb.adapters.model import Content, Model, Options
from msb.errors import CheckpointError
from msb.methods.mesh import adapter as mesh


def recognises(content: Content) -> bool:
    """Return whether `content` has the name of a fused mesh, or is a PLY of splats with two scales."""
    names = content.ply_names
    if "rot_0" in names:
        return "scale_1" in names and "scale_2" not in names
    return content.place.file.name in FUSED


def read(place: Place, content: Content, options: Options) -> Model:
    """Return the extracted mesh at `place`."""
    if "rot_0" in content.ply_names:
        text = "it contains the Gaussians of 2DGS, not a mesh; extract train/ours_N/fuse_post.ply with the "
        text += "method's render.py and pass that file"
        raise CheckpointError("CHECKPOINT_FILE_MISSING", text, file=place.file)
    model = mesh.read(place, content, options)
    return replace(model, description=replace(model.description, method="two_dgs"))

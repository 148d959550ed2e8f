"""Read 2DGS: the mesh that its TSDF fusion extracts, ``train/ours_N/fuse_post.ply``, not the splats.

Layout: hbb1/2d-gaussian-splatting at 1920a23 (render.py, utils/mesh_utils.py).
"""

from dataclasses import replace

from msb.adapters.locate import FUSED, Place
from msb.adapters.model import Content, Model, Options
from msb.errors import CheckpointError
from msb.methods.mesh import adapter as mesh


def recognises(content: Content) -> bool:
    """Return whether `content` is a fused mesh by name, or the splats of 2DGS, which have two scales."""
    names = content.ply_names
    if "rot_0" in names:
        return "scale_1" in names and "scale_2" not in names
    return content.place.file.name in FUSED


def read(place: Place, content: Content, options: Options) -> Model:
    """Return the extracted mesh at `place`."""
    if "rot_0" in content.ply_names:
        text = "it holds the Gaussians of 2DGS; the mesh is needed, train/ours_N/fuse_post.ply, which "
        text += "its render.py extracts"
        raise CheckpointError("CHECKPOINT_FILE_MISSING", text, file=place.file)
    model = mesh.read(place, content, options)
    return replace(model, description=replace(model.description, method="two_dgs"))

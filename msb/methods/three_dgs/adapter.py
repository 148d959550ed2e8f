"""Read 3DGS models: the PLY and the checkpoints of a training, and the formats of viewers and editors.

Layout of a training: graphdeco-inria/gaussian-splatting at 54c035f (scene/gaussian_model.py, train.py).
"""

from functools import partial

import numpy as np

from msb.adapters.locate import Place
from msb.adapters.model import Content, Model, Options, Settings, domains_of, sh_appearance
from msb.adapters.training_config import read_cfg_args, trained_up, training_of
from msb.asset import Description
from msb.asset.manifest import CoordinateFrame
from msb.errors import CheckpointError, finding
from msb.meshes.gltf import uses_gaussians
from msb.methods.three_dgs import SUFFIXES
from msb.methods.three_dgs.adapter_files import is_captured, read_gaussians
from msb.registry import METHODS
from msb.splats.ply import holds_discs, holds_gaussians
from msb.splats.primitive import make_buffers


def recognises(content: Content) -> bool:
    """Return whether `content` holds Gaussians with three axes."""
    place = content.place
    match place.kind:
        case "ply":
            return holds_gaussians(content.ply_names) and not holds_discs(content.ply_names)
        case "mesh":
            return uses_gaussians(place.file)
        case "bundle":
            return place.file.name == METHODS["three_dgs"].bundle[0]
        case "other":
            return place.file.suffix.lower() in SUFFIXES
    return captured_axes(content) == 3


def captured_axes(content: Content) -> int | None:
    """Return the number of axes of the Gaussians in a training checkpoint; None for other content."""
    if not is_captured(content.value):
        return None
    return 2 if tuple(getattr(content.value[0][4], "shape", ()))[1:] == (2,) else 3


def read_splats(place: Place, content: Content, options: Options, *, method: str) -> Model:
    """Return the Gaussians at `place` as a model of `method`.

    `mean`, `scale` and `rotation` are stored as in the checkpoint; each Gaussian also has a placeholder
    triangle.
    """
    with np.errstate(all="ignore"):  # a later step removes values that are not finite
        gaussians = read_gaussians(content)
        buffers = make_buffers(gaussians)
    declared = METHODS[method]
    axes = 2 if method == "two_dgs" else 3
    if gaussians.scale.shape[1] != axes:
        text = f"the Gaussians have {gaussians.scale.shape[1]} axes; {declared.title} needs {axes} axes"
        raise CheckpointError("CHECKPOINT_LAYOUT", text, file=place.file)
    settings = Settings(method, options.settings)
    settings.add("sh_degree", gaussians.degree, "checkpoint", place.file)
    if gaussians.antialiased is not None and "antialiased" in declared.settings:
        settings.add("antialiased", gaussians.antialiased, "checkpoint", place.file)
    # Only the output folder of a training has a config; single files normally have none.
    arguments, files, warnings = read_cfg_args(place.root)
    if not files and place.root == place.file.parent:
        warnings = []
    warnings += [
        finding("MESH_FILE_LEFT_OUT", f"not read: {note}", severity="info") for note in gaussians.notes
    ]
    description = Description(
        method=method,
        primitive="gaussian",
        sh_degree=gaussians.degree,
        coverage={"kernel": declared.coverage},
        opacity={"encoding": "logit"},
        appearance=sh_appearance(gaussians.degree, arguments.get("white_background")),
        compositing={"kind": "front_to_back"},
        settings=settings.finish(gaussians.degree),
        training=training_of(arguments),
        coordinate_frame=CoordinateFrame(up=trained_up(arguments) if arguments else "-y"),
    )
    files = (place.file, *files)
    return Model(buffers, domains_of(buffers, "face"), description, place.root, files, tuple(warnings))


read = partial(read_splats, method="three_dgs")

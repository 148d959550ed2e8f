"""Read Triangle-Splatting's ``point_cloud/iteration_N/point_cloud_state_dict.pt``.

Layout: trianglesplatting/triangle-splatting at 685ff27 (scene/triangle_model.py). A primitive is a separate
triangle with one opacity logit, one sigma and one set of SH coefficients.
"""

from msb.adapters.locate import Place
from msb.adapters.model import Content, Model, Options, Settings, domains_of, sh_appearance, soup_buffers
from msb.adapters.tensors import Tensors
from msb.adapters.training_config import read_cfg_args, trained_up, training_of
from msb.asset import Description
from msb.asset.manifest import CoordinateFrame

KEYS = ("triangles_points", "features_dc", "features_rest", "opacity", "sigma", "active_sh_degree")
# State dict keys of methods with shared vertices.
_NOT_OURS = {"_triangle_indices", "vertex_weight"}


def recognises(content: Content) -> bool:
    """Return whether `content` is a state dict of triangles without shared vertices."""
    value = content.value
    return isinstance(value, dict) and "triangles_points" in value and not _NOT_OURS & value.keys()


def read(place: Place, content: Content, options: Options) -> Model:
    """Return the model at `place`.

    `sigma` is stored as the raw value s of the checkpoint. Renderers use 0.01 + exp(s), as `coverage` in
    the manifest states.
    """
    settings = Settings("triangle_splatting", options.settings)
    tensors = Tensors(content.mapping(place.file), place.file, options.check_values)
    points = tensors.floats("triangles_points", "N", 3, 3)
    degree = tensors.degree("features_rest", tensors.axis("features_rest", 1))
    buffers = soup_buffers(
        points,
        f_dc=tensors.floats("features_dc", "N", 1, 3),
        opacity=tensors.floats("opacity", "N", 1, infinite=True),
        sigma=tensors.floats("sigma", "N", 1),
        f_rest=tensors.floats("features_rest", "N", "K", 3) if degree else None,
    )
    settings.add("sh_degree", tensors.integer("active_sh_degree", 0, degree), "checkpoint", place.file)
    arguments, files, warnings = read_cfg_args(place.root)
    description = Description(
        method="triangle_splatting",
        sh_degree=degree,
        coverage={"kernel": "incentre_window", "sigma_encoding": "exp", "sigma_offset": 0.01},
        opacity={"encoding": "logit"},
        appearance=sh_appearance(degree, arguments.get("white_background")),
        compositing={"kind": "front_to_back"},
        settings=settings.finish(degree),
        training=training_of(arguments),
        coordinate_frame=CoordinateFrame(up=trained_up(arguments)),
    )
    files = (place.file, *files)
    return Model(
        buffers, domains_of(buffers, "face"), description, place.root, files, (*tensors.warnings, *warnings)
    )

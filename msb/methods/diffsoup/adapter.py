"""Read DiffSoup's ``final_params.pt``, written by its COLMAP script or its synthetic script.

Layout: kenji-tojo/diffsoup at c74e35d (examples/01_mip360.py, 02_synthetic.py). Each triangle has a
barycentric lattice. Each sample of the lattice has seven features and an opacity. The file stores features
and opacities after the sigmoid. A small MLP turns the features of a pixel and its view direction into a
colour.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.adapters.locate import Place, in_bundle
from msb.adapters.model import Content, Model, Options, Settings
from msb.adapters.tensors import Tensors
from msb.asset import Description
from msb.asset.manifest import CoordinateFrame
from msb.errors import finding
from msb.methods.diffsoup import FEATURES, LAYERS, MAX_LEVEL, METHOD, samples

KEYS = ("Rmax", "V", "F", "feat_acc", "alpha_acc", "color_mlp")
# The shape of each array in the state dict of the colour MLP. Weight matrices have the shape [out, in].
DECODER: dict[str, tuple[int, ...]] = {}
for _layer, _shape in LAYERS.items():
    DECODER |= {f"{_layer}.weight": _shape, f"{_layer}.bias": _shape[:1]}
# Near and far plane of the official evaluation in scene units, for each layout.
_PLANES = {"colmap": (0.5, 100.0), "synthetic": (0.1, 10.0)}
_BACKGROUNDS = {"colmap": "#000000", "synthetic": "#ffffff"}


def recognises(content: Content) -> bool:
    """Return whether `content` is a dictionary with lattice features, or the web export."""
    if content.place.kind == "bundle":
        return in_bundle(content.place.file, METHOD.bundle)
    value = content.value
    return isinstance(value, dict) and bool({"feat_acc", "alpha_acc", "color_mlp"} & value.keys())


def read(place: Place, content: Content, options: Options) -> Model:
    """Return the model at `place`. Only the COLMAP layout has the key `flip_z`."""
    if place.kind == "bundle":
        from msb.methods.diffsoup import adapter_web

        return adapter_web.read(place, content, options)
    values = content.mapping(place.file)
    tensors = Tensors(values, place.file, options.check_values)
    level = tensors.integer("Rmax", 0, MAX_LEVEL)
    positions = tensors.floats("V", "Nv", 3)
    buffers: dict[str, Any] = {
        "positions": positions,
        "indices": tensors.indices("F", len(positions), "T", 3),
        "features.lattice": tensors.floats("feat_acc", "T", samples(level), FEATURES),
        "features.opacity": tensors.floats("alpha_acc", "T", samples(level), 1)[:, :, 0],
    }
    mlp = tensors.value("color_mlp")
    if not isinstance(mlp, dict):
        raise tensors.error("CHECKPOINT_LAYOUT", "color_mlp is not a state dict", "color_mlp")
    weights = Tensors(mlp, place.file, options.check_values)
    buffers.update({f"decoder.{key}": weights.floats(key, *shape) for key, shape in DECODER.items()})
    warnings = [*tensors.warnings, *weights.warnings]
    for name, key in (("features.lattice", "feat_acc"), ("features.opacity", "alpha_acc")):
        low, high = float(buffers[name].min()), float(buffers[name].max())
        if low < 0 or high > 1:
            text = f"{key} has values from {low:g} to {high:g}; the official code saves values in [0, 1]"
            warnings.append(finding("CHECKPOINT_LAYOUT", text, severity="warning", pointer=key))
    layout = "colmap" if "flip_z" in tensors else "synthetic"
    settings = Settings("diffsoup", options.settings)
    settings.add("layout", layout, "checkpoint", place.file)
    description = describe(settings, level, direction(values.get("up")), "sigmoid")
    size = {name: values.get(name[0].upper()) for name in ("width", "height")}
    if all(type(side) is int and 0 < side < 1 << 31 for side in size.values()):
        description = replace(description, training=size)
    return Model(buffers, domains(buffers), description, place.root, (place.file,), tuple(warnings))


def domains(buffers: dict[str, NDArray[Any]]) -> dict[str, Any]:
    """Return the domain of each buffer of a DiffSoup model."""
    return {
        name: "global" if name.startswith("decoder.") else "face"
        for name in buffers
        if name not in ("positions", "indices")
    }


def describe(
    settings: Settings, level: int, up: Sequence[float] | None, encoding: Literal["sigmoid", "lut"]
) -> Description:
    """Return the description of a DiffSoup model for its manifest.

    The settings must contain `layout`. This function adds the near and far planes, which depend on the
    layout. With the encoding "sigmoid", features are numbers in [0, 1]. With the encoding "lut", features are
    bytes from the web export. A byte v represents v / 255.
    """
    layout = str(settings.finish()["layout"].value)
    near, far = _PLANES[layout]
    settings.add("z_near", near, "default")
    settings.add("z_far", far, "default")
    axis = _axis(up) if up is not None else {"colmap": "-y", "synthetic": "+z"}[layout]
    return Description(
        method="diffsoup",
        coverage={"kernel": "solid"},
        opacity={"encoding": "feature", "threshold": 0.5},
        appearance={
            "kind": "neural_decoder",
            "level": level,
            "feature_encoding": encoding,
            "blend_feature": 3,
            "background": _BACKGROUNDS[layout],
            **({f"up_{name}": value for name, value in zip("xyz", up, strict=True)} if up else {}),
        },
        compositing={"kind": "binary_z_buffer"},
        settings=settings.finish(),
        coordinate_frame=CoordinateFrame(up=axis),
    )


def direction(value: Any) -> list[float] | None:
    """Return three numbers from an array or a list, or None for any other `value`."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list | tuple) and len(value) == 3 and all(type(v) in (int, float) for v in value):
        return [float(item) for item in value]
    return None


def _axis(up: Sequence[float]) -> str:
    """Return the name of the axis to which `up` is parallel, or "unknown"."""
    for number, name in enumerate("xyz"):
        rest = [abs(value) for i, value in enumerate(up) if i != number]
        if max(rest) < 1e-6 * abs(up[number]):
            return ("+" if up[number] > 0 else "-") + name
    return "unknown"

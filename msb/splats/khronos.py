"""Gaussians of a glTF primitive with the extension KHR_gaussian_splatting.

Source: KhronosGroup/glTF, extensions/2.0/Khronos/KHR_gaussian_splatting/README.md (2026). Means and
rotations are in the glTF frame: x right, y up, z towards the viewer. Scales are logarithms.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import CheckpointError
from msb.splats.gaussians import Gaussians, to_logit, transform, turn_about_x

EXTENSION = "KHR_gaussian_splatting"
MEAN = "POSITION"
ROTATION, SCALE, OPACITY = (f"{EXTENSION}:{name}" for name in ("ROTATION", "SCALE", "OPACITY"))
# The required attributes of a primitive, and the type of each attribute.
REQUIRED = {MEAN: "VEC3", ROTATION: "VEC4", SCALE: "VEC3", OPACITY: "SCALAR"}


def coefficient(degree: int, number: int) -> str:
    """Return the attribute name of the SH coefficient `number` of a degree; `number` is 0 to 2 `degree`."""
    return f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{number}"


def read(attributes: Mapping[str, NDArray[Any]], world: NDArray[np.float64]) -> Gaussians:
    """Return the Gaussians of a primitive. `attributes` maps names to arrays (N, width). Integer arrays are
    normalised.

    `world` (4, 4) is the transform of the node: a rotation, a uniform scale and a translation.

    Raises
    ------
    CheckpointError
        CHECKPOINT_LAYOUT: an attribute is missing, or the transform is no similarity.
    """
    first = coefficient(0, 0)
    for name in (*REQUIRED, first):
        if name not in attributes:
            raise CheckpointError("CHECKPOINT_LAYOUT", f"the attribute {name} is missing", pointer=name)
    # Collect the SH coefficients of all complete degrees (N, K, 3).
    names: list[str] = []
    for degree in range(1, 4):
        more = [coefficient(degree, number) for number in range(2 * degree + 1)]
        if not all(name in attributes for name in more):
            break
        names += more
    rest = np.stack([attributes[name] for name in names], axis=1) if names else None
    gaussians = Gaussians(
        mean=attributes[MEAN].astype(np.float32),
        scale=attributes[SCALE].astype(np.float32),
        rotation=np.roll(attributes[ROTATION], 1, axis=1).astype(np.float32),
        opacity=to_logit(np.clip(attributes[OPACITY][:, 0].astype(np.float64), 0, 1)),
        f_dc=attributes[first].astype(np.float32),
        f_rest=None if rest is None else rest.astype(np.float32),
    )
    return turn_about_x(_place(gaussians, world))


def _place(gaussians: Gaussians, world: NDArray[np.float64]) -> Gaussians:
    """Return the Gaussians in world coordinates."""
    linear = world[:3, :3]
    if np.array_equal(world, np.eye(4)):
        return gaussians
    size = np.cbrt(np.linalg.det(linear))
    rotation = linear / size if size > 0 else linear
    if not size > 0 or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4:
        text = (
            "the node of the Gaussians is mirrored or scaled unevenly; apply its transform before exporting"
        )
        raise CheckpointError("CHECKPOINT_LAYOUT", text, pointer="/nodes")
    return transform(gaussians, rotation, float(size), world[:3, 3])

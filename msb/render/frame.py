"""The frame that a renderer returns for one camera."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import UsageError, shorten

# Parts that a frame may hold besides image, alpha, depth and visible. They may cost time.
EXTRAS = ("normal", "depth_median", "face_id", "raw")


def chosen_extras(outputs: str | Iterable[str]) -> frozenset[str]:
    """Return the extras that `outputs` names: some of `EXTRAS`, "all", or "auto", which is all, too."""
    names = EXTRAS if outputs in ("all", "auto") else tuple(outputs)
    for name in names:
        if name not in EXTRAS:
            text = f'there is no output "{shorten(str(name), 40)}"; there are {", ".join(EXTRAS)}, and "all"'
            raise UsageError("USAGE", text)
    return frozenset(names)


@dataclass(frozen=True, eq=False)
class Frame:
    """An image and what was computed with it; row 0 is the top. Parts that tier or method lack are None.

    Attributes
    ----------
    image : (H, W, 3) float32
        The image in the asset's stored colour space, background included; neither rounded nor clamped.
    alpha : (H, W) float32
        Coverage: 1 where something opaque was hit, 1 - transmittance where primitives are blended.
    depth : (H, W) float32
        Depth along the camera's z axis in scene units: that of the surface hit, or the expected depth (sum of
        weight times depth, divided by alpha); 0 where no face is seen.
    face_id : (H, W) int32, optional
        The number of the face seen, -1 where there is none.
    normal : (H, W, 3) float32, optional
        Normals as the method's official kernel gives them.
    depth_median : (H, W) float32, optional
        The depth at which the transmittance falls below one half; 0 where it does not.
    visible : (F,) bool, optional
        Whether each face survived the method's culling.
    raw : mapping of str to ndarray
        The official kernel's own buffers, by their official names.
    timings : mapping of str to float
        Stage -> milliseconds on the device.
    """

    image: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]
    face_id: NDArray[np.int32] | None = None
    normal: NDArray[np.float32] | None = None
    depth_median: NDArray[np.float32] | None = None
    visible: NDArray[np.bool_] | None = None
    raw: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    timings: Mapping[str, float] = field(default_factory=dict)


def interior(faces: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which pixels (H, W) have a 3 x 3 neighbourhood that shows one face; none at the border has."""
    inner = np.zeros(faces.shape, bool)
    middle = faces[1:-1, 1:-1]
    same = middle >= 0
    for dy in range(3):
        for dx in range(3):
            same = same & (faces[dy : dy + middle.shape[0], dx : dx + middle.shape[1]] == middle)
    inner[1:-1, 1:-1] = same
    return inner

"""The frame that a renderer returns for one camera."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import UsageError, shorten

# Optional parts of a frame, in addition to image, alpha, depth and visible. Optional parts may cost time.
EXTRAS = ("normal", "depth_median", "face_id", "raw")


def parse_outputs(outputs: str | Iterable[str]) -> frozenset[str]:
    """Return the optional parts that `outputs` requests.

    `outputs` has names from `EXTRAS`; "all" or "auto" requests all optional parts.
    """
    names = EXTRAS if outputs in ("all", "auto") else tuple(outputs)
    for name in names:
        if name not in EXTRAS:
            text = (
                f'output "{shorten(str(name), 40)}" does not exist; choose from {", ".join(EXTRAS)} or "all"'
            )
            raise UsageError("USAGE", text)
    return frozenset(names)


@dataclass(frozen=True, eq=False)
class Frame:
    """An image and the quantities computed with the image; row 0 is the top row.

    Parts that the tier or the method does not define are None.

    Attributes
    ----------
    image : (H, W, 3) float32
        The image over its background, in the colour space that the asset stores; neither rounded nor clamped.
    alpha : (H, W) float32
        Coverage: 1 at opaque surfaces; 1 - transmittance for blended primitives.
    depth : (H, W) float32
        Depth along the camera's z axis in scene units, 0 in pixels without a face. For opaque surfaces,
        this is the depth of the visible surface; for blended primitives, it is the expected depth (sum of
        weight times depth, divided by alpha).
    face_id : (H, W) int32, optional
        The index of the visible face; -1 in pixels without a face.
    normal : (H, W, 3) float32, optional
        Normals as defined by the method's official kernel.
    depth_median : (H, W) float32, optional
        The depth of the face that lowers the transmittance below one half. The depth is 0 if no face does
        this.
        visible : (F,) bool, optional Whether each face passed the method's culling.
    raw : mapping of str to ndarray
        Buffers of the official kernel, by their official names.
    timings : mapping of str to float
        Milliseconds on the device for each stage.
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
    """Return a mask (H, W) of pixels whose 3 x 3 neighbourhood shows a single face; False at the border."""
    inner = np.zeros(faces.shape, bool)
    middle = faces[1:-1, 1:-1]
    same = middle >= 0
    for dy in range(3):
        for dx in range(3):
            same = same & (faces[dy : dy + middle.shape[0], dx : dx + middle.shape[1]] == middle)
    inner[1:-1, 1:-1] = same
    return inner

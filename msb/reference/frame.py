"""The frame that a reference renderer returns."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class ReferenceFrame:
    """An image of H x W pixels and all other results of the official kernel, for F faces.

    Floating-point arrays have the requested dtype. Row 0 is the top of the image. Results that the method's
    official kernel does not define are None.

    Attributes
    ----------
    image : (H, W, 3)
        Colours over the background, in the stored colour space; neither rounded nor clamped.
    alpha : (H, W)
        1 - transmittance; for DiffSoup 1 in pixels with a face, else 0.
    depth : (H, W)
        Depth along the camera's z axis in scene units, 0 in empty pixels. The value is the expected depth
        (sum of weight times depth, divided by alpha), or for DiffSoup the depth of the visible face.
    depth_median : (H, W), optional
        Depth of the face that lowers the transmittance to one half; 0 in empty pixels. Triangle-Splatting
        uses the depth of the face's centroid, and MeshSplatting the depth interpolated at the sample.
    normal : (H, W, 3), optional
        Sum of weight times normal in camera space (x right, y down, z forward), not normalised.
    face_id : (H, W) int32, optional
        The face at the median (MeshSplatting), the visible face (DiffSoup); -1 in empty pixels.
    visible : (F,) bool
        Whether each face passes the culling of the preprocessing (official radius above 0). DiffSoup does not
        cull faces in preprocessing; its mask contains the faces that are visible in at least one pixel.
    contribution : (F,) float64, optional
        Sum of the weights (alpha times transmittance) of each face over all samples of the raster; for
        DiffSoup the number of pixels that show the face.
    raw : dict
        Buffers of the official kernel, in the kernel's resolution and row order; see docs/reference.md.
    timings : dict
        Milliseconds of each measured stage.
    """

    image: NDArray[np.floating[Any]]
    alpha: NDArray[np.floating[Any]]
    depth: NDArray[np.floating[Any]]
    depth_median: NDArray[np.floating[Any]] | None
    normal: NDArray[np.floating[Any]] | None
    face_id: NDArray[np.int32] | None
    visible: NDArray[np.bool_]
    contribution: NDArray[np.float64] | None = None
    raw: dict[str, Any] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)

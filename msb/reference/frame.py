"""What a reference renderer returns."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class ReferenceFrame:
    """One image and what else the official kernel knows of it, for H x W pixels and F faces.

    Floating-point arrays have the dtype that was asked for. Row 0 is the top of the image. What a method's
    official kernel does not define is None.

    Attributes
    ----------
    image : (H, W, 3)
        Colour with the background in it, in the stored colour space; neither rounded nor clamped.
    alpha : (H, W)
        1 - transmittance; for DiffSoup 1 where a face was hit, else 0.
    depth : (H, W)
        Along the camera's z axis, in scene units, 0 where nothing is: expected depth
        (sum of weight times depth, divided by alpha), for DiffSoup that of the face seen.
    depth_median : (H, W), optional
        Depth of the face at which transmittance falls to one half; 0 where nothing is. Triangle-Splatting
        takes its centroid's depth, MeshSplatting the depth interpolated at the sample.
    normal : (H, W, 3), optional
        Sum of weight times normal in camera space (x right, y down, z forward), not normalised.
    face_id : (H, W) int32, optional
        The face at the median (MeshSplatting), the face seen (DiffSoup); -1 where nothing is.
    visible : (F,) bool
        Faces that the preprocessing keeps: official radius above 0. DiffSoup has no such notion: faces that
        are seen in at least one pixel.
    contribution : (F,) float64, optional
        Of each face the sum of its weights, alpha times transmittance, over all samples of the raster; of
        DiffSoup the number of pixels that show it.
    raw : dict
        The official kernel's own buffers, at its resolution, in its row order; docs/reference.md lists them.
    timings : dict
        Stage -> milliseconds, where somebody measured them.
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

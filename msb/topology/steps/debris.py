"""Remove small pieces. A piece is a component with few faces, little area, or few covered pixels."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.components import label_components
from msb.topology.faces import face_areas, sum_areas
from msb.topology.halfedge import build_half_edges, face_of
from msb.topology.steps.change import Change, with_faces

# By default, a component with fewer faces than this is debris.
FEWEST_FACES = 10


def debris(
    points: NDArray[Any],
    faces: NDArray[Any],
    *,
    least_faces: int = FEWEST_FACES,
    least_share: float = 0.0,
    weights: NDArray[Any] | None = None,
) -> Change:
    """Remove components with fewer than `least_faces` faces, or less than `least_share` of the total weight.

    The argument `weights` (F,) must not be negative. The weights are, for example, the pixels that each face
    covers. The default weight is the area. Faces with a repeated index belong to no component and are kept.
    After the removal, the shares of the remaining components are larger. A second run therefore removes
    nothing. The step takes O(F log F) time.
    """
    mesh = build_half_edges(faces, len(points))
    pairs = zip(mesh.two_face_halfedges, mesh.chained_halfedges, strict=True)
    first, second = (face_of(np.concatenate(ends)) for ends in pairs)
    count, label = label_components(len(faces), first, second)
    small = np.bincount(label, minlength=count) < least_faces
    if least_share > 0:
        weight = face_areas(points, faces)[0] if weights is None else np.asarray(weights, np.float64)
        weight = sum_areas(np.where(mesh.repeated_index, 0, weight), label, count)
        small |= weight < least_share * weight.sum()
    keep = mesh.repeated_index | ~small[label]
    return with_faces(faces, keep, len(points))

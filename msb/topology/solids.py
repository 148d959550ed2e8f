"""Check whether the bodies of a closed mesh are wound inside out, touch each other, or cross each other."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.components import label_components
from msb.topology.crossings import find_crossing_pairs
from msb.topology.faces import signed_volumes
from msb.topology.weld import find_coincident_vertices

# Maximum number of faces for which the audit searches crossing faces by default. The search takes about 8 us
# per face on one core. Long, thin faces have more pairs to test, at 0.7 us per pair. The number of tested
# pairs is therefore limited as well.
MOST_FACES, MOST_PAIRS = 200_000, 1 << 23
# A body is flat if its volume, relative to the cubed diagonal of its bounding box, is below this limit. For a
# cube, this ratio is 0.19.
_FLAT = 1e-9


@dataclass(frozen=True)
class Bodies:
    """Faults of a closed, manifold and consistently wound mesh that the counts do not contain.

    Attributes
    ----------
    inside_out : int
        Number of bodies that are wound inside out. A cavity, which lies inside another body, is not
        counted.
    flat : int
        Number of bodies without a volume, such as a sheet with two sides.
    touching_vertices : int
        Number of vertices that coincide with a vertex of another body.
    crossing_faces : int or None
        Number of faces that cross another face. The value is None if the mesh has more than 200,000 faces, or
        too many pairs of overlapping bounding boxes.
    """

    inside_out: int
    flat: int
    touching_vertices: int
    crossing_faces: int | None


def check_bodies(points: NDArray[Any], faces: NDArray[Any], components: int) -> Bodies:
    """Return the state of the bodies of a closed mesh. The mesh has finite coordinates and the given number
    of components."""
    # `label` (F,) is the body of each face. A single component is a single body.
    label = np.zeros(len(faces), np.int64) if components == 1 else label_bodies(faces, len(points))
    touching = 0 if components == 1 else _count_touching(points, faces, label)
    inside_out, flat = find_inside_out(points, faces, label)
    crossing = None
    if len(faces) <= MOST_FACES:
        pairs = find_crossing_pairs(points[faces].astype(np.float64), most=MOST_PAIRS)
        crossing = None if pairs is None else len(np.unique(pairs))
    return Bodies(int(inside_out.sum()), int(flat.sum()), touching, crossing)


def _count_touching(points: NDArray[Any], faces: NDArray[Any], label: NDArray[Any]) -> int:
    """Return the number of vertices that coincide with a vertex of another body."""
    body = np.full(len(points), -1)
    body[faces.reshape(-1)] = np.repeat(label, 3)
    used = np.flatnonzero(body >= 0)
    rows, group = find_coincident_vertices(points[used])
    if not len(rows):
        return 0
    # Find the lowest and the highest body index at each position.
    of_row = body[used[rows]]
    lowest, highest = np.full(len(rows), len(faces)), np.full(len(rows), -1)
    np.minimum.at(lowest, group, of_row)
    np.maximum.at(highest, group, of_row)
    return int((lowest != highest)[group].sum())


def label_bodies(faces: NDArray[Any], vertex_count: int) -> NDArray[Any]:
    """Return the body (F,) of each face, numbered from 0. Faces that share a vertex belong to one body."""
    first, second = (faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1))
    _, of_vertex = label_components(vertex_count, first, second)
    return np.asarray(np.unique(of_vertex[faces[:, 0]], return_inverse=True)[1].reshape(-1))


def find_inside_out(
    points: NDArray[Any], faces: NDArray[Any], label: NDArray[Any]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return two masks (n,) of closed bodies: bodies that are wound inside out, and flat bodies.

    The argument `label` (F,) is the body of each face. A cavity is a body with negative volume inside the
    bounding box of a larger body with positive volume.
    """
    if not len(faces):
        return np.zeros(0, bool), np.zeros(0, bool)
    volume = np.bincount(label, signed_volumes(points, faces))
    # Compute the bounding boxes `low` and `high` (n, 3) of the bodies from their corners.
    order = slice(None) if len(volume) == 1 else np.argsort(label, kind="stable")
    corners = points[faces[order].reshape(-1)].astype(np.float64)
    starts = 3 * (np.cumsum(np.bincount(label)) - np.bincount(label))
    low, high = (pick.reduceat(corners, starts) for pick in (np.minimum, np.maximum))
    flat = np.abs(volume) <= _FLAT * np.linalg.norm(high - low, axis=1) ** 3
    inside_out = (volume < 0) & ~flat
    for body in np.flatnonzero(inside_out):
        around = (volume > -volume[body]) & (low <= low[body]).all(axis=1) & (high >= high[body]).all(axis=1)
        inside_out[body] = not around.any()
    return inside_out, flat

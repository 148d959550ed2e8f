"""The result of a repair step: the new faces and the origin of each vertex, face and corner."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.halfedge import NONE


@dataclass(frozen=True)
class Rims:
    """The rims of added vertices. An added vertex gets the average of the values in its rim.

    The old vertices around the added vertex i are ``vertices[offsets[i] : offsets[i + 1]]``.
    """

    offsets: NDArray[Any] = field(default_factory=lambda: np.zeros(1, np.int64))
    vertices: NDArray[Any] = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def count(self) -> int:
        """Number of added vertices."""
        return len(self.offsets) - 1


@dataclass(frozen=True)
class Change:
    """The result of a repair step.

    Attributes
    ----------
    faces : (F', 3) integers
        The new faces, which contain new vertex indices.
    vertex_map : (V',) integers
        The old vertex of each new vertex. The value is NONE for added vertices, which come last.
    face_map : (F',) integers
        The old face of each new face. The value is NONE for added faces, which come last.
    turned : (F',) bool
        Whether the second and third corner of the old face were swapped.
    rims : Rims
        The rims of the added vertices, in order.
    added_from : (n,) integers
        The old face whose values each added face copies.
    notes : tuple of str
        Sentences for the user about the step, without full stops.
    """

    faces: NDArray[Any]
    vertex_map: NDArray[Any]
    face_map: NDArray[Any]
    turned: NDArray[np.bool_]
    rims: Rims = field(default_factory=Rims)
    added_from: NDArray[Any] = field(default_factory=lambda: np.zeros(0, np.int64))
    notes: tuple[str, ...] = ()

    @property
    def corner_map(self) -> NDArray[Any]:
        """(3F',) the old corner of each new corner. The value is NONE for added faces."""
        corners = self.face_map[:, None] * 3 + np.arange(3)
        corners[self.turned, 1:] = corners[self.turned, :0:-1]
        corners[self.face_map == NONE] = NONE
        return corners.reshape(-1)


def unchanged(faces: NDArray[Any], vertex_count: int) -> Change:
    """Return a change that keeps the mesh as it is."""
    return with_vertices(faces, np.arange(vertex_count))


def with_vertices(faces: NDArray[Any], vertex_map: NDArray[Any], notes: tuple[str, ...] = ()) -> Change:
    """Return a change that keeps the faces and replaces the vertices according to `vertex_map`."""
    face_count = len(faces)
    return Change(faces, vertex_map, np.arange(face_count), np.zeros(face_count, bool), notes=notes)


def with_faces(
    faces: NDArray[Any],
    keep: NDArray[np.bool_],
    vertex_count: int,
    *,
    lost: NDArray[np.bool_] | None = None,
) -> Change:
    """Return a change that keeps the faces `keep` (F,), and removes vertices that no kept face uses.

    The mask `lost` (V,) marks unused vertices that the change removes as well.
    """
    if keep.all() and lost is None:
        return unchanged(faces, vertex_count)
    lost = np.zeros(vertex_count, bool) if lost is None else lost.copy()
    lost[faces[~keep]] = True
    lost[faces[keep]] = False
    number = np.cumsum(~lost, dtype=faces.dtype) - 1
    face_map = np.flatnonzero(keep)
    return Change(
        number[faces[keep]].astype(faces.dtype, copy=False),
        np.flatnonzero(~lost),
        face_map,
        np.zeros(len(face_map), bool),
    )


def followed_by(first: Change, second: Change) -> Change:
    """Return two successive changes as a single change.

    The maps of both changes must not contain NONE. Copies of vertices are allowed, but added vertices and
    faces are not.
    """
    return Change(
        second.faces,
        first.vertex_map[second.vertex_map],
        first.face_map[second.face_map],
        first.turned[second.face_map] ^ second.turned,
        notes=(*first.notes, *second.notes),
    )

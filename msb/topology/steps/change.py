"""The record of a repair step: the new faces, and where each vertex, face and corner comes from."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.halfedge import NONE


@dataclass(frozen=True)
class Rims:
    """The vertices around each new vertex: its values are their mean.

    New vertex i has the rim ``vertices[offsets[i] : offsets[i + 1]]`` of old ones.
    """

    offsets: NDArray[Any] = field(default_factory=lambda: np.zeros(1, np.int64))
    vertices: NDArray[Any] = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def count(self) -> int:
        """Number of new vertices."""
        return len(self.offsets) - 1


@dataclass(frozen=True)
class Change:
    """The result of a repair step.

    Attributes
    ----------
    faces : (F', 3) integers
        The new faces, by new vertex numbers.
    vertex_map : (V',) integers
        The old vertex of each new one; NONE where a vertex was added. Those come last.
    face_map : (F',) integers
        The old face of each new one; NONE where a face was added. Those come last.
    turned : (F',) bool
        Whether the second and the third corner of the old face changed places.
    rims : Rims
        The rims of the added vertices, in their order.
    added_from : (n,) integers
        The old face whose values each added face takes.
    notes : tuple of str
        What a person should know of the step, each a sentence without a full stop.
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
        """(3F',) the old corner of each new one; NONE in added faces."""
        corners = self.face_map[:, None] * 3 + np.arange(3)
        corners[self.turned, 1:] = corners[self.turned, :0:-1]
        corners[self.face_map == NONE] = NONE
        return corners.reshape(-1)


def unchanged(faces: NDArray[Any], vertex_count: int) -> Change:
    """Return the change that changes nothing."""
    return with_vertices(faces, np.arange(vertex_count))


def with_vertices(faces: NDArray[Any], vertex_map: NDArray[Any], notes: tuple[str, ...] = ()) -> Change:
    """Return the change that gives the same faces other vertices."""
    face_count = len(faces)
    return Change(faces, vertex_map, np.arange(face_count), np.zeros(face_count, bool), notes=notes)


def with_faces(faces: NDArray[Any], keep: NDArray[np.bool_], vertex_count: int) -> Change:
    """Return the change that keeps the faces `keep` (F,) and removes the vertices that only others used."""
    if keep.all():
        return unchanged(faces, vertex_count)
    lost = np.zeros(vertex_count, bool)
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
    """Return both changes, one after the other, as one; neither may have added anything."""
    return Change(
        second.faces,
        first.vertex_map[second.vertex_map],
        first.face_map[second.face_map],
        first.turned[second.face_map] ^ second.turned,
        notes=(*first.notes, *second.notes),
    )

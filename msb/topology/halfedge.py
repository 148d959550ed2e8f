"""Half-edge structure: 3F half-edges, grouped into edges by their undirected vertex pairs.

A classic half-edge mesh allows at most two faces per edge. A classic half-edge mesh would therefore change a
non-manifold mesh before the audit counts it. In this structure an edge is a *group* of any number of
half-edges. No face or vertex is merged, dropped, reoriented or repaired.

Half-edge ``h = 3 f + k`` belongs to face f and runs from corner k to corner k + 1 (mod 3) of that face. The
corner at the start of half-edge h has the index h. The definitions come from docs/definitions.md and the
paper, "Topology-Metric Definitions and Interpretation Limits".
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.faces import names_vertex_twice

# The index of a missing element.
NONE = -1


@dataclass(frozen=True)
class HalfEdgeMesh:
    """A triangle mesh as half-edges. Element indices are int32, or int64 from 2^31 vertices on.

    Attributes
    ----------
    vertex_count : int
    faces : (F, 3) integers
        The faces as given, including faces with a repeated index.
    edge_vertices : (E, 2) integers
        The distinct vertex pairs (low, high) of all faces without a repeated index, in ascending order.
    edge_offsets : (E + 1,) integers
        The half-edges of edge e are ``edge_halfedges[edge_offsets[e] : edge_offsets[e + 1]]``.
    edge_halfedges : (3 (F - F_repeated),) integers
        Half-edges grouped by edge. Within each group, the half-edges are in ascending order.
    """

    vertex_count: int
    faces: NDArray[Any]
    edge_vertices: NDArray[Any]
    edge_offsets: NDArray[Any]
    edge_halfedges: NDArray[Any]

    @property
    def face_count(self) -> int:
        """F, the number of all face rows."""
        return len(self.faces)

    @property
    def edge_count(self) -> int:
        """E, the number of edges."""
        return len(self.edge_vertices)

    @cached_property
    def repeated_index(self) -> NDArray[np.bool_]:
        """(F,) whether a face has a repeated index. A face with a repeated index has no edges and no fans."""
        return names_vertex_twice(self.faces)

    @cached_property
    def multiplicity(self) -> NDArray[Any]:
        """(E,) number of faces at each edge. Duplicate faces count each time."""
        return np.diff(self.edge_offsets)

    @property
    def origin(self) -> NDArray[Any]:
        """(3F,) start vertex of each half-edge."""
        return self.faces.reshape(-1)

    @property
    def target(self) -> NDArray[Any]:
        """(3F,) end vertex of each half-edge."""
        return self.faces[:, (1, 2, 0)].reshape(-1)

    @cached_property
    def edge(self) -> NDArray[Any]:
        """(3F,) edge of each half-edge. The value is NONE for faces with a repeated index."""
        edge = np.full(self.faces.size, NONE, self.faces.dtype)
        edge[self.edge_halfedges] = np.repeat(
            np.arange(self.edge_count, dtype=self.faces.dtype), self.multiplicity
        )
        return edge

    @property
    def two_face_halfedges(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """The two half-edges of every two-face edge, as two arrays (E2,) in the order of the edges."""
        start = self.edge_offsets[:-1][self.multiplicity == 2]
        return self.edge_halfedges[start], self.edge_halfedges[start + 1]

    @property
    def chained_halfedges(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """At each edge with three or more faces, return the pairs of consecutive half-edges.

        Joining these pairs joins all half-edges of the edge. For an edge with k half-edges, k - 1 pairs
        suffice.
        """
        crowded = np.repeat(self.multiplicity > 2, self.multiplicity)
        last = np.zeros(len(crowded), bool)
        last[self.edge_offsets[1:] - 1] = True
        position = np.flatnonzero(crowded & ~last)
        return self.edge_halfedges[position], self.edge_halfedges[position + 1]

    def halfedges_of(self, edge: int) -> NDArray[Any]:
        """Return the half-edges of an edge."""
        return self.edge_halfedges[self.edge_offsets[edge] : self.edge_offsets[edge + 1]]


def face_of(halfedge: NDArray[Any]) -> NDArray[Any]:
    """Return the face of each half-edge or corner."""
    return halfedge // 3


def next_in_face(halfedge: NDArray[Any]) -> NDArray[Any]:
    """Return the next half-edge around the face of each half-edge."""
    return np.where(halfedge % 3 == 2, halfedge - 2, halfedge + 1)


def build_half_edges(faces: NDArray[Any], vertex_count: int) -> HalfEdgeMesh:
    """Return the half-edge structure of `faces` (F, 3), which `mesh_arrays` has checked.

    The function sorts 3F 64-bit keys in O(F log F) time, with about 60 bytes of working memory per face.
    """
    dtype = faces.dtype
    # Half-edges of the faces without a repeated index, and their vertex pairs (low, high).
    valid = np.flatnonzero(~names_vertex_twice(faces))
    rows = faces[valid]
    origin, target = rows.reshape(-1), rows[:, (1, 2, 0)].reshape(-1)
    low, high = np.minimum(origin, target), np.maximum(origin, target)
    # One 64-bit key for each vertex pair. Half-edges with equal keys belong to one edge.
    key, order = _sort_keys(low.astype(np.uint64) * np.uint64(max(vertex_count, 1)) + high.astype(np.uint64))
    is_first = np.ones(len(key), bool)
    np.not_equal(key[1:], key[:-1], out=is_first[1:])
    first = np.flatnonzero(is_first)
    # Number the edges, and find the first half-edge of each edge in sorted order.
    halfedges = (valid.astype(dtype)[:, None] * 3 + np.arange(3, dtype=dtype)).reshape(-1)
    leader = order[first]
    return HalfEdgeMesh(
        vertex_count=vertex_count,
        faces=faces,
        edge_vertices=np.stack([low[leader], high[leader]], axis=1),
        edge_offsets=np.append(first, len(key)).astype(dtype),
        edge_halfedges=halfedges[order],
    )


def _sort_keys(key: NDArray[np.uint64]) -> tuple[NDArray[np.uint64], NDArray[Any]]:
    """Return the keys in ascending order, and the original position of each key. Equal keys keep their order.

    For up to about two million faces, a key and its position can be packed into 64 bits. The function then
    sorts these packed numbers. Sorting packed numbers is six times as fast as sorting positions by key.
    """
    bits = np.uint64(len(key).bit_length())
    if int(key.max(initial=0)) >> (64 - int(bits)):
        order = np.argsort(key, kind="stable")
        return key[order], order
    packed = (key << bits) | np.arange(len(key), dtype=np.uint64)
    packed.sort()
    order = (packed & ((np.uint64(1) << bits) - np.uint64(1))).astype(np.intp)
    return packed >> bits, order

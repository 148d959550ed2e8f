"""Fans around vertices, boundary loops, and the readings of "non-manifold vertex".

A *fan* is a set of corners at one vertex joined by walking across ordinary (two-face) edges. A vertex is
manifold exactly when it has one fan: the link, cut at its nodes of degree three and more, is then a single
path or cycle. The proof is in docs/definitions.md; the identity *strict = several fans = multifan or endpoint
of a non-manifold edge* is held by tests.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.topology.components import label_components
from msb.topology.halfedge import NONE, HalfEdgeMesh, next_in_face


@dataclass(frozen=True)
class Fans:
    """The fans of a mesh.

    Attributes
    ----------
    corner_fan : (3F,) integers
        Fan of each corner (corner 3 f + k is vertex k of face f); NONE in repeated-index rows.
    fan_vertex : (n,) integers
        The vertex each fan is around.
    fans_per_vertex : (V,) integers
        0 for a vertex no proper face uses, 1 for a manifold vertex.
    groups_per_vertex : (V,) integers
        The same when corners are joined across every shared edge, non-manifold ones too.
    """

    corner_fan: NDArray[Any]
    fan_vertex: NDArray[Any]
    fans_per_vertex: NDArray[Any]
    groups_per_vertex: NDArray[Any]


def corners_at_ends(mesh: HalfEdgeMesh, halfedges: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return, for each half-edge, the corners of its face at the edge's low and at its high vertex."""
    after = next_in_face(halfedges)
    origin = mesh.origin
    upwards = origin[halfedges] < origin[after]
    return np.where(upwards, halfedges, after), np.where(upwards, after, halfedges)


def group_corners(mesh: HalfEdgeMesh, one: NDArray[Any], other: NDArray[Any]) -> tuple[int, NDArray[Any]]:
    """Join corners at a vertex by walking across the given pairs of half-edges, each pair at one edge.

    Return how many groups there are and the group (3F,) of each corner, numbered by their first corner; NONE
    in repeated-index rows.
    """
    corners = np.flatnonzero(~np.repeat(mesh.repeated_index, 3))
    # Compact numbers for the corners of proper faces, so that no label is spent on the others.
    compact = np.full(mesh.faces.size, NONE, mesh.faces.dtype)
    compact[corners] = np.arange(len(corners), dtype=mesh.faces.dtype)
    count, labels = _join(mesh, compact, one, other, len(corners))
    corner_group = np.full(mesh.faces.size, NONE, mesh.faces.dtype)
    corner_group[corners] = labels
    return count, corner_group


def find_fans(mesh: HalfEdgeMesh) -> Fans:
    """Return the fans of `mesh`. O(F) time and memory."""
    count, corner_fan = group_corners(mesh, *mesh.two_face_halfedges)
    corners = np.flatnonzero(corner_fan != NONE)
    labels = corner_fan[corners]
    fan_vertex = np.zeros(count, mesh.faces.dtype)
    fan_vertex[labels] = mesh.origin[corners]
    groups, group_of_fan = _join(mesh, corner_fan, *mesh.chained_halfedges, count)
    group_vertex = np.zeros(groups, mesh.faces.dtype)
    group_vertex[group_of_fan] = fan_vertex
    return Fans(
        corner_fan=corner_fan,
        fan_vertex=fan_vertex,
        fans_per_vertex=np.bincount(fan_vertex, minlength=mesh.vertex_count),
        groups_per_vertex=np.bincount(group_vertex, minlength=mesh.vertex_count),
    )


def _join(
    mesh: HalfEdgeMesh, node_of_corner: NDArray[Any], one: NDArray[Any], other: NDArray[Any], count: int
) -> tuple[int, NDArray[np.int32]]:
    """Join the nodes at both ends of each pair of half-edges that share an edge."""
    one_low, one_high = corners_at_ends(mesh, one)
    other_low, other_high = corners_at_ends(mesh, other)
    first = node_of_corner[np.concatenate([one_low, one_high])]
    second = node_of_corner[np.concatenate([other_low, other_high])]
    return label_components(count, first, second)


@dataclass(frozen=True)
class Boundary:
    """Boundary edges (B,), ascending, and the `chain` (B,) that each is in.

    Two are linked where one boundary fan has both of them as its sides. A chain that is `closed` is a loop (a
    hole's rim, or the outline of an open sheet); others end where the fan's other side is a non-manifold
    edge.
    """

    edges: NDArray[Any]
    chain: NDArray[Any]
    closed: NDArray[np.bool_]

    @property
    def loops(self) -> int:
        """Number of closed boundary loops."""
        return int(np.count_nonzero(self.closed))

    @property
    def open_chains(self) -> int:
        """Number of chains that end at non-manifold edges."""
        return len(self.closed) - self.loops


def find_boundary(mesh: HalfEdgeMesh, fans: Fans) -> Boundary:
    """Return the boundary loops and chains of `mesh`.

    An open fan is a path with two sides. Where both are boundary edges, these follow each other along the
    boundary; so every boundary edge has at most one follower at each end, and the groups they form are cycles
    (as many links as edges) or paths. At a vertex with several fans the loops touch but stay apart.
    """
    edges = np.flatnonzero(mesh.multiplicity == 1)
    halfedge = mesh.edge_halfedges[mesh.edge_offsets[edges]]
    fan = np.concatenate([fans.corner_fan[halfedge], fans.corner_fan[next_in_face(halfedge)]])
    side = np.tile(np.arange(len(edges)), 2)
    order = np.argsort(fan, kind="stable")
    meets = np.flatnonzero(fan[order][1:] == fan[order][:-1])
    first, second = side[order][meets], side[order][meets + 1]
    count, chain = label_components(len(edges), first, second)
    links = np.bincount(chain[first], minlength=count)
    return Boundary(edges, chain, links == np.bincount(chain, minlength=count))

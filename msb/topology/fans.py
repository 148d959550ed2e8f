"""Fans around vertices, boundary loops, and the definitions of a non-manifold vertex.

A *fan* is a set of corners at one vertex that are connected across two-face edges. A vertex is manifold
exactly if it has one fan. Tests check the identity *strict = several fans = multifan or endpoint of a
non-manifold edge*. The proof is in docs/definitions.md.
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
        The fan of each corner. Corner 3 f + k means vertex k of face f. The value is NONE for faces with a
        repeated index.
    fan_vertex : (n,) integers
        The vertex of each fan.
    fans_per_vertex : (V,) integers
        Number of fans: 0 for a vertex without proper faces, 1 for a manifold vertex.
    groups_per_vertex : (V,) integers
        Number of groups of corners if the corners are joined across every shared edge, including non-manifold
        edges.
    """

    corner_fan: NDArray[Any]
    fan_vertex: NDArray[Any]
    fans_per_vertex: NDArray[Any]
    groups_per_vertex: NDArray[Any]


def find_end_corners(mesh: HalfEdgeMesh, halfedges: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """For each half-edge, return two corners of its face. The first corner is at the low vertex of the edge,
    and the second corner is at the high vertex.
    """
    after = next_in_face(halfedges)
    origin = mesh.origin
    upwards = origin[halfedges] < origin[after]
    return np.where(upwards, halfedges, after), np.where(upwards, after, halfedges)


def group_corners(mesh: HalfEdgeMesh, first: NDArray[Any], second: NDArray[Any]) -> tuple[int, NDArray[Any]]:
    """At each vertex, join the corners across the given pairs of half-edges.

    The two half-edges of a pair lie on the same edge. Return the number of groups and the group (3F,) of each
    corner. Groups are numbered by their first corner. The group is NONE for corners of faces with a repeated
    index.
    """
    corners = np.flatnonzero(~np.repeat(mesh.repeated_index, 3))
    # Number only the corners of faces without a repeated index.
    compact = np.full(mesh.faces.size, NONE, mesh.faces.dtype)
    compact[corners] = np.arange(len(corners), dtype=mesh.faces.dtype)
    count, labels = _join(mesh, compact, first, second, len(corners))
    corner_group = np.full(mesh.faces.size, NONE, mesh.faces.dtype)
    corner_group[corners] = labels
    return count, corner_group


def find_fans(mesh: HalfEdgeMesh) -> Fans:
    """Return the fans of `mesh`. The function takes O(F) time and memory."""
    count, corner_fan = group_corners(mesh, *mesh.two_face_halfedges)
    corners = np.flatnonzero(corner_fan != NONE)
    labels = corner_fan[corners]
    fan_vertex = np.zeros(count, mesh.faces.dtype)
    fan_vertex[labels] = mesh.origin[corners]
    # Join the fans across edges with three or more faces. The multifan count uses the resulting groups.
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
    mesh: HalfEdgeMesh, node_of_corner: NDArray[Any], first: NDArray[Any], second: NDArray[Any], count: int
) -> tuple[int, NDArray[np.int32]]:
    """Each pair of half-edges shares an edge. Join the nodes at both ends of the edge.

    Return group indices in the form of `label_components`.
    """
    first_low, first_high = find_end_corners(mesh, first)
    second_low, second_high = find_end_corners(mesh, second)
    corners_a = node_of_corner[np.concatenate([first_low, first_high])]
    corners_b = node_of_corner[np.concatenate([second_low, second_high])]
    return label_components(count, corners_a, corners_b)


@dataclass(frozen=True)
class Boundary:
    """The boundary edges `edges` (B,) in ascending order. `chain` (B,) is the index of the chain that
    contains each edge.

    Two boundary edges are linked if they are the two outer edges of one open fan. A `closed` chain is a
    boundary loop: the rim of a hole, or the outline of an open sheet. Any other chain ends at a fan whose
    other outer edge is non-manifold.
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

    An open fan has two outer edges. If both outer edges are boundary edges, the two edges are neighbours
    along the boundary. Every boundary edge has at most one neighbour at each end. Connected edges therefore
    form paths or cycles. A chain is a cycle if it has as many links as edges. At a vertex with several fans,
    loops touch but stay separate.
    """
    edges = np.flatnonzero(mesh.multiplicity == 1)
    halfedge = mesh.edge_halfedges[mesh.edge_offsets[edges]]
    # Find the fans of both ends of each boundary half-edge. Link two boundary edges if their ends lie in the
    # same fan.
    fan = np.concatenate([fans.corner_fan[halfedge], fans.corner_fan[next_in_face(halfedge)]])
    side = np.tile(np.arange(len(edges)), 2)
    order = np.argsort(fan, kind="stable")
    meets = np.flatnonzero(fan[order][1:] == fan[order][:-1])
    first, second = side[order][meets], side[order][meets + 1]
    count, chain = label_components(len(edges), first, second)
    links = np.bincount(chain[first], minlength=count)
    return Boundary(edges, chain, links == np.bincount(chain, minlength=count))

"""The differences between two versions of a mesh."""

from collections import Counter
from itertools import combinations
from typing import Any

import numpy as np

from data_stubs.splat_like import splat_like
from msb.topology.arrays import mesh_arrays
from msb.topology.difference import find_difference
from msb.topology.halfedge import build_half_edges
from msb.topology.steps import pair
from msb.topology.steps.cut import cut_edges
from tests.conftest import TETRAHEDRON


def test_cut_edges_are_found_from_positions_alone() -> None:
    points, faces = mesh_arrays(*splat_like(14))
    change = pair(points, faces)
    assert len(change.vertex_map) > len(points)
    order = np.random.default_rng(0).permutation(len(change.faces))  # face numbers give no hint
    after = points[change.vertex_map], change.faces[order][:, (2, 0, 1)]
    difference = find_difference((points, faces), after)
    edges = build_half_edges(faces, len(points)).edge_vertices[difference.cut]
    assert np.array_equal(edges, cut_edges(change.faces, change.vertex_map))
    assert len(difference.deleted) == len(difference.added) == 0


def counted(mesh: Any) -> tuple[Counter[Any], Counter[Any]]:
    """Return the numbers of faces and of edges with the same corner positions."""
    points, faces = mesh
    place = {v: tuple(float(x) for x in np.float32(row)) for v, row in enumerate(points.tolist())}
    rows = [tuple(row) for row in faces.tolist()]
    edges = {tuple(sorted(pair)) for row in rows if len(set(row)) == 3 for pair in combinations(row, 2)}
    return (
        Counter(tuple(sorted(place[v] for v in row)) for row in rows),
        Counter(tuple(sorted(place[v] for v in edge)) for edge in edges),
    )


def test_difference_equals_counting_positions() -> None:
    for seed in range(60):
        rng = np.random.default_rng(seed)
        points = rng.integers(0, 2, (7, 3)).astype(np.float64)  # many coincident vertices
        old, new = (mesh_arrays(points, rng.integers(0, 7, (rng.integers(0, 9), 3))) for _ in range(2))
        difference = find_difference(old, new)
        (faces, edges), (faces_after, edges_after) = counted(old), counted(new)
        assert len(difference.deleted) == (faces - faces_after).total(), seed
        assert len(difference.added) == (faces_after - faces).total(), seed
        assert len(difference.cut) == sum(edges_after[edge] > count for edge, count in edges.items()), seed


def test_second_of_two_equal_faces_counts_as_deleted() -> None:
    points, faces = mesh_arrays(*TETRAHEDRON)
    twice = np.concatenate([faces, faces[:1]])
    assert find_difference((points, twice), (points, faces)).deleted.tolist() == [4]

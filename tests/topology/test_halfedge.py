"""The half-edge structure: numbering, groups of any size, and the identities between its parts."""

from __future__ import annotations

import numpy as np
import pytest

from data_stubs.splat_like import splat_like
from msb.topology.halfedge import NONE, HalfEdgeMesh, build_half_edges, face_of, next_in_face
from tests.conftest import BOOK
from tests.topology.meshes import CASES, Case, random_mesh

VALID = [c for c in CASES if c.valid]


def build(faces: np.ndarray, vertex_count: int) -> HalfEdgeMesh:
    return build_half_edges(np.ascontiguousarray(faces, np.int32), vertex_count)


def assert_consistent(mesh: HalfEdgeMesh) -> None:
    """Assert what must hold between the arrays of any half-edge mesh."""
    h = np.arange(3 * mesh.face_count)
    proper = ~np.repeat(mesh.repeated_index, 3)
    np.testing.assert_array_equal(next_in_face(next_in_face(next_in_face(h))), h)
    np.testing.assert_array_equal(face_of(next_in_face(h)), face_of(h))
    np.testing.assert_array_equal(mesh.origin[next_in_face(h)], mesh.target)
    # Every half-edge of a proper face is in exactly one group, and no other is.
    np.testing.assert_array_equal(np.sort(mesh.edge_halfedges), h[proper])
    assert mesh.edge_offsets[0] == 0
    assert mesh.edge_offsets[-1] == len(mesh.edge_halfedges)
    assert (mesh.multiplicity > 0).all()
    # Groups are ordered by (low, high), all members run between these two, members ascend.
    low, high = mesh.edge_vertices.T
    assert (low < high).all()
    assert (np.diff(low.astype(np.int64) * mesh.vertex_count + high) > 0).all()
    ends = np.sort(np.stack([mesh.origin, mesh.target], axis=1)[mesh.edge_halfedges], axis=1)
    np.testing.assert_array_equal(ends, np.repeat(mesh.edge_vertices, mesh.multiplicity, axis=0))
    for edge in range(mesh.edge_count):
        group = mesh.halfedges_of(edge)
        assert (np.diff(group) > 0).all()
        assert (mesh.edge[group] == edge).all()
    assert (mesh.edge[~proper] == NONE).all()
    # Edges of two faces, by both of their half-edges.
    one, other = mesh.two_face_halfedges
    np.testing.assert_array_equal(mesh.edge[one], np.flatnonzero(mesh.multiplicity == 2))
    np.testing.assert_array_equal(mesh.edge[other], mesh.edge[one])
    assert (one != other).all()
    # Chains run through every group of three and more, from its first member to its last.
    one, other = mesh.chained_halfedges
    np.testing.assert_array_equal(mesh.edge[one], mesh.edge[other])
    crowded = mesh.multiplicity[mesh.multiplicity > 2]
    assert len(one) == (crowded - 1).sum()


@pytest.mark.parametrize("case", VALID, ids=lambda c: c.name)
def test_structure_of_case_is_consistent(case: Case) -> None:
    assert_consistent(build(case.faces, len(case.vertices)))


def test_structure_of_random_meshes_is_consistent() -> None:
    random = np.random.default_rng(7)
    for _ in range(300):
        points, faces = random_mesh(random)
        assert_consistent(build(faces, len(points)))


def test_halfedges_of_a_triangle_run_around_it() -> None:
    mesh = build(np.array([[5, 2, 9]]), 10)
    assert mesh.origin.tolist() == [5, 2, 9]
    assert mesh.target.tolist() == [2, 9, 5]
    assert mesh.edge_vertices.tolist() == [[2, 5], [2, 9], [5, 9]]
    assert mesh.edge.tolist() == [0, 1, 2]


def test_spine_of_a_book_is_one_group_of_three() -> None:
    mesh = build(BOOK[1], 5)
    assert mesh.multiplicity.tolist() == [3, 1, 1, 1, 1, 1, 1]
    assert mesh.halfedges_of(0).tolist() == [0, 3, 6]


def test_repeated_index_rows_have_no_edges() -> None:
    mesh = build(np.array([[0, 1, 2], [1, 2, 2], [3, 3, 3]]), 4)
    assert mesh.repeated_index.tolist() == [False, True, True]
    assert mesh.multiplicity.tolist() == [1, 1, 1]
    assert mesh.edge[3:].tolist() == [NONE] * 6


def test_no_faces_give_an_empty_structure() -> None:
    mesh = build(np.zeros((0, 3)), 0)
    assert (mesh.edge_count, mesh.face_count) == (0, 0)
    assert mesh.edge_offsets.tolist() == [0]
    assert_consistent(mesh)


def test_vertex_numbers_up_to_the_limit_stay_apart() -> None:
    top = 2**32 - 2
    faces = np.array([[0, top, top - 1], [1, top, top - 1], [0, 1, top]], np.int64)
    mesh = build_half_edges(faces, top + 1)
    assert mesh.edge_vertices.tolist() == [
        [0, 1], [0, top - 1], [0, top], [1, top - 1], [1, top], [top - 1, top],
    ]  # fmt: skip
    assert mesh.multiplicity.tolist() == [1, 1, 2, 1, 2, 2]
    assert mesh.edge_vertices.dtype == np.int64


def test_structure_of_a_splat_like_mesh_is_consistent() -> None:
    points, faces = splat_like(16)
    assert_consistent(build(faces, len(points)))

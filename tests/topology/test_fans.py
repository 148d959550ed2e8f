"""Fans around vertices, and the identity between the readings of a non-manifold vertex."""

from __future__ import annotations

import numpy as np
import pytest

from data_stubs.splat_like import splat_like
from msb.topology.analysis import Analysis
from msb.topology.fans import corners_at_ends
from msb.topology.halfedge import NONE
from tests.topology.meshes import CASE, CASES, Case, random_mesh


def analysed(case: Case) -> Analysis:
    return Analysis(case.vertices, case.faces.astype(np.int32))


def assert_identity(analysis: Analysis) -> None:
    """Assert: several fans = multifan or endpoint of a non-manifold edge."""
    strict = set(analysis.nonmanifold_vertices.tolist())
    multifan = set(analysis.multifan_vertices.tolist())
    endpoints = set(analysis.nonmanifold_edge_endpoints.tolist())
    assert strict == multifan | endpoints
    assert (analysis.fans.groups_per_vertex <= analysis.fans.fans_per_vertex).all()
    np.testing.assert_array_equal(analysis.fans.groups_per_vertex > 0, analysis.fans.fans_per_vertex > 0)


def test_several_fans_means_multifan_or_edge_endpoint() -> None:
    random = np.random.default_rng(11)
    for points, faces in [(c.vertices, c.faces) for c in CASES if c.valid] + [
        random_mesh(random) for _ in range(300)
    ]:
        assert_identity(Analysis(points, faces.astype(np.int32)))


def test_several_fans_means_multifan_or_edge_endpoint_on_a_splat_like_mesh() -> None:
    analysis = Analysis(*splat_like(20))
    assert len(analysis.nonmanifold_vertices) > 1000
    assert_identity(analysis)


def test_every_corner_of_a_proper_face_is_in_one_fan_around_its_vertex() -> None:
    random = np.random.default_rng(12)
    for _ in range(200):
        points, faces = random_mesh(random)
        analysis = Analysis(points, faces.astype(np.int32))
        fan = analysis.fans.corner_fan
        proper = np.repeat(~analysis.mesh.repeated_index, 3)
        assert (fan[~proper] == NONE).all()
        np.testing.assert_array_equal(analysis.fans.fan_vertex[fan[proper]], analysis.mesh.origin[proper])
        np.testing.assert_array_equal(np.unique(fan[proper]), np.arange(len(analysis.fans.fan_vertex)))


@pytest.mark.parametrize(
    ("name", "vertex", "fans", "groups"),
    [
        ("single_triangle", 0, 1, 1),
        ("closed_fan_100", 0, 1, 1),
        ("two_triangles_sharing_vertex", 0, 2, 2),
        ("three_fans_one_vertex", 0, 3, 3),
        ("three_page_book", 0, 3, 1),
        ("book_40_pages", 0, 40, 1),
        ("book_with_detached_triangle_at_spine", 0, 4, 2),
        ("book_with_detached_triangle_at_spine", 1, 3, 1),
        ("tetrahedra_sharing_vertex", 0, 2, 2),
        ("cone_over_theta", 0, 3, 1),
        # Cutting the figure eight at its crossing leaves two loops, each a fan.
        ("cone_over_figure_eight", 0, 2, 1),
        ("unreferenced_vertex", 3, 0, 0),
        ("duplicate_face_flipped", 0, 1, 1),
        ("triplicate_face", 0, 3, 1),
    ],
)
def test_number_of_fans_at_a_vertex(name: str, vertex: int, fans: int, groups: int) -> None:
    found = analysed(CASE[name]).fans
    assert found.fans_per_vertex[vertex] == fans
    assert found.groups_per_vertex[vertex] == groups


def test_corners_at_ends_are_the_low_and_the_high_vertex() -> None:
    mesh = analysed(CASE["projective_plane_6"]).mesh
    low, high = corners_at_ends(mesh, mesh.edge_halfedges)
    edges = np.repeat(mesh.edge_vertices, mesh.multiplicity, axis=0)
    np.testing.assert_array_equal(mesh.origin[low], edges[:, 0])
    np.testing.assert_array_equal(mesh.origin[high], edges[:, 1])

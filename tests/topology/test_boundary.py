"""Boundary loops: against construction and libigl; test_properties.py walks them in plain Python."""

from __future__ import annotations

import numpy as np
import pytest

from data_stubs.splat_like import splat_like
from msb import audit
from msb.topology.analysis import Analysis
from tests.topology.meshes import CASE, Mesh, sheet


def torn_sheets() -> list[Mesh]:
    """Return manifold sheets with holes that do not touch each other."""
    random = np.random.default_rng(3)
    found = []
    for _ in range(12):
        spots = [(r, c) for r in range(1, 12, 2) for c in range(1, 12, 2)]
        chosen = random.permutation(len(spots))[: random.integers(0, 20)]
        found.append(sheet(13, tuple(spots[i] for i in chosen)))
    return found


def test_sheet_has_one_loop_and_one_more_for_each_hole() -> None:
    counts = audit(*sheet(7, holes=((1, 1), (3, 4), (5, 1)))).counts
    assert (counts.boundary_loops, counts.open_boundary_chains) == (4, 0)
    assert counts.boundary_edges == 28 + 3 * 4


def test_loops_that_touch_in_a_vertex_stay_apart() -> None:
    counts = audit(*sheet(4, holes=((1, 1), (2, 2)))).counts
    assert counts.nonmanifold_vertices == counts.multifan_vertices == 1
    assert (counts.boundary_loops, counts.open_boundary_chains) == (2, 0)


@pytest.mark.parametrize(
    ("name", "loops", "chains"),
    [
        ("closed_tetrahedron", 0, 0),
        ("single_triangle", 1, 0),
        ("moebius_5", 1, 0),
        ("two_triangles_sharing_vertex", 2, 0),
        ("inconsistent_winding", 1, 0),
        ("three_page_book", 0, 3),
        ("book_40_pages", 0, 40),
        ("repeated_index_beside_triangle", 1, 0),
        ("repeated_index_only", 0, 0),
        ("empty", 0, 0),
        ("cone_over_theta", 0, 3),
    ],
)
def test_loops_and_chains_of_case(name: str, loops: int, chains: int) -> None:
    counts = audit(CASE[name].vertices, CASE[name].faces).counts
    assert (counts.boundary_loops, counts.open_boundary_chains) == (loops, chains)


def test_chains_partition_the_boundary_edges() -> None:
    analysis = Analysis(*splat_like(20))
    boundary = analysis.boundary
    assert boundary.loops > 0
    assert boundary.open_chains > 0
    assert len(boundary.closed) == boundary.loops + boundary.open_chains
    np.testing.assert_array_equal(np.unique(boundary.chain), np.arange(len(boundary.closed)))
    np.testing.assert_array_equal(boundary.edges, np.flatnonzero(analysis.mesh.multiplicity == 1))
    # A loop visits every vertex of its edges an even number of times.
    edges = analysis.mesh.edge_vertices[boundary.edges]
    rim = edges[boundary.closed[boundary.chain]]
    assert (np.bincount(rim.reshape(-1)) % 2 == 0).all()


@pytest.mark.oracle
def test_loops_of_manifold_sheets_agree_with_libigl() -> None:
    igl = pytest.importorskip("igl", reason="extra crosscheck is not installed")
    for points, faces in torn_sheets():
        counts = audit(points, faces).counts
        assert counts.nonmanifold_vertices == 0
        assert counts.boundary_loops == len(igl.boundary_loop_all(faces))

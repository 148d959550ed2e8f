"""Half-edges, areas, loops and synthetic meshes: details that comparisons with brute_force.py miss."""

import numpy as np
import pytest

from data_stubs.splat_like import Shape, splat_like
from msb import audit
from msb.topology.faces import face_areas, find_duplicate_faces
from msb.topology.halfedge import NONE, HalfEdgeMesh, build_half_edges, face_of, next_in_face
from tests.topology.meshes import CASES, random_mesh, sheet


def build(faces: np.ndarray, vertex_count: int) -> HalfEdgeMesh:
    return build_half_edges(np.ascontiguousarray(faces, np.int32), vertex_count)


def assert_consistent(mesh: HalfEdgeMesh) -> None:
    """Assert the relations between the arrays of any half-edge mesh."""
    h = np.arange(3 * mesh.face_count)
    proper = ~np.repeat(mesh.repeated_index, 3)
    np.testing.assert_array_equal(next_in_face(next_in_face(next_in_face(h))), h)
    np.testing.assert_array_equal(face_of(next_in_face(h)), face_of(h))
    np.testing.assert_array_equal(mesh.origin[next_in_face(h)], mesh.target)
    # Every half-edge of a proper face is in exactly one group. Other half-edges are in no group.
    np.testing.assert_array_equal(np.sort(mesh.edge_halfedges), h[proper])
    assert mesh.edge_offsets[0] == 0
    assert mesh.edge_offsets[-1] == len(mesh.edge_halfedges)
    assert (mesh.multiplicity > 0).all()
    # Groups are sorted by (low, high). Their members are ascending and run between these two vertices.
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
    # Both half-edges of the two-face edges.
    first, second = mesh.two_face_halfedges
    np.testing.assert_array_equal(mesh.edge[first], np.flatnonzero(mesh.multiplicity == 2))
    np.testing.assert_array_equal(mesh.edge[second], mesh.edge[first])
    assert (first != second).all()
    # Chains link all members of every group of three or more, from first to last.
    first, second = mesh.chained_halfedges
    np.testing.assert_array_equal(mesh.edge[first], mesh.edge[second])
    crowded = mesh.multiplicity[mesh.multiplicity > 2]
    assert len(first) == (crowded - 1).sum()


def test_structures_are_consistent() -> None:
    random = np.random.default_rng(7)
    meshes = [(case.vertices, case.faces) for case in CASES if case.valid] + [splat_like(16)]
    for points, faces in [*meshes, *(random_mesh(random) for _ in range(300))]:
        assert_consistent(build(faces, len(points)))


def test_vertex_numbers_up_to_the_limit_are_distinct() -> None:
    top = 2**32 - 2
    faces = np.array([[0, top, top - 1], [1, top, top - 1], [0, 1, top]], np.int64)
    mesh = build_half_edges(faces, top + 1)
    assert mesh.edge_vertices.tolist() == [
        [0, 1], [0, top - 1], [0, top], [1, top - 1], [1, top], [top - 1, top],
    ]  # fmt: skip
    assert mesh.multiplicity.tolist() == [1, 1, 2, 1, 2, 2]
    assert mesh.edge_vertices.dtype == np.int64


RIGHT = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0], [6, 0, 0]])


def test_areas_do_not_depend_on_the_batch_size(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    random = np.random.default_rng(0)
    points, faces = random.random((50, 3)), random.integers(0, 50, (1000, 3))
    whole, _ = face_areas(points, faces)
    monkeypatch.setattr("msb.topology.faces._CHUNK", 7)
    pieces, _ = face_areas(points, faces)
    np.testing.assert_array_equal(whole, pieces)


def test_double_precision_matters_far_from_the_origin() -> None:
    points = (RIGHT + 1e6).astype(np.float32)  # integers below 2^24 are exact in float32
    area, _ = face_areas(points, np.array([[0, 1, 2]]))
    assert area.tolist() == [6.0]


def test_duplicates_are_found_despite_integer_overflow() -> None:
    top = 2**31 - 1  # the sum of a row overflows
    faces = np.array([[top, top - 1, top - 2], [top - 2, top, top - 1], [top, top - 1, top - 3]], np.int32)
    assert find_duplicate_faces(faces).tolist() == [False, True, False]


def test_sheet_has_one_loop_plus_one_per_hole() -> None:
    counts = audit(*sheet(7, holes=((1, 1), (3, 4), (5, 1)))).counts
    assert (counts.boundary_loops, counts.open_boundary_chains) == (4, 0)
    assert counts.boundary_edges == 28 + 3 * 4


def test_loops_that_touch_in_a_vertex_stay_separate() -> None:
    counts = audit(*sheet(4, holes=((1, 1), (2, 2)))).counts
    assert counts.nonmanifold_vertices == counts.multifan_vertices == 1
    assert (counts.boundary_loops, counts.open_boundary_chains) == (2, 0)


@pytest.mark.oracle
def test_loops_of_manifold_sheets_agree_with_libigl() -> None:
    igl = pytest.importorskip("igl", reason="extra crosscheck is not installed")
    random = np.random.default_rng(3)
    spots = [(r, c) for r in range(1, 12, 2) for c in range(1, 12, 2)]
    for _ in range(12):  # holes that do not touch
        chosen = random.permutation(len(spots))[: random.integers(0, 20)]
        points, faces = sheet(13, tuple(spots[i] for i in chosen))
        counts = audit(points, faces).counts
        assert counts.nonmanifold_vertices == 0
        assert counts.boundary_loops == len(igl.boundary_loop_all(faces))


def test_splat_like_default_has_the_intended_structure() -> None:
    report = audit(*splat_like(36))
    c, m = report.counts, report.metrics
    assert c.repeated_index_faces == c.duplicate_faces == c.zero_area_faces == 0
    # F varies by about 1 % between seeds, and the ratios by 0.005.
    assert c.faces == pytest.approx(35_231, rel=0.02)
    assert c.components == pytest.approx(5_767, rel=0.04)
    expected = {
        "vf_ratio": 0.513,
        "boundary_edge_ratio": 0.470,
        "nonmanifold_edge_ratio": 0.179,
        "nonmanifold_vertex_ratio": 0.734,
        "lcc_face_ratio": 0.726,
    }
    for key, value in expected.items():
        assert getattr(m, key) == pytest.approx(value, abs=0.015), key
    assert m.mean_valence == pytest.approx(6.46, abs=0.06)
    assert c.multifan_vertices / c.vertices == pytest.approx(0.511, abs=0.02)


def test_splat_like_without_noise_is_a_closed_sphere() -> None:
    report = audit(*splat_like(20, shape=Shape(noise=0.0, drop=0.0, stray=0.0)))
    c = report.counts
    assert (c.boundary_edges, c.components, report.metrics.euler_characteristic) == (0, 1, 2)
    assert c.nonmanifold_vertices == 0

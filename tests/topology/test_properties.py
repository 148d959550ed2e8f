"""Properties of the audit for every mesh, tested on meshes from Hypothesis."""

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from data_stubs.splat_like import splat_like
from msb import audit
from tests.topology import brute_force
from tests.topology.meshes import random_mesh

Mesh = tuple[np.ndarray, np.ndarray]
QUICK = settings(max_examples=30, derandomize=True)


@st.composite
def meshes(draw: st.DrawFn, *, finite: bool = False) -> Mesh:
    """Draw up to 9 vertices with integer coordinates (or NaN) and up to 14 faces."""
    count = draw(st.integers(1, 9))
    index = st.integers(0, count - 1)
    faces = draw(st.lists(st.tuples(index, index, index), max_size=14))
    number = st.integers(-3, 3).map(float)
    if not finite and draw(st.booleans()):
        number = st.one_of(number, st.just(np.nan))
    points = draw(st.lists(st.tuples(number, number, number), min_size=count, max_size=count))
    return np.array(points, float), np.array(faces, np.int64).reshape(-1, 3)


seeds = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def numbers(mesh: Mesh) -> dict[str, Any]:
    """Return every field of an audit.

    Areas are rounded, because the order of a sum may change their last digits.
    """
    report = audit(*mesh)
    fields = {**asdict(report.counts), **asdict(report.metrics)}
    rounded = {k: float(f"{x:.9g}") if isinstance(x, float) else x for k, x in fields.items()}
    return {**rounded, "valence": report.valence_histogram, "soup": report.is_soup, "kind": report.topology}


@QUICK
@given(meshes(), seeds)
def test_renumbering_vertices_changes_nothing(mesh: Mesh, random: np.random.Generator) -> None:
    points, faces = mesh
    order = random.permutation(len(points))
    assert numbers((points[order], np.argsort(order)[faces])) == numbers(mesh)


@QUICK
@given(meshes(), seeds)
def test_reordering_and_rotating_faces_changes_nothing(mesh: Mesh, random: np.random.Generator) -> None:
    points, faces = mesh
    turn = random.integers(0, 3, (len(faces), 1))
    rotated = np.take_along_axis(faces, (np.arange(3) + turn) % 3, axis=1)
    assert numbers((points, rotated[random.permutation(len(faces))])) == numbers(mesh)


@QUICK
@given(meshes(), seeds)
def test_reversing_faces_changes_only_winding(mesh: Mesh, random: np.random.Generator) -> None:
    points, faces = mesh
    some = faces.copy()
    turned = random.random(len(faces)) < 0.5
    some[turned] = some[turned, ::-1]
    plain, reversed_ = numbers(mesh), numbers((points, some))
    every = numbers((points, faces[:, ::-1]))
    assert every == plain
    del plain["inconsistent_winding_edges"], reversed_["inconsistent_winding_edges"]
    assert reversed_ == plain


@QUICK
@given(meshes())
def test_splitting_all_vertices_gives_a_soup(mesh: Mesh) -> None:
    points, faces = mesh
    proper = [row for row in faces.tolist() if len(set(row)) == 3]
    f = len(proper)
    if f == 0:
        return
    soup = audit(points[np.array(proper).reshape(-1)], np.arange(3 * f).reshape(-1, 3))
    c, m = soup.counts, soup.metrics
    assert soup.is_soup
    assert c.edges == c.boundary_edges == 3 * f
    assert (c.components, c.boundary_loops, c.nonmanifold_vertices) == (f, f, 0)
    assert (m.vf_ratio, m.mean_valence, m.boundary_edge_ratio, m.lcc_face_ratio) == (3, 2, 1, 1 / f)


MAXIMA = {"largest_component_faces", "max_edge_faces"}


@QUICK
@given(meshes(), meshes())
def test_disjoint_union_adds_counts_and_keeps_maxima(first: Mesh, second: Mesh) -> None:
    union = audit(
        np.concatenate([first[0], second[0]]), np.concatenate([first[1], second[1] + len(first[0])])
    )
    a, b = asdict(audit(*first).counts), asdict(audit(*second).counts)
    expected = {k: max(a[k], b[k]) if k in MAXIMA else a[k] + b[k] for k in a}
    assert asdict(union.counts) == expected


@QUICK
@given(meshes())
def test_unreferenced_vertex_changes_only_vertex_counts(mesh: Mesh) -> None:
    points, faces = mesh
    before, after = numbers(mesh), numbers((np.concatenate([points, [[7, 7, 7]]]), faces))
    changed = {k for k in before if before[k] != after[k]}
    assert changed <= {
        "vertices", "unreferenced_vertices", "euler_characteristic", "vf_ratio", "mean_valence",
        "nonmanifold_vertex_ratio", "valence", "soup",
    }  # fmt: skip
    assert after["unreferenced_vertices"] == before["unreferenced_vertices"] + 1


@QUICK
@given(meshes())
def test_identities_hold(mesh: Mesh) -> None:
    assert_identities(mesh)


def assert_identities(mesh: Mesh) -> None:
    """Assert the identities that follow from the definitions."""
    report = audit(*mesh)
    c, m = report.counts, report.metrics
    crowded = 3 * (c.faces - c.repeated_index_faces) - c.boundary_edges - 2 * c.manifold_edges
    assert crowded >= 3 * c.nonmanifold_edges
    assert (crowded == 0) == (c.nonmanifold_edges == 0)
    assert c.boundary_edges + c.manifold_edges + c.nonmanifold_edges == c.edges
    assert max(c.multifan_vertices, c.nonmanifold_edge_endpoints) <= c.nonmanifold_vertices
    assert c.nonmanifold_vertices <= c.multifan_vertices + c.nonmanifold_edge_endpoints
    assert c.nonmanifold_vertices <= c.referenced_vertices
    assert c.components <= c.components_manifold_edges <= c.faces - c.repeated_index_faces
    assert c.referenced_vertices + c.unreferenced_vertices == c.vertices
    if m.vf_ratio is not None and m.mean_valence is not None:
        assert m.vf_ratio * m.mean_valence == pytest.approx(2 * c.edges / c.faces)
    if m.nonmanifold_edge_ratio and m.boundary_edge_ratio is not None and not c.repeated_index_faces:
        r1, nm = m.boundary_edge_ratio, m.nonmanifold_edge_ratio
        assert (3 * c.faces / c.edges - r1 - 2 * (1 - r1 - nm)) / nm >= 3 - 1e-9


def test_identities_hold_on_a_splat_like_mesh() -> None:
    assert_identities(splat_like(24))


def test_audit_agrees_with_the_brute_force_twin_on_random_meshes() -> None:
    count = 200
    random = np.random.default_rng(2024)
    seen = dict.fromkeys(
        ["nonmanifold_edges", "multifan_vertices", "repeated_index_faces", "nonfinite_faces"], 0
    )
    for _ in range(count):
        points, faces = random_mesh(random)
        expected = brute_force.assert_agrees(audit(points, faces), points, faces)
        for key in seen:
            seen[key] += expected[key] > 0
    # the random meshes contain each kind of fault often enough
    assert min(seen.values()) > 0.07 * count, seen


@pytest.mark.slow
def test_audit_agrees_with_the_brute_force_twin_on_a_splat_like_mesh() -> None:
    points, faces = splat_like(12)
    brute_force.assert_agrees(audit(points, faces), points, faces)

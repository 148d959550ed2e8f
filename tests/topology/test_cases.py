"""Golden meshes: hand-made and real meshes with all expected fields."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

import msb
from msb import audit
from msb.errors import MeshError
from msb.meshes import read_mesh
from tests.conftest import SHARED
from tests.topology import brute_force
from tests.topology.meshes import CASES, GOLDEN, Case, assert_as_expected

SYNTHETIC = json.loads((GOLDEN / "expected_synthetic.json").read_text())["meshes"]


@pytest.mark.parametrize("case", [c for c in CASES if c.valid], ids=lambda c: c.name)
def test_case_has_the_counts_derived_by_hand(case: Case) -> None:
    report = audit(case.vertices, case.faces)
    assert_as_expected(report, case.expected)
    # this also compares loops, valences and the kind of mesh
    brute_force.assert_agrees(report, case.vertices, case.faces)


@pytest.mark.parametrize("case", [c for c in CASES if not c.valid], ids=lambda c: c.name)
def test_case_with_a_bad_index_names_the_first_face(case: Case) -> None:
    with pytest.raises(MeshError, match="INDEX_OUT_OF_RANGE") as caught:
        audit(case.vertices, case.faces)
    assert caught.value.pointer == "faces[0]"


@pytest.mark.parametrize("mesh", SYNTHETIC, ids=lambda m: m["file"])
def test_synthetic_splat_mesh_has_its_expected_counts(mesh: dict) -> None:
    path = GOLDEN / mesh["file"]
    assert hashlib.sha256(path.read_bytes()).hexdigest() == mesh["sha256"]
    read = read_mesh(path)
    assert_as_expected(msb.audit(read.vertices, read.faces), mesh["variants"]["raw"]["expected"])


FOLDER = SHARED / "golden" / "meshes"
MESHES = json.loads((FOLDER / "expected.json").read_text())["meshes"] if FOLDER.is_dir() else []


@pytest.mark.slow
@pytest.mark.parametrize("mesh", MESHES, ids=lambda m: m["file"])
def test_file_has_its_expected_counts(mesh: dict) -> None:
    path = FOLDER / mesh["file"]
    assert hashlib.sha256(path.read_bytes()).hexdigest() == mesh["sha256"]
    read = read_mesh(path)
    report = audit(read.vertices, read.faces, weld="exact")
    variants = {name: v["expected"] for name, v in mesh["variants"].items()}
    assert set(variants) <= {"raw", "welded_exact"}
    assert_as_expected(report, variants["raw"])
    if "welded_exact" in variants:
        assert_as_expected(report.welded, variants["welded_exact"])
    else:  # there are no expected counts, but welding must keep the faces
        assert report.welded.counts.faces == report.counts.faces


def test_garden_vase_is_mostly_loose_triangles(shared: Path) -> None:
    read = read_mesh(shared / "golden" / "garden" / "vase_mesh.ply")
    report = audit(read.vertices, read.faces, weld="exact")
    c, m = report.counts, report.metrics
    assert (c.vertices, c.faces) == (7136, 2859)
    assert c.boundary_edges + c.manifold_edges + c.nonmanifold_edges == c.edges
    assert c.nonmanifold_vertices <= c.multifan_vertices + c.nonmanifold_edge_endpoints
    assert c.components <= c.components_manifold_edges <= c.faces - c.repeated_index_faces
    np.testing.assert_allclose(m.vf_ratio * m.mean_valence, 2 * c.edges / c.faces)
    np.testing.assert_allclose(m.vf_ratio, 2.496, atol=1e-3)

"""The hand-made golden meshes: every expected field of every one."""

from __future__ import annotations

import hashlib
import json

import pytest

import msb
from msb import audit
from msb.errors import MeshError
from msb.meshes import read_mesh
from tests.topology.meshes import CASES, GOLDEN, Case, assert_as_expected

SYNTHETIC = json.loads((GOLDEN / "expected_synthetic.json").read_text())["meshes"]


@pytest.mark.parametrize("case", [c for c in CASES if c.valid], ids=lambda c: c.name)
def test_case_has_the_counts_derived_by_hand(case: Case) -> None:
    assert_as_expected(audit(case.vertices, case.faces), case.expected)


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

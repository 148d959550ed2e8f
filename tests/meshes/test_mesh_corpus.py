"""The shared meshes, against the counts and areas written down for them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.meshes import Mesh, read_mesh

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"
EXPECTED = GOLDEN / "meshes" / "expected.json"


def expectations() -> list[Any]:
    """Return name and raw counts of each mesh, or one skipped test where they are not there."""
    if not EXPECTED.exists():
        return [pytest.param("", {}, marks=pytest.mark.skip(reason=f"{EXPECTED} is not there"))]
    entries = json.loads(EXPECTED.read_text("utf-8"))["meshes"]
    return [
        pytest.param(each["file"], each["variants"]["raw"]["expected"], id=each["file"]) for each in entries
    ]


def areas(mesh: Mesh) -> np.ndarray:
    """Return the area of each face in double precision: (F,)."""
    a, b, c = (mesh.vertices.astype(np.float64)[mesh.faces[:, corner]] for corner in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


@pytest.mark.parametrize(("name", "expected"), expectations())
def test_corpus(name: str, expected: dict[str, Any]) -> None:
    mesh = read_mesh(EXPECTED.parent / name)
    assert mesh.vertices.shape == (expected["V"], 3)
    assert mesh.faces.shape == (expected["F"], 3)
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < expected["V"]
    assert len(np.unique(mesh.faces)) == expected["V_referenced"]
    a, b, c = mesh.faces.T
    assert np.count_nonzero((a == b) | (b == c) | (a == c)) == expected["F_repeated_index"]
    assert np.count_nonzero(areas(mesh) == 0) == expected["F_zero_area"]
    # Reading float32 where float64 is meant, or the other way round, changes the sum by 2e-9 or more.
    assert areas(mesh).sum() == pytest.approx(expected["total_area"], rel=1e-12)
    edges = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert len(np.unique(edges[edges[:, 0] != edges[:, 1]], axis=0)) == expected["E"]


@pytest.mark.parametrize(
    ("path", "vertices", "faces", "vertex_colors", "face_colors"),
    [
        ("garden/vase_mesh.ply", 7136, 2859, (7136, 4), None),
        ("triangle_splatting/torus_sh0_white/create_off.off", 1179, 2136, None, (2136, 4)),
        ("two_dts/ring_solid/checkpoint/glb/60000.glb", 11118, 7412, (11118, 4), None),
        ("two_dts/ring_solid/checkpoint/mesh_ply/60000_mesh.ply", 11118, 7412, None, (7412, 4)),
        ("meshes/reference.ply", 845, 1610, (845, 4), None),
    ],
)
def test_exports_of_the_methods(
    path: str, vertices: int, faces: int, vertex_colors: tuple[int, int], face_colors: tuple[int, int]
) -> None:
    if not (GOLDEN / path).exists():
        pytest.skip(f"{GOLDEN / path} is not there")
    mesh = read_mesh(GOLDEN / path)
    assert (len(mesh.vertices), len(mesh.faces)) == (vertices, faces)
    for colors, shape in ((mesh.vertex_colors, vertex_colors), (mesh.face_colors, face_colors)):
        assert (colors is None) == (shape is None)
        if colors is not None:
            assert colors.shape == shape
            assert colors.dtype == np.uint8


def test_the_same_mesh_as_glb_and_ply() -> None:
    folder = GOLDEN / "two_dts" / "ring_solid" / "checkpoint"
    if not folder.exists():
        pytest.skip(f"{folder} is not there")
    first = read_mesh(folder / "glb" / "60000.glb")
    second = read_mesh(folder / "mesh_ply" / "60000_mesh.ply")
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.faces, second.faces)

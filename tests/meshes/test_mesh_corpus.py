"""Meshes that the methods' own exporters wrote; tests/topology counts what the other shared meshes hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from msb.meshes import read_mesh

GOLDEN = Path(__file__).parents[3] / "shared" / "golden"


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

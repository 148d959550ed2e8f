"""Seams of UVs and colours are not faults.

A mesh that is open only at other duplicates closes when merged.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb import audit
from msb.api.gates import parse_gate
from msb.asset import Description, build_asset
from msb.asset.texture import Sampler
from msb.topology import audit_arrays, seams
from tests.conftest import BOOK, TETRAHEDRON
from tests.topology.seamed import CUBE, CUBE_UVS, TEXTURE, doubled, torus

POINTS, FACES = TETRAHEDRON
# A tetrahedron whose first face has separate vertices, as for hard normals. It is open along three edges.
HARD = np.concatenate([POINTS, POINTS[FACES[0]]]), np.concatenate([[[4, 5, 6]], FACES[1:]])
# A tetrahedron with a slit: one vertex is stored twice.
SLIT = np.concatenate([POINTS, POINTS[FACES[0, :1]]]), np.concatenate([[[4, *FACES[0, 1:]]], FACES[1:]])


@pytest.mark.parametrize("weld", [None, "exact", 1e-9])
@pytest.mark.parametrize("mesh", [HARD, SLIT])
def test_duplicated_vertices_are_distinguished_from_holes(
    mesh: tuple[np.ndarray, np.ndarray], weld: float | None
) -> None:
    result = audit(*mesh, weld=weld)
    assert result.closed_once_merged
    assert result.verdict in ("limited", "bad")
    assert not audit(mesh[0], mesh[1][:-1], weld=weld).closed_once_merged  # with a hole beside the seam
    moved = mesh[0] + np.where(np.arange(len(mesh[0])) < 4, 0, 1e-3)[:, None]
    assert not audit(moved, mesh[1]).closed_once_merged


@pytest.mark.parametrize(
    "mesh",
    [
        TETRAHEDRON,
        (POINTS, FACES[:3]),
        BOOK,
        # duplicate faces after welding
        (np.tile(POINTS, (2, 1)), np.concatenate([FACES, FACES[:, ::-1] + 4])[:-1]),
        (np.full((6, 3), np.nan), np.arange(6).reshape(2, 3)),
    ],
)
def test_meshes_that_a_weld_does_not_close(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    for weld in (None, "exact"):
        assert not audit(*mesh, weld=weld).closed_once_merged


def test_larger_meshes_are_welded_only_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seams, "MOST_FACES", 3)
    assert not audit(*HARD).closed_once_merged
    assert audit(*HARD, weld="exact").closed_once_merged


def test_verdict_ignores_seams_while_counts_are_as_stored() -> None:
    points, faces, uvs = doubled(*CUBE, CUBE_UVS)
    plain, result = audit(*CUBE), audit_arrays(points, faces, attributes={"uv": uvs})[0]
    assert result.sentence.startswith(plain.sentence)
    assert (result.verdict, result.counts.seam_vertices, plain.counts.seam_vertices) == ("ok", 16, 0)
    assert replace(result.counts, seam_vertices=0) == audit(points, faces).counts
    assert result.without_seams is not None
    assert result.without_seams.counts == plain.counts
    # One corner of the hole is an unreferenced row, so nothing is torn there.
    hole = audit_arrays(points, faces[:-1], attributes={"uv": uvs})[0]
    assert hole.verdict == "limited"
    assert (hole.without_seams.counts.boundary_edges, hole.counts.seam_vertices) == (3, 15)


@pytest.mark.parametrize("name", ["uv", "color"])
@pytest.mark.parametrize("kinds", [2, 3, 1000])  # 1000: all corners differ, as in a soup
def test_corner_attributes_of_a_closed_mesh_leave_it_closed(name: str, kinds: int) -> None:
    rng = np.random.default_rng(kinds)
    points, faces = torus()
    values = rng.integers(0, kinds, (faces.size, 2)).astype(np.float32)
    stored, rows, values = doubled(points, faces, values)
    result = audit_arrays(stored, rows, attributes={name: values})[0]
    assert result.without_seams is not None
    assert result.without_seams.counts == audit(points, faces).counts
    assert result.counts.seam_vertices == len(stored) - len(points)
    assert result.seams == {"uv": "texture", "color": "color"}[name]


def test_seams_merge_only_vertices_in_one_place() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        points = rng.random((12, 3)).astype(np.float32)
        faces = np.stack(
            [rng.permutation(12)[:3] for _ in range(20)]
        )  # with holes, and edges with many faces
        stored, rows, uvs = doubled(points, faces, rng.integers(0, 2, (60, 2)).astype(np.float32))
        merged = seams.find_seams(stored, rows, {"uv": uvs})
        if merged is not None:
            assert np.array_equal(stored[merged.first][merged.number], stored)
            assert np.array_equal(stored[merged.first][merged.merged(rows)], stored[rows])


def test_duplicates_with_equal_uvs_and_colours_are_not_seams() -> None:
    uvs = np.concatenate([POINTS, POINTS[FACES[0]]])[:, :2].astype(np.float32)  # equal at equal positions
    result = audit_arrays(*HARD, attributes={"uv": uvs})[0]
    assert (result.seams, result.verdict) == (None, audit(*HARD).verdict)
    assert result.closed_once_merged


def test_duplicates_with_different_corner_uvs_are_seams() -> None:
    points, faces, uvs = doubled(*CUBE, CUBE_UVS)  # like an OBJ written by an engine
    by_corner = {"corner_uv": uvs[faces.reshape(-1)]}
    result = audit_arrays(points, faces, attributes=by_corner)[0]
    assert (result.verdict, result.counts.seam_vertices) == ("ok", 16)
    assert audit_arrays(*CUBE, attributes={"corner_uv": CUBE_UVS})[0].seams is None


def test_more_than_two_edges_in_one_place_are_not_a_seam() -> None:
    points, faces, uvs = doubled(BOOK[0], BOOK[1], np.arange(18).reshape(9, 2).astype(np.float32))
    assert audit_arrays(points, faces, attributes={"uv": uvs})[0].seams is None


def test_faces_with_different_textures_have_a_seam() -> None:
    faces, uvs = HARD[1], np.zeros((7, 2), np.float32)
    textures_of = (np.arange(4) == 0).astype(np.uint32)
    result = audit_arrays(HARD[0], faces, attributes={"uv": uvs, "face_texture": textures_of})[0]
    assert (result.verdict, result.counts.seam_vertices) == ("ok", 3)


def test_soup_with_a_few_coincident_corners_has_no_seams() -> None:
    rng = np.random.default_rng(2)
    points = rng.random((300, 3)).astype(np.float32)
    points[3:5] = points[:2]  # two independent triangles share an edge by chance
    faces, colors = np.arange(300).reshape(-1, 3), rng.random((300, 3)).astype(np.float32)
    result = audit_arrays(points, faces, attributes={"color": colors})[0]
    assert (result.seams, result.counts.seam_vertices) == (None, 0)
    assert "triangle soup" in result.sentence
    stored, rows, uvs = doubled(*torus(), rng.random((2 * 96 * 3, 2)).astype(np.float32))
    assert audit_arrays(stored, rows, attributes={"uv": uvs})[0].seams == "texture"
    stored[rows[0]] += 1  # a separate face
    result = audit_arrays(stored, rows, attributes={"uv": uvs})[0]
    assert (result.seams, result.verdict) == ("texture", "limited")
    alike = (stored * 10).astype(np.float32)[:, :2]  # equal UVs, which need no duplicates
    assert audit_arrays(stored, rows, attributes={"uv": alike})[0].seams is None


@pytest.mark.parametrize("kinds", [1, 3, 1000])
@pytest.mark.parametrize("domain", ["vertex", "face", "corner"])
@pytest.mark.parametrize("textures", [0, 1, 3])
def test_glb_of_a_closed_asset_is_closed(tmp_path: Path, domain: str, kinds: int, textures: int) -> None:
    rng = np.random.default_rng(kinds)
    points, faces = torus()
    buffers: dict[str, np.ndarray] = {"positions": points, "indices": faces.astype(np.uint32)}
    domains: dict[str, Any] = {"color": domain}
    rows = {"vertex": len(points), "face": len(faces), "corner": faces.size}[domain]
    buffers["color"] = rng.integers(0, kinds, (rows, 3)).astype(np.float32) / kinds
    description = Description()
    if textures:
        description = Description(appearance=Sampler().appearance)
        buffers["uv"] = rng.integers(0, kinds, (faces.size, 2)).astype(np.float32)
        images = {f"texture.{number}": TEXTURE[:, number : number + 8] for number in range(textures)}
        buffers, domains = buffers | images, domains | dict.fromkeys(images, "global") | {"uv": "corner"}
    if textures > 1:
        buffers["face_texture"] = rng.integers(0, textures, len(faces)).astype(np.uint32)
        domains["face_texture"] = "face"
    asset = build_asset(buffers, domains, description)
    msb.save(asset, tmp_path / "a.glb")
    assert asset.audit().verdict == audit(tmp_path / "a.glb").verdict == "ok"
    assert msb.open(tmp_path / "a.glb").audit().verdict == "ok"


def test_profile_checks_the_mesh_without_seams() -> None:
    points, faces, uvs = doubled(*CUBE, CUBE_UVS)
    result = audit_arrays(points, faces, attributes={"uv": uvs})[0]
    gate = parse_gate("boundary_edges>0")
    assert gate.check(result, Path("x")) is not None
    assert replace(gate, profile="print").check(result, Path("x")) is None


def test_normals_explain_duplicates_and_two_sides_of_a_sheet_stay_apart() -> None:
    keys = np.array([0, 0, 0, 0, 1, 1, 1], np.uint32)
    result = audit_arrays(*HARD, attributes={"seam_key": keys})[0]
    assert (result.seams, result.verdict, result.counts.seam_vertices) == ("normal", "ok", 3)
    by_corner = audit_arrays(*HARD, attributes={"corner_seam_key": keys[HARD[1]].reshape(-1)})[0]
    assert (by_corner.seams, by_corner.verdict) == ("normal", "ok")
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    sheet = np.array([[0, 1, 2], [0, 2, 3], [6, 5, 4], [7, 6, 4]])
    sides = {"seam_key": np.repeat([0, 1], 4).astype(np.uint32)}
    assert audit_arrays(np.tile(square, (2, 1)), sheet, attributes=sides)[0].seams is None


@pytest.mark.parametrize("name", ["a.obj", "a.ply", "a.off", "a.stl"])
def test_formats_with_normals_or_without_shared_vertices(tmp_path: Path, name: str) -> None:
    points, faces = CUBE
    corners = points[faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rows = np.concatenate([corners.reshape(-1, 3), np.repeat(normals, 3, axis=0)], axis=1)
    rows, number = np.unique(rows, axis=0, return_inverse=True)  # 24 rows
    triangles = number.reshape(-1, 3)
    path = tmp_path / name
    numbers = [" ".join(f"{value:g}" for value in row) for row in rows]
    if name == "a.obj":
        lines = [f"v {' '.join(text.split()[:3])}\nvn {' '.join(text.split()[3:])}" for text in numbers]
        lines += ["f " + " ".join(f"{i + 1}//{i + 1}" for i in row) for row in triangles]
    elif name == "a.ply":
        lines = ["ply", "format ascii 1.0", "element vertex 24"]
        lines += [f"property float {axis}" for axis in ("x", "y", "z", "nx", "ny", "nz")]
        lines += ["element face 12", "property list uchar int vertex_indices", "end_header", *numbers]
        lines += ["3 " + " ".join(map(str, row)) for row in triangles]
    elif name == "a.off":
        lines = ["NOFF", "24 12 0", *numbers, *("3 " + " ".join(map(str, row)) for row in triangles)]
    else:
        lines = ["solid a"]
        for corner in corners:
            lines += ["facet normal 0 0 0", "outer loop"]
            lines += [f"vertex {' '.join(map(str, point))}" for point in corner]
            lines += ["endloop", "endfacet"]
        lines.append("endsolid a")
    path.write_text("\n".join(lines) + "\n")
    result = audit(path)
    assert (result.verdict, result.seams) == ("ok", "format" if name == "a.stl" else "normal")
    assert result.without_seams is not None
    assert result.without_seams.counts == audit(*CUBE).counts
    # The asset keeps the reason of a seam. A repair merges seams whose reason the result does not keep.
    assert msb.open(path).audit().verdict == "ok"
    assert msb.repair(path).after.counts.vertices == 8


def test_a_trained_soup_is_not_a_triangle_list() -> None:
    rng = np.random.default_rng(3)
    apart = rng.random((300, 3)), np.arange(300).reshape(-1, 3)
    assert audit_arrays(*apart, attributes={"triangle_list": np.zeros(0)})[0].verdict == "bad"

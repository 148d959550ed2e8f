"""Seams of UVs and colours are no fault; a mesh that is open at other doubles alone closes once merged."""

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
# The first face has vertices of its own, as where normals or UVs change: open along its three edges.
HARD = np.concatenate([POINTS, POINTS[FACES[0]]]), np.concatenate([[[4, 5, 6]], FACES[1:]])
# A slit: only one end of it is stored twice.
SLIT = np.concatenate([POINTS, POINTS[FACES[0, :1]]]), np.concatenate([[[4, *FACES[0, 1:]]], FACES[1:]])


@pytest.mark.parametrize("weld", [None, "exact", 1e-9])
@pytest.mark.parametrize("mesh", [HARD, SLIT])
def test_doubles_are_told_from_holes(mesh: tuple[np.ndarray, np.ndarray], weld: float | None) -> None:
    found = audit(*mesh, weld=weld)
    assert found.closed_once_merged
    assert found.verdict in ("limited", "bad")
    assert not audit(mesh[0], mesh[1][:-1], weld=weld).closed_once_merged  # a hole beside the seam
    moved = mesh[0] + np.where(np.arange(len(mesh[0])) < 4, 0, 1e-3)[:, None]
    assert not audit(moved, mesh[1]).closed_once_merged


@pytest.mark.parametrize(
    "mesh",
    [
        TETRAHEDRON,
        (POINTS, FACES[:3]),
        BOOK,
        (np.tile(POINTS, (2, 1)), np.concatenate([FACES, FACES[:, ::-1] + 4])[:-1]),  # welded, faces repeat
        (np.full((6, 3), np.nan), np.arange(6).reshape(2, 3)),
    ],
)
def test_what_a_weld_does_not_close_is_not_said_to_be(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    for weld in (None, "exact"):
        assert not audit(*mesh, weld=weld).closed_once_merged


def test_larger_meshes_are_welded_only_if_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seams, "MOST_FACES", 3)
    assert not audit(*HARD).closed_once_merged
    assert audit(*HARD, weld="exact").closed_once_merged


def test_a_verdict_is_that_of_the_mesh_without_its_seams_and_counts_are_as_stored() -> None:
    points, faces, uvs = doubled(*CUBE, CUBE_UVS)
    plain, found = audit(*CUBE), audit_arrays(points, faces, attributes={"uv": uvs})[0]
    assert found.sentence.startswith(plain.sentence)
    assert (found.verdict, found.counts.seam_vertices, plain.counts.seam_vertices) == ("ok", 16, 0)
    assert replace(found.counts, seam_vertices=0) == audit(points, faces).counts
    assert found.without_seams is not None
    assert found.without_seams.counts == plain.counts
    # One corner of the hole is a row that no face uses: nothing is torn there.
    hole = audit_arrays(points, faces[:-1], attributes={"uv": uvs})[0]
    assert hole.verdict == "limited"
    assert (hole.without_seams.counts.boundary_edges, hole.counts.seam_vertices) == (3, 15)


@pytest.mark.parametrize("name", ["uv", "color"])
@pytest.mark.parametrize("kinds", [2, 3, 1000])  # with many kinds no two corners are alike: a soup
def test_whatever_a_closed_mesh_has_at_its_corners_its_file_is_closed(name: str, kinds: int) -> None:
    rng = np.random.default_rng(kinds)
    points, faces = torus()
    values = rng.integers(0, kinds, (faces.size, 2)).astype(np.float32)
    stored, rows, values = doubled(points, faces, values)
    found = audit_arrays(stored, rows, attributes={name: values})[0]
    assert found.without_seams is not None
    assert found.without_seams.counts == audit(points, faces).counts
    assert found.counts.seam_vertices == len(stored) - len(points)
    assert found.seams == {"uv": "texture", "color": "color"}[name]


def test_what_was_never_one_vertex_is_not_merged() -> None:
    rng = np.random.default_rng(5)
    for _ in range(50):
        points = rng.random((12, 3)).astype(np.float32)
        faces = np.stack([rng.permutation(12)[:3] for _ in range(20)])  # edges of many faces, and holes
        stored, rows, uvs = doubled(points, faces, rng.integers(0, 2, (60, 2)).astype(np.float32))
        made = seams.find_seams(stored, rows, {"uv": uvs})
        if made is not None:
            assert np.array_equal(stored[made.first][made.number], stored)
            assert np.array_equal(stored[made.first][made.merged(rows)], stored[rows])


def test_doubles_for_no_uv_or_colour_are_no_seams() -> None:
    uvs = np.concatenate([POINTS, POINTS[FACES[0]]])[:, :2].astype(np.float32)  # alike where places are
    found = audit_arrays(*HARD, attributes={"uv": uvs})[0]
    assert (found.seams, found.verdict) == (None, audit(*HARD).verdict)
    assert found.closed_once_merged


def test_doubles_of_a_format_that_needs_none_are_seams_where_uvs_of_corners_differ() -> None:
    points, faces, uvs = doubled(*CUBE, CUBE_UVS)  # as an OBJ that an engine wrote
    by_corner = {"corner_uv": uvs[faces.reshape(-1)]}
    found = audit_arrays(points, faces, attributes=by_corner)[0]
    assert (found.verdict, found.counts.seam_vertices) == ("ok", 16)
    assert audit_arrays(*CUBE, attributes={"corner_uv": CUBE_UVS})[0].seams is None


def test_of_more_than_two_edges_in_one_place_it_is_not_known_which_belong_together() -> None:
    points, faces, uvs = doubled(BOOK[0], BOOK[1], np.arange(18).reshape(9, 2).astype(np.float32))
    assert audit_arrays(points, faces, attributes={"uv": uvs})[0].seams is None


def test_faces_of_two_textures_have_a_seam_between_them_whatever_their_uvs() -> None:
    faces, uvs = HARD[1], np.zeros((7, 2), np.float32)
    shown = (np.arange(4) == 0).astype(np.uint32)
    found = audit_arrays(HARD[0], faces, attributes={"uv": uvs, "face_texture": shown})[0]
    assert (found.verdict, found.counts.seam_vertices) == ("ok", 3)


def test_a_soup_whose_corners_meet_here_and_there_stays_a_soup() -> None:
    rng = np.random.default_rng(2)
    points = rng.random((300, 3)).astype(np.float32)
    points[3:5] = points[:2]  # two trained triangles meet in an edge
    faces, colors = np.arange(300).reshape(-1, 3), rng.random((300, 3)).astype(np.float32)
    found = audit_arrays(points, faces, attributes={"color": colors})[0]
    assert (found.seams, found.counts.seam_vertices) == (None, 0)
    assert "triangle soup" in found.sentence
    stored, rows, uvs = doubled(*torus(), rng.random((2 * 96 * 3, 2)).astype(np.float32))
    assert audit_arrays(stored, rows, attributes={"uv": uvs})[0].seams == "texture"
    stored[rows[0]] += 1  # a face alone
    found = audit_arrays(stored, rows, attributes={"uv": uvs})[0]
    assert (found.seams, found.verdict) == ("texture", "limited")
    alike = (stored * 10).astype(np.float32)[:, :2]  # nothing that had to be doubled
    assert audit_arrays(stored, rows, attributes={"uv": alike})[0].seams is None


@pytest.mark.parametrize("kinds", [1, 3, 1000])
@pytest.mark.parametrize("domain", ["vertex", "face", "corner"])
@pytest.mark.parametrize("textures", [0, 1, 3])
def test_a_glb_of_a_closed_asset_is_closed(tmp_path: Path, domain: str, kinds: int, textures: int) -> None:
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


def test_a_profile_asks_for_the_mesh_without_its_seams() -> None:
    points, faces, uvs = doubled(*CUBE, CUBE_UVS)
    found = audit_arrays(points, faces, attributes={"uv": uvs})[0]
    gate = parse_gate("boundary_edges>0")
    assert gate.check(found, Path("x")) is not None
    assert replace(gate, profile="print").check(found, Path("x")) is None

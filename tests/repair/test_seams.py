"""A mesh is repaired without its seams: nothing is torn there, nothing is a fault, and textures stay."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import Asset
from msb.meshes import Mesh
from msb.meshes.assets import as_held, asset_from_mesh
from msb.repair.assets import repair_mesh
from msb.repair.plan import parse_plan
from msb.topology import audit_arrays
from tests.conftest import BOOK
from tests.topology.seamed import CUBE, TEXTURE, doubled, textured_cube, torus


def corner_uvs(asset: Asset) -> np.ndarray:
    uvs = asset.buffers["uv"]
    by_vertex = asset.manifest.buffers["uv"].domain == "vertex"
    return uvs[asset.buffers["indices"].reshape(-1)] if by_vertex else uvs


@pytest.mark.parametrize("by", ["vertex", "corner"])
def test_a_closed_asset_has_nothing_to_repair(by: str) -> None:
    asset = asset_from_mesh(textured_cube(by))
    done = msb.repair(asset, "weld,orient,pair,drop,debris,close")
    assert done.asset is asset
    assert (done.before.verdict, done.left, len(done.cut_edges)) == ("ok", (), 0)


@pytest.mark.parametrize("by", ["vertex", "corner"])
def test_a_hole_is_closed_and_the_texture_stays_bit_for_bit(by: str, tmp_path: Any) -> None:
    asset = asset_from_mesh(textured_cube(by, slice(0, 11)))
    done = msb.repair(asset, "close")
    assert (done.before.verdict, done.after.verdict, done.left) == ("limited", "ok", ())
    made = done.asset
    assert np.array_equal(made.buffers["texture.0"], TEXTURE)
    assert made.manifest.appearance == asset.manifest.appearance
    assert (made.manifest.vertex_count, made.manifest.face_count) == (8, 12)
    assert np.array_equal(asset.buffers["positions"][done.vertex_map], made.buffers["positions"])
    assert np.array_equal(corner_uvs(made)[:33], corner_uvs(asset))
    # The cap has what there is along the edge that it grew from, and nothing of between the charts.
    cap = corner_uvs(made)[33:]
    ends = [uv for uv in np.unique(cap, axis=0) if (corner_uvs(asset) == uv).all(axis=1).any()]
    assert len(ends) == 2
    assert (cap == np.mean(ends, axis=0, dtype=np.float32)).all(axis=1).sum() == 1
    msb.save(made, tmp_path / "made.triasset")
    assert [one for one in msb.validate(tmp_path / "made.triasset").findings if one.severity != "info"] == []


def test_values_of_corners_turn_with_a_face() -> None:
    asset = asset_from_mesh(textured_cube("vertex"))
    faces = asset.buffers["indices"].copy()
    faces[4] = faces[4, ::-1]
    turned = replace(asset, buffers={**asset.buffers, "indices": faces})
    done = msb.repair(turned)
    assert (done.turned.sum(), done.left) == (1, ())
    old = np.concatenate([asset.buffers["positions"][faces.reshape(-1)], corner_uvs(turned)], axis=1)
    old = old.reshape(-1, 3, 5)
    old[done.turned] = old[done.turned][:, [0, 2, 1]]
    new = done.asset.buffers["positions"][done.asset.buffers["indices"].reshape(-1)]
    assert np.array_equal(np.concatenate([new, corner_uvs(done.asset)], axis=1), old.reshape(-1, 5))


@pytest.mark.parametrize("plan", ["orient,pair", "orient,cut", "drop,orient", "close", "debris:2"])
def test_doubles_change_nothing_of_what_a_repair_does(plan: str) -> None:
    points, faces = torus(6, 6)
    points = np.concatenate([points, np.eye(4, 3, dtype=np.float32) + 5])
    # A hole, a third face at an edge, a face alone, and a turned one.
    faces = np.concatenate([np.delete(faces, 20, axis=0), [[0, 1, 36], [37, 38, 39]]])
    faces[5] = faces[5, ::-1]
    uvs = np.random.default_rng(3).integers(0, 3, (faces.size, 2)).astype(np.float32)
    uvs[np.isin(faces.reshape(-1), [0, 1])] = 0  # of three torn edges it is not known which belong together
    texture = {"textures": (TEXTURE,)}
    stored, rows, values = doubled(points, faces, uvs)
    one, done = repair_mesh(Mesh(points, faces, corner_uvs=uvs, **texture), parse_plan(plan))
    other, again = repair_mesh(Mesh(stored, rows, vertex_uvs=values, **texture), parse_plan(plan))
    assert other.corner_uvs is not None
    assert one.corner_uvs is not None
    assert len(one.faces) == len(other.faces)
    assert replace(again.after.counts, vertices=0) == replace(done.after.counts, vertices=0)
    assert np.array_equal(one.corner_uvs, other.corner_uvs)
    assert np.array_equal(one.vertices[one.faces], other.vertices[other.faces])
    assert np.array_equal(stored[again.vertex_map], other.vertices)


@pytest.mark.parametrize("kinds", [1, 2])
def test_colours_that_differ_at_a_seam_are_kept(kinds: int) -> None:
    colors = np.random.default_rng(0).integers(0, kinds, (36, 3)).astype(np.float32)
    stored, rows, values = doubled(CUBE[0], CUBE[1], colors)
    rows[3] = rows[3, ::-1]
    mesh = Mesh(stored, rows, values)
    made, done = repair_mesh(mesh, parse_plan("orient"))
    assert made.vertex_colors is not None
    assert done.after.verdict == "ok"
    assert audit_arrays(made.vertices, made.faces, attributes=made.attributes)[0].verdict == "ok"
    old = values[rows]
    old[done.turned] = old[done.turned][:, [0, 2, 1]]
    assert np.array_equal(made.vertex_colors[made.faces], old)
    asset = msb.repair(asset_from_mesh(mesh), "orient").asset
    assert asset.manifest.buffers["color"].domain == ("vertex" if kinds == 1 else "corner")


def test_what_a_repair_took_apart_stays_apart_in_a_file() -> None:
    points, faces = np.float32(BOOK[0]), np.asarray(BOOK[1], np.int64)
    mesh = Mesh(points, faces, corner_uvs=np.arange(18, dtype=np.float32).reshape(9, 2), textures=(TEXTURE,))
    for plan in ("orient,pair", "orient,cut"):
        made, done = repair_mesh(mesh, parse_plan(plan))
        assert done.before.counts.nonmanifold_edges == 1
        held = as_held(made, ".glb")
        found = audit_arrays(held.vertices, held.faces, attributes=held.attributes)[0].judged.counts
        assert (found.nonmanifold_edges, found.nonmanifold_vertices) == (0, 0)

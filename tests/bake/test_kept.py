"""Kept triangles whose colours are in a texture: they are joined as those of the model are."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset.texture import Sampler
from msb.bake import making
from msb.bake.kept import rejoined
from msb.bake.options import Options
from msb.bake.simpler import closed
from msb.errors import UsageError
from msb.meshes.assets import asset_from_mesh, with_vertex_colors
from msb.meshes.mesh import Mesh
from tests.bake.solids import ball, soup_of
from tests.bake.soups import all_round


def halves(mesh: Mesh) -> Mesh:
    """Return a mesh with red faces on one side and blue ones on the other."""
    is_right = mesh.vertices[mesh.faces].mean(axis=1)[:, :1] > 0
    colors = np.where(is_right, np.float32([[1, 0, 0]]), np.float32([[0, 0, 1]]))
    return replace(mesh, vertex_colors=None, face_colors=colors.astype(np.float32))


def cut(mesh: Mesh) -> Mesh:
    """Return a mesh cut where its faces differ in colour, as it is once a texture has the colours."""
    made = with_vertex_colors(mesh)
    uvs = np.arange(6 * len(made.faces), dtype=np.float32).reshape(-1, 2)
    return replace(made, vertex_colors=None, corner_uvs=uvs)


def test_cuts_for_colours_are_joined_again() -> None:
    mesh = cut(halves(ball(4)))
    assert not closed(mesh.vertices, mesh.faces)
    made = rejoined(mesh)
    assert closed(made.vertices, made.faces)
    assert np.array_equal(made.vertices[made.faces], mesh.vertices[mesh.faces])
    assert np.array_equal(made.corner_uvs, mesh.corner_uvs)
    assert rejoined(made) is made


def test_what_met_at_a_cut_is_repaired() -> None:
    whole = halves(ball(4))
    assert whole.face_colors is not None
    is_red = whole.face_colors[:, 0] > 0
    mesh = cut(replace(whole, faces=np.where(is_red[:, None], whole.faces[:, ::-1], whole.faces)))
    made = rejoined(mesh)
    assert closed(made.vertices, made.faces)


def test_a_soup_stays_one() -> None:
    soup = soup_of(ball(4))
    assert rejoined(soup) is soup


def painted(mesh: Mesh, *_: Any, **__: Any) -> Mesh:
    """Return a mesh with a texture whose charts run on over its cuts."""
    uvs = np.zeros((3 * len(mesh.faces), 2), np.float32)
    return replace(mesh, vertex_colors=None, corner_uvs=uvs, textures=(np.zeros((16, 16, 3), np.uint8),))


def test_a_solid_whose_faces_have_colours_stays_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else, if it would be open, a surface is made."""
    monkeypatch.setattr(making, "textured", painted)
    monkeypatch.setattr(making, "fitted", lambda *_, **__: (soup_of(ball(4)), []))
    monkeypatch.setattr(making, "surface", lambda *_, **__: (ball(4), []))
    monkeypatch.setattr("msb.bake.run.need_libraries", lambda _: None)
    monkeypatch.setattr("msb.bake.options.is_installed", lambda _: True)
    model, views = asset_from_mesh(halves(ball(4))), all_round(4, (-1, 1), 3, side=32)
    kept = msb.bake(model, cameras=views, for_solid=True, seconds=0)
    assert (kept.report.geometry, kept.report.after.level) == ("kept", "ok")
    assert "its own triangles are kept, which are a solid already" in kept.report.notes
    monkeypatch.setattr(making, "rejoined", lambda mesh: mesh)
    made = msb.bake(model, cameras=views, for_solid=True, seconds=0)
    assert (made.report.geometry, made.report.after.level) == ("surface", "ok")
    assert not any("a solid already" in note for note in made.report.notes)


@pytest.mark.parametrize("apart", [True, False])
def test_charts_are_asked_for_where_faces_share_vertices(
    monkeypatch: pytest.MonkeyPatch, apart: bool
) -> None:
    """Faces with vertices of their own in another order get cells of the texture, which need nothing."""
    monkeypatch.setattr("msb.base.extras.is_installed", lambda name: name != "xatlas")
    mesh = soup_of(ball(4)) if apart else ball(4)
    asset = asset_from_mesh(replace(mesh, faces=mesh.faces[:, [1, 0, 2]]))
    with nullcontext() if apart else pytest.raises(UsageError, match="xatlas is not installed"):
        Options("kept", color="texture").check_model(asset)


@pytest.mark.parametrize("cutoff", [0.5, None])
def test_that_kept_triangles_are_opaque_is_said(cutoff: float | None) -> None:
    """What alpha cut off gets the colour of what was behind it."""
    card = Mesh(
        np.eye(3, dtype=np.float32),
        np.array([[0, 1, 2]]),
        vertex_uvs=np.array([[0, 0], [1, 0], [0, 1]], np.float32),
        textures=(np.array([[[255, 0, 0, 255], [0, 255, 0, 0]]], np.uint8),),
        sampler=Sampler(alpha_cutoff=cutoff),
    )
    views = all_round(4, (-1, 1), 3, side=32)
    made = msb.bake(asset_from_mesh(card), cameras=views, geometry="kept", color="vertex", seconds=0)
    assert any("triangles are opaque" in note for note in made.report.notes) == (cutoff is not None)


@pytest.mark.parametrize(("lost", "said"), [(1, "1 triangle fewer"), (2, "2 triangles fewer")])
def test_how_many_triangles_went_is_said(monkeypatch: pytest.MonkeyPatch, lost: int, said: str) -> None:
    whole = ball(4)
    monkeypatch.setattr(
        making, "fitted", lambda *_, **__: (soup_of(replace(whole, faces=whole.faces[lost:])), [])
    )
    views = all_round(4, (-1, 1), 3, side=32)
    model = asset_from_mesh(replace(whole, vertex_colors=None))
    made = msb.bake(model, cameras=views, geometry="fitted", color="vertex", seconds=0)
    assert f"{said} than the model's" in made.report.notes

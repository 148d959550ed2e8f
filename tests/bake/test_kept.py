"""Kept triangles whose colours are in a texture: they are joined as those of the model are."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

import msb
from msb.asset.texture import Sampler
from msb.bake.kept import rejoined
from msb.bake.needs import check_model
from msb.bake.options import BakeOptions
from msb.bake.simpler import closed
from msb.errors import UsageError
from msb.meshes.assets import asset_from_mesh, with_vertex_colors
from msb.meshes.mesh import Mesh
from tests.bake.soups import all_round, ball, soup_of


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


@pytest.mark.parametrize("apart", [True, False])
def test_only_faces_that_share_vertices_need_charts(monkeypatch: pytest.MonkeyPatch, apart: bool) -> None:
    """Separate faces, in any order, get cells of the texture, which need no library."""
    monkeypatch.setattr("msb.base.extras.is_installed", lambda name: name != "xatlas")
    mesh = soup_of(ball(4)) if apart else ball(4)
    asset = asset_from_mesh(replace(mesh, faces=mesh.faces[:, [1, 0, 2]]))
    with nullcontext() if apart else pytest.raises(UsageError):
        check_model(BakeOptions("kept", color="texture"), asset)


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

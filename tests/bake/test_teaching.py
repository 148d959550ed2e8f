"""Colours, choice and descent on soups whose best form is known."""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset.texture import Sampler
from msb.bake.descent import Schedule, moved
from msb.bake.fitted import _cuts, fitted
from msb.bake.kept import FINE, kept, rejoined
from msb.bake.needs import check_model, choose_look
from msb.bake.options import BakeOptions
from msb.bake.search import hide_least, try_faces
from msb.bake.simpler import closed
from msb.bake.soup import Soup
from msb.bake.start import colored
from msb.errors import UsageError
from msb.meshes.assets import asset_from_mesh, with_vertex_colors
from msb.meshes.mesh import Mesh
from msb.topology import audit_arrays
from tests.bake.soups import all_round, ball, cameras, guide_of, lessons_of, mesh_of, soup_of, taught, tiles
from tests.conftest import TETRAHEDRON


def db(error: float) -> float:
    return float(-10 * np.log10(error))


def test_copies_of_a_vertex_keep_one_colour_and_others_of_its_place_their_own() -> None:
    corners, colors = tiles()
    places, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    half = len(corners) // 2
    faces = number.reshape(-1, 3)
    faces[half:] += len(places)  # cut in two, as a repair does
    mesh = Mesh(np.tile(places, (2, 1)), faces, vertex_colors=np.full((2 * len(places), 3), 0.5, np.float32))
    with lessons_of(corners, colors, cameras(4)) as lessons:
        for change in (0.0, 0.25):  # without and with a seam
            mesh.vertex_colors[len(places) :] += np.float32(change)
            made = colored(mesh, lessons, None)
            there = len(np.unique(made.vertices, axis=0))
            assert len(made.vertices) > there + 2
            looks = len(np.unique(np.column_stack([made.vertices, made.vertex_colors]), axis=0))
            assert (looks > there) == bool(change)


def test_a_face_that_hides_what_should_be_seen_is_dropped_and_a_lost_one_found() -> None:
    corners, colors = tiles()
    wrong = np.array([[[-0.5, -0.5, -0.5], [0.5, -0.5, -0.5], [0, 0.5, -0.5]]], np.float32)
    soup = Soup.of(
        mesh_of(np.concatenate([corners, wrong]), np.concatenate([colors, 1 - colors[:1]])), shares=True
    )
    soup.keep[3] = False
    random = np.random.default_rng(0)
    with taught((soup.corners, soup.colors), (corners, colors), cameras(4)) as raster:
        for _ in range(60):
            try_faces(soup, raster, random)
        assert soup.keep.tolist() == [True] * len(corners) + [False]
        hide_least(soup, raster, random, 10)
        assert soup.keep.sum() == 10


def test_corners_move_to_where_they_should_be() -> None:
    corners, colors = tiles()
    colors[:] = colors.mean(axis=(1), keepdims=True)
    shaken = corners + np.random.default_rng(1).normal(size=corners.shape).astype(np.float32) * np.float32(
        0.04
    )
    soup = Soup.of(mesh_of(shaken, colors), shares=False)
    how: Any = {"rates": (0.02, 0.002), "most": None, "done": lambda step: step / 60}
    with taught((soup.corners, soup.colors), (corners, colors), cameras(6, 96, 72)) as raster:
        before = soup.error(raster)
        made = moved(soup, raster, raster, np.random.default_rng(2), **how)
        assert db(made.error(raster)) > db(before) + 3


def test_faces_are_halved_across_their_longest_sides_as_often_as_they_are_large() -> None:
    corners = np.zeros((3, 3, 3), np.float32)
    corners[:, 1, 0], corners[:, 2, 1] = 4, 1
    corners[:, :, 2] = np.arange(3)[:, None]
    colors = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)[corners[..., 1].astype(int)]
    soup = Soup.of(mesh_of(corners, colors), shares=False)
    soup.keep[1] = False
    cut = soup.halved(_cuts(np.array([FINE, 9 * FINE]), 10))
    assert cut.count == 9
    assert (cut.corners[:, 0, 2] == 2).sum() == 8
    sides = cut.corners[:, 1:] - cut.corners[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    np.testing.assert_allclose(np.sort(areas), [0.5] * 8 + [4])
    longest = np.linalg.norm(cut.corners - np.roll(cut.corners, -1, axis=1), axis=2).max(axis=1)
    assert longest[areas < 1].max() <= 2
    np.testing.assert_allclose(cut.colors[..., 1], cut.corners[..., 1], atol=1e-6)  # as they run over it


@pytest.mark.parametrize("search", [kept, fitted])
def test_a_watch_that_has_seen_enough_ends_a_search_with_the_best_so_far(search: Callable[..., Any]) -> None:
    corners, colors = tiles()
    seen: list[tuple[str, int]] = []

    def watch(stage: str, done: int, _total: int) -> bool:
        seen.append((stage, done))
        return done == 2

    asset = asset_from_mesh(mesh_of(corners, np.full_like(colors, 0.5)))
    views = cameras(5)
    with guide_of((corners, colors), views[1:], views[:1], watch=watch) as guide:
        made = search(asset, guide)
        if search is fitted:
            made, notes = made
            assert "2 of 400 steps" in notes[0]
        assert seen[-1][1] == 2
        assert np.abs(made.vertex_colors - 0.5).max() > 0.1, "colours are fitted all the same"


@pytest.mark.parametrize("faces", [None, 500])
def test_triangles_of_too_few_pixels_are_chosen_and_coloured_and_stay(faces: int | None) -> None:
    corners, colors = tiles(20)
    asset = asset_from_mesh(mesh_of(corners, np.full_like(colors, 0.5)))
    with guide_of((corners, colors), cameras(5, 24, 18)) as guide:
        made, notes = fitted(asset, guide, faces=faces, pixels=10_000)
    assert len(made.faces) == (faces or 800)
    assert notes[0].startswith(f"{len(made.faces):,} triangles have 0.")
    where = {tuple(each.reshape(-1)) for each in corners}
    assert {tuple(each.reshape(-1)) for each in made.vertices[made.faces]} <= where
    assert np.abs(made.vertex_colors - 0.5).max() > 0.1


def test_a_mesh_whose_triangles_are_kept_becomes_manifold_and_wound_one_way() -> None:
    corners, colors = tiles()
    points, numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = numbers.reshape(-1, 3)
    pages = [[*faces[0, :2], len(points)], [*faces[0, :2], len(points) + 1]]
    faces[::3] = faces[::3, ::-1]
    points = np.concatenate([points, np.float32([[-1, -1, -1], [-1, 0, -1]])])
    mesh = Mesh(points, np.concatenate([faces, pages]), vertex_colors=np.full_like(points, 0.5))
    before, _ = audit_arrays(mesh.vertices, mesh.faces)
    assert before.counts.nonmanifold_edges
    assert not before.winding_consistent
    with guide_of((corners, colors), cameras(3)) as guide:
        made = kept(asset_from_mesh(mesh), guide)
    after, _ = audit_arrays(made.vertices, made.faces)
    assert (after.counts.nonmanifold_edges, after.counts.nonmanifold_vertices) == (0, 0)
    assert after.winding_consistent
    assert made.vertex_colors is not None


def test_every_triangle_of_what_is_its_own_look_is_kept_whatever_pictures_show() -> None:
    corners, colors = tiles()
    with guide_of((corners[::2], colors[::2]), cameras(3), has_look=True) as guide:
        made = kept(asset_from_mesh(mesh_of(corners, colors)), guide)
    np.testing.assert_array_equal(made.vertices[made.faces], corners)


@pytest.mark.parametrize("has_xatlas", [True, False])
@pytest.mark.parametrize(
    ("colors", "look"), [("vertex_colors", "vertex"), ("face_colors", "texture"), (None, "texture")]
)
def test_kept_triangles_get_a_texture_where_corners_cannot_have_their_colours(
    colors: str | None, look: str, has_xatlas: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("msb.bake.needs.is_installed", lambda _: has_xatlas)
    vertices, faces = TETRAHEDRON
    alone = np.full((4, 3), 9, np.uint8)
    mesh = Mesh(vertices, faces.astype(np.int64), **({colors: alone} if colors else {}))
    assert choose_look(BakeOptions(), "kept", asset_from_mesh(mesh)) == (look if has_xatlas else "vertex")
    soup = Mesh(vertices[faces].reshape(-1, 3), np.arange(12).reshape(-1, 3), face_colors=alone)
    assert choose_look(BakeOptions(), "kept", asset_from_mesh(soup)) == "vertex"


@pytest.mark.parametrize(
    ("first", "then", "until", "least", "most"),
    [(1, 1, 100, 98, 101), (30, 1, 100, 68, 72), (1, 1, np.inf, 200, 200), (30, 1, 1000, 200, 200)],
)
def test_a_search_takes_the_steps_there_is_time_for(
    first: float, then: float, until: float, least: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    schedule = Schedule(200, until)
    step, shares = 0, [0.0]
    while shares[-1] < 1:
        step += 1
        now += first if step == 1 else then
        shares.append(schedule.share(step, enough=False))
    assert least <= step <= most
    assert (np.diff(shares) > 0).all()
    assert np.diff(shares).max() < 0.1
    assert bool(schedule.lacks("it")) == (step < 200)


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


@pytest.mark.parametrize("is_torn", [False, True])
def test_cuts_for_colours_are_joined_again_and_repaired(is_torn: bool) -> None:
    whole = halves(ball(4))
    is_turned = is_torn & (whole.face_colors[:, :1] > 0)
    mesh = cut(replace(whole, faces=np.where(is_turned, whole.faces[:, ::-1], whole.faces)))
    assert not closed(mesh.vertices, mesh.faces)
    made = rejoined(mesh)
    assert closed(made.vertices, made.faces)
    if not is_torn:
        assert np.array_equal(made.vertices[made.faces], mesh.vertices[mesh.faces])
        assert np.array_equal(made.corner_uvs, mesh.corner_uvs)
    soup = soup_of(ball(4))
    assert all(rejoined(each) is each for each in (made, soup))


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

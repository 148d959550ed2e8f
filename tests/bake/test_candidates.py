"""Tests of the candidates kept and fitted, and of the steps that make them.

The best result for each soup is known.
"""

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset.texture import Sampler
from msb.bake.candidate_fitted import _plan_halving, make_fitted
from msb.bake.candidate_kept import FINE_PIXELS, make_kept, rejoin_cuts
from msb.bake.descent import StepSchedule, move_faces
from msb.bake.face_selection import hide_cheapest_faces, toggle_faces
from msb.bake.options import BakeOptions
from msb.bake.requirements import check_model, choose_color_target
from msb.bake.simplification import is_closed_surface
from msb.bake.soup import Soup
from msb.bake.vertex_colors import fit_vertex_colors
from msb.errors import UsageError
from msb.meshes.assets import asset_from_mesh, with_vertex_colors
from msb.meshes.mesh import Mesh
from msb.topology import audit_arrays
from tests.bake.soups import (
    all_round,
    ball,
    cameras,
    images_of,
    mesh_of,
    open_context,
    open_renderer,
    soup_of,
    tiles,
)
from tests.conftest import TETRAHEDRON


@pytest.mark.slow
def test_copies_of_a_vertex_keep_one_colour_unless_they_are_a_seam() -> None:
    corners, colors = tiles()
    places, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    half = len(corners) // 2
    faces = number.reshape(-1, 3)
    faces[half:] += len(places)  # cut in two, as by a repair
    mesh = Mesh(np.tile(places, (2, 1)), faces, vertex_colors=np.full((2 * len(places), 3), 0.5, np.float32))
    with images_of(corners, colors, cameras(4)) as images:
        for change in (0.0, 0.25):  # without and with a seam
            mesh.vertex_colors[len(places) :] += np.float32(change)
            fitted = fit_vertex_colors(mesh, images, None)
            there = len(np.unique(fitted.vertices, axis=0))
            assert len(fitted.vertices) > there + 2
            distinct = np.unique(np.column_stack([fitted.vertices, fitted.vertex_colors]), axis=0)
            assert (len(distinct) > there) == bool(change)


def test_occluding_faces_are_hidden_and_missing_ones_shown() -> None:
    corners, colors = tiles()
    wrong = np.array([[[-0.5, -0.5, -0.5], [0.5, -0.5, -0.5], [0, 0.5, -0.5]]], np.float32)
    mesh = mesh_of(np.concatenate([corners, wrong]), np.concatenate([colors, 1 - colors[:1]]))
    soup = Soup.from_mesh(mesh, share_colors=True)
    soup.selected[3] = False
    random = np.random.default_rng(0)
    with open_renderer((soup.corners, soup.colors), (corners, colors), cameras(4)) as renderer:
        for _ in range(60):
            toggle_faces(soup, renderer, random)
        assert soup.selected.tolist() == [True] * len(corners) + [False]
        hide_cheapest_faces(soup, renderer, random, 10)
        assert soup.selected.sum() == 10


def test_shaken_corners_move_back() -> None:
    corners, colors = tiles()
    colors[:] = colors.mean(axis=(1), keepdims=True)
    noise = np.random.default_rng(1).normal(size=corners.shape).astype(np.float32)
    soup = Soup.from_mesh(mesh_of(corners + noise * np.float32(0.04), colors), share_colors=False)
    schedule = StepSchedule(60, np.inf, lambda *_: False)
    settings: Any = {"step_lengths": (0.02, 0.002), "most": None, "schedule": schedule}
    with open_renderer((soup.corners, soup.colors), (corners, colors), cameras(6, 96, 72)) as renderer:
        before = soup.measure_error(renderer)
        moved = move_faces(soup, renderer, renderer, np.random.default_rng(2), **settings)
        assert moved.measure_error(renderer) < before / 2  # 3 dB


def test_large_faces_are_halved_across_their_longest_sides() -> None:
    corners = np.zeros((3, 3, 3), np.float32)
    corners[:, 1, 0], corners[:, 2, 1] = 4, 1
    corners[:, :, 2] = np.arange(3)[:, None]
    colors = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)[corners[..., 1].astype(int)]
    soup = Soup.from_mesh(mesh_of(corners, colors), share_colors=False)
    soup.selected[1] = False
    pieces = soup.halve(_plan_halving(np.array([FINE_PIXELS, 9 * FINE_PIXELS]), 10))
    assert pieces.selected_count == 9
    assert (pieces.corners[:, 0, 2] == 2).sum() == 8
    sides = pieces.corners[:, 1:] - pieces.corners[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    np.testing.assert_allclose(np.sort(areas), [0.5] * 8 + [4])
    longest = np.linalg.norm(pieces.corners - np.roll(pieces.corners, -1, axis=1), axis=2).max(axis=1)
    assert longest[areas < 1].max() <= 2
    np.testing.assert_allclose(pieces.colors[..., 1], pieces.corners[..., 1], atol=1e-6)  # interpolated


@pytest.mark.parametrize("search", [make_kept, make_fitted])
def test_progress_can_stop_a_search_with_the_best_result(search: Callable[..., Any]) -> None:
    corners, colors = tiles()
    calls: list[tuple[str, int]] = []

    def progress(stage: str, done: int, _total: int) -> bool:
        calls.append((stage, done))
        return done == 2

    asset = asset_from_mesh(mesh_of(corners, np.full_like(colors, 0.5)))
    views = cameras(5)
    with open_context((corners, colors), views[1:], views[:1], progress=progress) as context:
        mesh = search(asset, context)
        if search is make_fitted:
            mesh, notes = mesh
            assert "2 of 400 steps" in notes[0]
        assert calls[-1][1] == 2
        assert np.abs(mesh.vertex_colors - 0.5).max() > 0.1, "colours are fitted in any case"


def test_the_default_budget_follows_the_images_that_move_faces() -> None:
    corners, colors = tiles(20)
    asset = asset_from_mesh(mesh_of(corners, np.full_like(colors, 0.5)))
    with open_context((corners, colors), cameras(5, 24, 18)) as context:
        mesh, notes = make_fitted(asset, replace(context, step_factor=0.01), pixels=10_000)
    assert 0 < len(mesh.faces) <= 24 * 18 / 2.5
    assert not notes


def test_triangles_of_too_few_pixels_are_selected_and_not_moved() -> None:
    faces = 500
    corners, colors = tiles(20)
    asset = asset_from_mesh(mesh_of(corners, np.full_like(colors, 0.5)))
    with open_context((corners, colors), cameras(5, 24, 18)) as context:
        mesh, notes = make_fitted(asset, context, faces=faces, pixels=10_000)
    assert len(mesh.faces) == faces
    assert notes[0].startswith(f"{len(mesh.faces):,} triangles have 0.")
    before = {tuple(face.reshape(-1)) for face in corners}
    assert {tuple(face.reshape(-1)) for face in mesh.vertices[mesh.faces]} <= before
    assert np.abs(mesh.vertex_colors - 0.5).max() > 0.1


def test_a_kept_mesh_becomes_manifold_and_consistently_wound() -> None:
    corners, colors = tiles()
    points, numbers = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    faces = numbers.reshape(-1, 3)
    flaps = [[*faces[0, :2], len(points)], [*faces[0, :2], len(points) + 1]]
    faces[::3] = faces[::3, ::-1]
    points = np.concatenate([points, np.float32([[-1, -1, -1], [-1, 0, -1]])])
    mesh = Mesh(points, np.concatenate([faces, flaps]), vertex_colors=np.full_like(points, 0.5))
    before, _ = audit_arrays(mesh.vertices, mesh.faces)
    assert before.counts.nonmanifold_edges
    assert not before.winding_consistent
    with open_context((corners, colors), cameras(3)) as context:
        kept = make_kept(asset_from_mesh(mesh), context)
    after, _ = audit_arrays(kept.vertices, kept.faces)
    assert (after.counts.nonmanifold_edges, after.counts.nonmanifold_vertices) == (0, 0)
    assert after.winding_consistent
    assert kept.vertex_colors is not None


def test_all_triangles_are_kept_if_the_images_show_the_model_mesh() -> None:
    corners, colors = tiles()
    with open_context((corners[::2], colors[::2]), cameras(3), shows_model_mesh=True) as context:
        kept = make_kept(asset_from_mesh(mesh_of(corners, colors)), context)
    np.testing.assert_array_equal(kept.vertices[kept.faces], corners)


@pytest.mark.parametrize("has_xatlas", [True, False])
@pytest.mark.parametrize(
    ("colors", "target"), [("vertex_colors", "vertex"), ("face_colors", "texture"), (None, "texture")]
)
def test_kept_triangles_get_a_texture_unless_vertex_colours_suffice(
    colors: str | None, target: str, has_xatlas: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("msb.bake.requirements.is_installed", lambda _: has_xatlas)
    vertices, faces = TETRAHEDRON
    gray = np.full((4, 3), 9, np.uint8)
    connected = asset_from_mesh(Mesh(vertices, faces.astype(np.int64), **({colors: gray} if colors else {})))
    expected = target if has_xatlas else "vertex"
    assert choose_color_target(BakeOptions(), "kept", connected) == expected
    soup = Mesh(vertices[faces].reshape(-1, 3), np.arange(12).reshape(-1, 3), face_colors=gray)
    assert choose_color_target(BakeOptions(), "kept", asset_from_mesh(soup)) == "vertex"


@pytest.mark.parametrize(
    ("first", "then", "until", "least", "most"),
    [(1, 1, 100, 98, 101), (30, 1, 100, 68, 72), (1, 1, np.inf, 200, 200), (30, 1, 1000, 200, 200)],
)
def test_a_schedule_fits_its_steps_into_the_time(
    first: float, then: float, until: float, least: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    schedule = StepSchedule(200, until, lambda *_: False)
    step, shares = 0, [0.0]
    while shares[-1] < 1:
        step += 1
        now += first if step == 1 else then
        shares.append(schedule.finish_step(step))
    assert least <= step <= most
    assert (np.diff(shares) > 0).all()
    assert np.diff(shares).max() < 0.1
    assert bool(schedule.notes("it")) == (step < 200)


def cut_by_colour(mesh: Mesh, is_turned: bool) -> Mesh:
    """Return a textured mesh, cut between its red and blue faces; `is_turned` reverses the red faces."""
    is_red = mesh.vertices[mesh.faces].mean(axis=1)[:, :1] > 0
    colors = np.where(is_red, np.float32([[1, 0, 0]]), np.float32([[0, 0, 1]])).astype(np.float32)
    faces = np.where(is_turned & is_red, mesh.faces[:, ::-1], mesh.faces)
    cut = with_vertex_colors(Mesh(mesh.vertices, faces, face_colors=colors))
    uvs = np.arange(6 * len(cut.faces), dtype=np.float32).reshape(-1, 2)
    return replace(cut, vertex_colors=None, corner_uvs=uvs)


@pytest.mark.parametrize("is_turned", [False, True])
def test_cuts_for_colours_are_closed_and_repaired(is_turned: bool) -> None:
    mesh = cut_by_colour(ball(4), is_turned)
    assert not is_closed_surface(mesh.vertices, mesh.faces)
    joined = rejoin_cuts(mesh)
    assert is_closed_surface(joined.vertices, joined.faces)
    if not is_turned:
        assert np.array_equal(joined.vertices[joined.faces], mesh.vertices[mesh.faces])
        assert np.array_equal(joined.corner_uvs, mesh.corner_uvs)
    soup = soup_of(ball(4))
    assert all(rejoin_cuts(whole) is whole for whole in (joined, soup))


@pytest.mark.parametrize("apart", [True, False])
def test_only_connected_faces_need_charts(monkeypatch: pytest.MonkeyPatch, apart: bool) -> None:
    """Faces that share no vertex get cells of the texture, whatever their order. Cells need no library."""
    monkeypatch.setattr("msb.base.extras.is_installed", lambda name: name != "xatlas")
    mesh = soup_of(ball(4)) if apart else ball(4)
    asset = asset_from_mesh(replace(mesh, faces=mesh.faces[:, [1, 0, 2]]))
    with nullcontext() if apart else pytest.raises(UsageError):
        check_model(BakeOptions("kept", color="texture"), asset)


@pytest.mark.parametrize("cutoff", [0.5, None])
@pytest.mark.slow
def test_kept_triangles_with_an_alpha_cutoff_have_a_note(cutoff: float | None) -> None:
    card = Mesh(
        np.eye(3, dtype=np.float32),
        np.array([[0, 1, 2]]),
        vertex_uvs=np.array([[0, 0], [1, 0], [0, 1]], np.float32),
        textures=(np.array([[[255, 0, 0, 255], [0, 255, 0, 0]]], np.uint8),),
        sampler=Sampler(alpha_cutoff=cutoff),
    )
    views = all_round(4, (-1, 1), 3, side=32)
    baked = msb.bake(asset_from_mesh(card), cameras=views, geometry="kept", color="vertex", seconds=0)
    assert any("triangles are opaque" in note for note in baked.report.notes) == (cutoff is not None)

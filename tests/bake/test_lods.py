"""Levels of detail: the requested number of faces, closed surfaces that stay closed, and colours."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from msb.bake import lods
from msb.bake.candidate_kept import make_kept
from msb.bake.images import ViewImages
from msb.bake.lods import make_lods, measure_screen_share
from msb.bake.simplification import is_closed_surface, simplify
from msb.bake.soup import Soup, is_uncut_soup
from msb.bake.soup_renderer import SoupRenderer
from msb.meshes.assets import asset_from_mesh, with_vertex_colors
from msb.meshes.mesh import Mesh
from msb.topology.faces import face_areas
from tests.bake.soups import (
    all_round,
    ball,
    box,
    cameras,
    colors_at,
    mesh_of,
    open_context,
    soup_of,
    tiles,
    together,
    upper_part,
)


def error_of(mesh: Mesh, images: ViewImages) -> float:
    soup = Soup.from_mesh(mesh, share_colors=False)
    with closing(SoupRenderer(soup.corners, soup.colors, images)) as renderer:
        return soup.measure_error(renderer)


def test_a_soup_keeps_its_visible_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lods, "_STEPS", 3)
    corners, colors = tiles(6)
    behind = corners + np.float32([0, 0, -50])
    mesh = mesh_of(np.concatenate([behind, corners]), np.concatenate([colors, colors]))
    with open_context((corners, colors), cameras(2), cameras(1)) as context:
        half, few = (level for level, _ in make_lods(mesh, context, (0.5, 0.1)))
        assert 4 * error_of(half, context.training) < error_of(few, context.training)
    assert len(half.faces) == len(corners)
    assert half.vertices[:, 2].min() > -25
    assert len(few.faces) == round(0.2 * len(corners))
    assert few.vertex_colors.dtype == np.float32


def test_levels_of_very_few_faces_can_be_equal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lods, "_STEPS", 1)
    corners, colors = tiles(1)
    mesh = mesh_of(np.concatenate([corners, corners[:1] + 1]), np.concatenate([colors, colors[:1]]))
    with open_context((corners, colors), cameras(1)) as context:
        levels = make_lods(mesh, context, (0.7, 0.4, 0.1))
    assert [len(level.faces) for level, _ in levels] == [2, 1, 1]


@pytest.mark.slow
def test_faces_of_a_soup_move_to_replace_hidden_ones() -> None:
    corners, colors = tiles(6)
    colors = np.broadcast_to(np.float32([0.9, 0.6, 0.1]), colors.shape).copy()
    mesh = mesh_of(corners, colors)
    with open_context((corners, colors), cameras(4), cameras(3)) as context:
        ((moved, _),) = make_lods(mesh, context, (0.7,))
        ((unmoved, _),) = make_lods(mesh, context, (0.7,), seconds=0)
        assert error_of(moved, context.training) < 0.7 * error_of(unmoved, context.training)


def test_a_level_that_ends_early_has_a_note() -> None:
    corners, colors = tiles(6)
    mesh = mesh_of(corners, colors)
    with open_context((corners, colors), cameras(2)) as context:
        stopping = replace(context, progress=lambda _, done, __: done >= 3)
        ((_, notes),) = make_lods(mesh, stopping, (0.8,))
        ((_, late),) = make_lods(mesh, context, (0.3,), seconds=0)
    assert "3 of 300" in notes[0]
    assert "1 of 300" in late[0]


def test_a_closed_mesh_with_face_colours_stays_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lods, "_STEPS", 1)
    cube = box((1, 1, 1))
    painted = np.random.default_rng(0).random((12, 3)).astype(np.float32)
    asset = asset_from_mesh(Mesh(cube.vertices, cube.faces, face_colors=painted))
    target = soup_of(cube).vertices.reshape(-1, 3, 3), np.repeat(painted[:, None], 3, axis=1)
    with open_context(target, all_round(3, (-1, 1), 3), shows_model_mesh=True) as context:
        kept = make_kept(asset, context)
        assert len(kept.vertices) == 36
        assert not is_uncut_soup(kept.vertices, kept.faces)
        ((level, _),) = make_lods(kept, context, (0.5,))
    assert is_closed_surface(level.vertices.astype(np.float64), level.faces)


def test_an_open_mesh_with_face_colours_gets_no_holes() -> None:
    corners, _ = tiles(8)
    vertices, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    painted = np.random.default_rng(0).random((len(corners), 3)).astype(np.float32)
    mesh = with_vertex_colors(Mesh(vertices, number.reshape(-1, 3), face_colors=painted))
    assert len(mesh.vertices) == 3 * len(mesh.faces)
    with open_context((corners, np.repeat(painted[:, None], 3, axis=1)), cameras(2)) as context:
        ((level, _),) = make_lods(mesh, context, (0.25,))
    assert len(level.faces) <= len(mesh.faces) // 4
    before, after = (face_areas(part.vertices, part.faces)[0].sum() for part in (mesh, level))
    assert 0.9 * before < after <= before
    assert level.vertex_colors is not None


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2)])
def test_faces_without_shared_vertices_are_a_soup_in_any_order(order: tuple[int, ...]) -> None:
    corners, _ = tiles(3)
    apart = corners + 9 * np.arange(len(corners), dtype=np.float32)[:, None, None]
    faces = np.arange(3 * len(corners)).reshape(-1, 3)[:, order]
    assert is_uncut_soup(apart.reshape(-1, 3), faces)
    assert not is_uncut_soup(ball(4).vertices, ball(4).faces)


@pytest.mark.slow
def test_a_closed_surface_stays_closed_and_keeps_its_colours() -> None:
    mesh = ball()
    soup = soup_of(mesh)
    target = soup.vertices.reshape(-1, 3, 3), soup.vertex_colors.reshape(-1, 3, 3)
    with open_context(target, all_round(4, (-2, 2), 5), all_round(4, (1,), 3)) as context:
        levels = [level for level, _ in make_lods(mesh, context, (0.5, 0.1))]
    for level, share in zip(levels, (0.5, 0.1), strict=True):
        assert len(level.faces) <= share * len(mesh.faces)
        assert is_closed_surface(level.vertices.astype(np.float64), level.faces)
        np.testing.assert_allclose(level.vertex_colors, colors_at(level.vertices), atol=0.15)
    assert measure_screen_share(mesh, levels[0]) > measure_screen_share(mesh, levels[1])


def test_a_surface_gets_more_faces_than_requested_if_nothing_is_left() -> None:
    mesh = box((1, 2, 3))
    assert is_closed_surface(*simplify(mesh.vertices.astype(np.float64), mesh.faces, 1))


def test_an_open_surface_stays_manifold() -> None:
    half = upper_part(ball(), 0)
    points, faces = simplify(half.vertices.astype(np.float64), half.faces, len(half.faces) // 4)
    assert 0 < len(faces) <= len(half.faces) // 4
    assert not is_closed_surface(points, faces)
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert np.unique(edges, axis=0, return_counts=True)[1].max() <= 2


@pytest.mark.slow
def test_the_screen_share_is_the_height_at_an_error_of_a_pixel() -> None:
    mesh, larger = ball(20), ball(20, radius=1.01)
    assert measure_screen_share(mesh, mesh) == 1
    assert measure_screen_share(mesh, larger) == pytest.approx(2 / (1080 * 0.01), rel=0.05)
    assert measure_screen_share(mesh, larger, rows=540) == pytest.approx(2 / (540 * 0.01), rel=0.05)
    twice = together(mesh, Mesh(mesh.vertices + np.float32([2, 0, 0]), mesh.faces))
    assert measure_screen_share(twice, together(twice, larger)) > measure_screen_share(mesh, larger)

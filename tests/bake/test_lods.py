"""Levels of detail: as few faces as asked for, as closed as before, in the right colours."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from msb.bake import lods as levels
from msb.bake.kept import kept
from msb.bake.lessons import Lessons
from msb.bake.lods import lods, screen_share
from msb.bake.raster import Raster
from msb.bake.simpler import closed, simpler
from msb.bake.soup import Soup, is_uncut_soup
from msb.meshes.assets import asset_from_mesh, with_vertex_colors
from msb.meshes.mesh import Mesh
from msb.topology.faces import face_areas
from tests.bake.soups import (
    all_round,
    ball,
    box,
    cameras,
    colors_at,
    guide_of,
    mesh_of,
    soup_of,
    tiles,
    together,
)


def error(mesh: Mesh, lessons: Lessons) -> float:
    soup = Soup.of(mesh, shares=False)
    with closing(Raster(soup.corners, soup.colors, lessons)) as raster:
        return soup.error(raster)


def test_of_a_soup_the_faces_stay_that_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels, "_STEPS", 3)
    corners, colors = tiles(6)
    behind = corners + np.float32([0, 0, -50])
    mesh = mesh_of(np.concatenate([behind, corners]), np.concatenate([colors, colors]))
    with guide_of((corners, colors), cameras(2), cameras(1)) as guide:
        half, few = (level for level, _ in lods(mesh, guide, (0.5, 0.1)))
        assert 4 * error(half, guide.lessons) < error(few, guide.lessons)
    assert len(half.faces) == len(corners)
    assert half.vertices[:, 2].min() > -25
    assert len(few.faces) == round(0.2 * len(corners))
    assert few.vertex_colors.dtype == np.float32


def test_levels_of_so_few_faces_that_some_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels, "_STEPS", 1)
    corners, colors = tiles(1)
    mesh = mesh_of(np.concatenate([corners, corners[:1] + 1]), np.concatenate([colors, colors[:1]]))
    with guide_of((corners, colors), cameras(1)) as guide:
        made = lods(mesh, guide, (0.7, 0.4, 0.1))
    assert [len(level.faces) for level, _ in made] == [2, 1, 1]


@pytest.mark.slow
def test_faces_of_a_soup_move_to_make_up_for_those_that_go() -> None:
    corners, colors = tiles(6)
    colors = np.broadcast_to(np.float32([0.9, 0.6, 0.1]), colors.shape).copy()
    mesh = mesh_of(corners, colors)
    with guide_of((corners, colors), cameras(4), cameras(3)) as guide:
        ((made, _),) = lods(mesh, guide, (0.7,))
        ((unmoved, _),) = lods(mesh, guide, (0.7,), seconds=0)
        assert error(made, guide.lessons) < 0.7 * error(unmoved, guide.lessons)


def test_a_level_that_ends_early_says_so() -> None:
    corners, colors = tiles(6)
    mesh = mesh_of(corners, colors)
    with guide_of((corners, colors), cameras(2)) as guide:
        ((_, notes),) = lods(mesh, replace(guide, watch=lambda _, done, __: done >= 3), (0.8,))
        ((_, late),) = lods(mesh, guide, (0.3,), seconds=0)
    assert "3 of 300" in notes[0]
    assert "1 of 300" in late[0]


def test_a_closed_mesh_whose_faces_have_colours_of_their_own_stays_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(levels, "_STEPS", 1)
    cube = box((1, 1, 1))
    painted = np.random.default_rng(0).random((12, 3)).astype(np.float32)
    asset = asset_from_mesh(Mesh(cube.vertices, cube.faces, face_colors=painted))
    seen = soup_of(cube)
    corners, colors = seen.vertices.reshape(-1, 3, 3), np.repeat(painted[:, None], 3, axis=1)
    with guide_of((corners, colors), all_round(3, (-1, 1), 3), has_look=True) as guide:
        made = kept(asset, guide)
        assert len(made.vertices) == 36
        assert not is_uncut_soup(made.vertices, made.faces)
        ((level, _),) = lods(made, guide, (0.5,))
    assert closed(level.vertices.astype(np.float64), level.faces)


def test_an_open_mesh_whose_faces_have_colours_of_their_own_gets_no_holes() -> None:
    corners, _ = tiles(8)
    vertices, number = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    painted = np.random.default_rng(0).random((len(corners), 3)).astype(np.float32)
    mesh = with_vertex_colors(Mesh(vertices, number.reshape(-1, 3), face_colors=painted))
    assert len(mesh.vertices) == 3 * len(mesh.faces)
    with guide_of((corners, np.repeat(painted[:, None], 3, axis=1)), cameras(2)) as guide:
        ((level, _),) = lods(mesh, guide, (0.25,))
    assert len(level.faces) <= len(mesh.faces) // 4
    before, after = (face_areas(each.vertices, each.faces)[0].sum() for each in (mesh, level))
    assert 0.9 * before < after <= before
    assert level.vertex_colors is not None


@pytest.mark.parametrize("order", [(0, 1, 2), (1, 0, 2)])
def test_faces_that_share_nothing_are_a_soup_in_any_order(order: tuple[int, ...]) -> None:
    corners, _ = tiles(3)
    apart = corners + 9 * np.arange(len(corners), dtype=np.float32)[:, None, None]
    faces = np.arange(3 * len(corners)).reshape(-1, 3)[:, order]
    assert is_uncut_soup(apart.reshape(-1, 3), faces)
    assert not is_uncut_soup(ball(4).vertices, ball(4).faces)


@pytest.mark.slow
def test_a_closed_surface_stays_closed_and_keeps_its_colours() -> None:
    mesh = ball()
    seen = soup_of(mesh)
    corners, colors = seen.vertices.reshape(-1, 3, 3), seen.vertex_colors.reshape(-1, 3, 3)
    with guide_of((corners, colors), all_round(4, (-2, 2), 5), all_round(4, (1,), 3)) as guide:
        made = [level for level, _ in lods(mesh, guide, (0.5, 0.1))]
    for level, share in zip(made, (0.5, 0.1), strict=True):
        assert len(level.faces) <= share * len(mesh.faces)
        assert closed(level.vertices.astype(np.float64), level.faces)
        np.testing.assert_allclose(level.vertex_colors, colors_at(level.vertices), atol=0.15)
    assert screen_share(mesh, made[0]) > screen_share(mesh, made[1])


def test_so_few_faces_that_nothing_is_left_are_more() -> None:
    mesh = box((1, 2, 3))
    points, faces = simpler(mesh.vertices.astype(np.float64), mesh.faces, 1)
    assert closed(points, faces)


def test_an_open_surface_stays_manifold() -> None:
    half = ball()
    faces = half.faces[half.vertices[half.faces].mean(axis=1)[:, 2] > 0]
    points, made = simpler(half.vertices.astype(np.float64), faces, len(faces) // 4)
    assert 0 < len(made) <= len(faces) // 4
    assert not closed(points, made)
    edges = np.sort(made[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert np.unique(edges, axis=0, return_counts=True)[1].max() <= 2


@pytest.mark.slow
def test_the_share_of_the_screen_is_where_the_error_is_a_pixel() -> None:
    mesh, larger = ball(20), ball(20, radius=1.01)
    assert screen_share(mesh, mesh) == 1
    assert screen_share(mesh, larger) == pytest.approx(2 / (1080 * 0.01), rel=0.05)
    assert screen_share(mesh, larger, rows=540) == pytest.approx(2 / (540 * 0.01), rel=0.05)
    twice = together(mesh, Mesh(mesh.vertices + np.float32([2, 0, 0]), mesh.faces))
    assert screen_share(twice, together(twice, larger)) > screen_share(mesh, larger)

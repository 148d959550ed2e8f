"""Closed surfaces of soups: of a ball, of a square before a background, of what is hardly anything."""

from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.bake import settle, solid
from msb.bake import surface as made
from msb.bake.fusion import BEHIND, DOUBT, REACH, THICK, Depths, Grid
from msb.bake.lessons import Lessons
from msb.bake.simpler import closed
from msb.bake.space import EDGE, Space
from msb.bake.start import Guide
from msb.cl import Device
from msb.errors import AssetError
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render import Renderer
from msb.scenes import Camera
from msb.scenes.paths import unit_at
from msb.topology import audit_arrays
from msb.topology.crossings import crossing_pairs
from msb.topology.faces import signed_volume
from tests.bake import soups as solids
from tests.bake.fusion_twin import fused
from tests.bake.soups import BACKGROUND, Corners, cameras, guide_of, mesh_of, tiles


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Coarse grids and few steps."""
    monkeypatch.setattr(made, "CELLS", 48)
    monkeypatch.setattr(settle, "STEPS", 20)
    monkeypatch.setattr(settle, "LOOK", 10)


def around(count: int, distance: float = 4.0) -> list[Camera]:
    """Return cameras all around the origin, which look at it."""
    turn = np.arange(count) * 2.4
    height = np.linspace(-0.8, 0.8, count)
    level = np.sqrt(1 - height**2)
    places = distance * np.stack([level * np.cos(turn), height, level * np.sin(turn)], axis=1)
    return [Camera.look_at(place, (0, 0, 0), width=64, height=48, fov_y=0.7) for place in places]


def ball() -> tuple[Corners, Corners]:
    """Return corners and colours of about 500 faces of the unit ball."""
    soup = solids.soup_of(solids.ball(12))
    return soup.vertices.reshape(-1, 3, 3), soup.vertex_colors.reshape(-1, 3, 3)


def square(size: float, z: float) -> Corners:
    a, b, c, d = ((x * size, y * size, z) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return np.array([[a, b, c], [a, c, d]], np.float32)


def surface_of(
    corners: Corners, colors: Corners, seen_by: list[Camera], aside: list[Camera], faces: int = 400
) -> Mesh:
    with guide_of((corners, colors), seen_by, aside) as guide:
        return made.surface(mesh_of(corners, colors), guide, faces=faces)[0]


def depth_of(mesh: Mesh, camera: Camera) -> NDArray[np.float32]:
    with Renderer(asset_from_mesh(mesh), "standard") as renderer:
        return renderer.render(camera, BACKGROUND).depth


def check_solid(mesh: Mesh, *, inward: bool = False) -> None:
    """It is closed, manifold, wound outward or `inward`, no faces cross, and it has colours."""
    found, *_ = audit_arrays(mesh.vertices, mesh.faces)
    assert found.verdict == "ok"
    assert found.counts.boundary_edges == found.counts.inconsistent_winding_edges == 0
    assert len(crossing_pairs(mesh.vertices[mesh.faces].astype(np.float64))) == 0
    assert (signed_volume(mesh.vertices, mesh.faces) < 0) == inward
    assert mesh.vertex_colors.shape == mesh.vertices.shape


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
def test_a_ball_of_any_size_becomes_a_closed_ball_of_its_colours(scale: float) -> None:
    corners, colors = ball()
    taught, aside = (
        [replace(view, unit=unit_at(away * scale)) for view in around(count, away * scale)]
        for count, away in ((12, 4.0), (4, 4.2))
    )
    large = surface_of(np.float32(scale) * corners, colors, taught, aside)
    mesh = replace(large, vertices=large.vertices / np.float32(scale))
    check_solid(mesh)
    assert 300 < len(mesh.faces) <= 400
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1).max() < 0.1
    assert signed_volume(mesh.vertices, mesh.faces) == pytest.approx(4 / 3 * np.pi, rel=0.06)
    assert np.abs(mesh.vertex_colors - (0.5 + 0.4 * mesh.vertices)).mean() < 0.05


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("count", [1, 80])
def test_specks_that_came_off_are_left_out_and_missed_if_there_were_many(count: int) -> None:
    whole, speck = solids.ball(), solids.box((0.004, 0.004, 0.004))
    places = np.float32([1.2, 0, 0]) + np.arange(count, dtype=np.float32)[:, None] * np.float32([0, 0, 0.006])
    specks = [replace(speck, vertices=speck.vertices + place) for place in places]
    mesh = solids.together(whole, *specks)
    points, views = mesh.vertices.astype(np.float64), around(6)
    asked = len(mesh.faces) - 1
    with guide_of(ball(), views) as guide:
        whole = made.Solid(points, mesh.faces, Space.of(points, views))
        found, notes = made.taught(whole, asked, guide)
    check_solid(found)
    assert solid.parts(found.vertices, found.faces).max() == 0
    assert any("nobody sees" in note for note in notes) == (count > 1), notes


@pytest.mark.usefixtures("quick")
def test_a_square_before_a_far_wall_keeps_its_place_and_so_does_the_wall() -> None:
    corners, colors = tiles()
    wall = square(20, 10)
    soup = np.concatenate([corners, wall]), np.concatenate([colors, np.full_like(wall, 0.7)])
    mesh = surface_of(*soup, cameras(7), cameras(2), faces=3000)
    check_solid(mesh, inward=True)
    camera = cameras(1, 96, 72)[0]
    depths = [depth_of(each, camera) for each in (mesh, mesh_of(*soup))]
    near = (depths[1] > 0) & (depths[1] < 6)
    assert (depths[0] > 0).mean() > 0.95
    assert np.median(np.abs(depths[0] - depths[1])[near]) < 0.2  # cells are 0.12 wide
    far = (depths[1] > 6) & (depths[0] > 0)
    assert np.median(np.abs(depths[0][far] / depths[1][far] - 1)) < 0.15  # cells are 0.3 of it wide there


@pytest.mark.usefixtures("quick")
def test_the_sky_of_a_scene_is_a_shell_around_it() -> None:
    corners, colors = tiles(8)
    spread = corners * np.float32([40, 40, 1]) + np.float32([0, 0, 1])
    ground = spread @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32).T
    views = [
        Camera.look_at((4 * np.sin(a), -1.5, 4 * np.cos(a)), (0, 0, 0), width=48, height=36, fov_y=0.9)
        for a in np.arange(9) * 0.7
    ]
    mesh = surface_of(ground, colors, views[:7], views[7:], faces=3000)
    check_solid(mesh, inward=True)
    with Renderer(asset_from_mesh(mesh), "standard") as renderer:
        frame = renderer.render(views[0], BACKGROUND)
    assert (frame.depth > 0).all()
    np.testing.assert_allclose(np.median(frame.image[:4], axis=(0, 1)), BACKGROUND, atol=0.1)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("case", ["one view", "one face", "a flat square", "noise"])
def test_a_surface_is_a_solid_whatever_the_views_show(case: str) -> None:
    """One view of a ball, a single face, a flat square, and views that contradict each other."""
    corners, colors = ball()
    random = np.random.default_rng(0)

    def noise(camera: Camera) -> NDArray[np.float32]:
        return random.random((camera.height, camera.width, 3), np.float32)

    if case == "one view":
        check_solid(surface_of(corners, colors, around(12)[5:6], around(12)[5:6]))
    elif case == "one face":
        check_solid(surface_of(square(1, 0)[:1], np.full((1, 3, 3), 0.8, np.float32), around(8), around(2)))
    elif case == "a flat square":
        mesh = surface_of(*tiles(), cameras(5), cameras(2))
        check_solid(mesh)
        sides = np.ptp(mesh.vertices, axis=0)
        np.testing.assert_allclose(sides[:2], 2, atol=0.2)
        assert sides[2] < 0.4
    else:
        with Lessons(around(8), BACKGROUND, noise) as lessons, Lessons(around(2), BACKGROUND, noise) as aside:
            check_solid(made.surface(mesh_of(corners, colors), Guide(lessons, aside), faces=400)[0])


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_leaves_without_thickness_stay_whole() -> None:
    # Crossed sheets on a stick; cells are a 48th of them, and the stick is as thin as one.
    blade = square(0.5, 0) * np.float32([1, 1.8, 1])
    turned = blade[..., [2, 1, 0]]
    stick = square(1, 0) * np.float32([0.02, 0.9, 1])
    places = np.float32([[0.5, 0, 0], [0, 0, -0.5], [-0.1, 0, 0]])
    soup = np.concatenate([blade + places[0], turned + places[1], stick + places[2]])
    mesh = surface_of(soup, np.full_like(soup, 0.8), around(16), around(4), faces=1500)
    check_solid(mesh)
    for camera in around(3, 4.5):
        shown = [depth_of(each, camera) > 0 for each in (mesh, mesh_of(soup, np.full_like(soup, 0.8)))]
        assert (shown[0] & shown[1]).sum() / (shown[0] | shown[1]).sum() > 0.8


@pytest.mark.usefixtures("quick")
def test_it_ends_when_it_is_told_to_or_the_time_is_up_and_says_so() -> None:
    corners, colors = ball()
    steps: list[int] = []

    def watch(stage: str, done: int, _total: int) -> bool:
        steps.append(done)
        return stage == "moving vertices" and done == 3

    soup = mesh_of(corners, colors)
    with guide_of((corners, colors), around(8), around(2)) as guide:
        told, notes = made.surface(soup, replace(guide, watch=watch), faces=400)
        assert steps[-1] == 3
        assert any("3 of 20 steps" in note for note in notes), notes
        late, notes = made.surface(soup, guide, faces=400, seconds=0)
        assert any("1 of 20 steps" in note for note in notes), notes
    check_solid(told)
    check_solid(late)


def test_a_surface_needs_a_view_that_sees_something() -> None:
    corners, colors = tiles()
    away = [Camera.look_at((0, 0, -4), (0, 0, -8), width=48, height=36, fov_y=0.9)]
    with pytest.raises(AssetError) as caught:
        surface_of(corners, colors, away, away)
    assert caught.value.code == "TRIASSET_EMPTY"


@pytest.mark.parametrize("contracted", [False, True])
def test_views_vote_as_numpy_has_it(device: Device, contracted: bool) -> None:
    corners, colors = tiles()
    soup = mesh_of(*(np.concatenate(each) for each in zip((corners, colors), ball(), strict=True)))
    views = [*cameras(3), *around(6)]
    half = np.full(3, 1.9)
    space = Space(np.array([0.1, -0.2, 0.05]), 0.8, contracted, -half, half)
    grid = Grid.over(space, 14)
    with closing(Depths(soup, device)) as depths:
        drawn = [depths.render(camera, BACKGROUND).depth for camera in views]
        votes = depths.votes(views, space, grid)
    x, y, z = (grid.low[k] + grid.cell * np.arange(grid.shape[k]) for k in range(3))
    places = np.stack([each.reshape(-1) for each in np.meshgrid(x, y, z, indexing="ij")], axis=1)
    far = np.maximum(np.linalg.norm(places, axis=1), 1) if contracted else np.ones(len(places))
    cell = grid.cell * space.radius / np.maximum(2 - far, 0.01) ** 2
    twin = fused(space.outward(places), REACH * cell, BEHIND * cell, views, drawn, DOUBT, THICK / REACH)
    if contracted:  # what lies beyond a scene is not voted on
        twin[np.linalg.norm(places, axis=1) > EDGE + REACH * grid.cell] = np.nan
    twin = twin.reshape(grid.shape)
    same = np.isclose(votes, np.where(np.isnan(twin), 2, twin), atol=2e-3)
    assert same.mean() > 0.995  # a cell at the edge of a pixel may fall to its neighbour
    assert 0.02 < (twin < 0).mean() < 0.98


@pytest.mark.parametrize("contracted", [False, True])
def test_a_space_is_left_by_the_way_it_was_entered(contracted: bool) -> None:
    random = np.random.default_rng(0)
    space = Space(np.array([1.0, 2, 3]), 2.5, contracted, np.zeros(3), np.zeros(3))
    points = space.center + random.normal(size=(50, 3)) * 5
    inside = space.inward(points)
    np.testing.assert_allclose(space.outward(inside), points)
    weights = random.normal(size=3)
    moves = random.normal(size=inside.shape) * 1e-6
    change = (space.outward(inside + moves) - space.outward(inside - moves)) @ weights / 2
    slopes = space.pulled(inside, np.tile(weights, (50, 1)))
    np.testing.assert_allclose((slopes * moves).sum(axis=1), change, atol=1e-9)
    if contracted:
        assert (np.linalg.norm(inside, axis=1) < 2).all()


@pytest.mark.parametrize("wobble", [0, 1e-16, 0.01])
def test_cameras_that_turn_in_one_place_stand_amid_a_scene(wobble: float) -> None:
    random = np.random.default_rng(0)
    points = random.normal(size=(500, 3))
    points *= random.uniform(4, 6, size=(500, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    place = np.array([1.0, 2, 3])
    axes = [np.array([np.cos(turn), np.sin(turn), 0]) for turn in 2 * np.pi * np.arange(8) / 8]
    size: Any = {"up": (0, 0, 1), "width": 32, "height": 24, "fov_y": 0.9}
    views = [Camera.look_at(place + wobble * random.normal(size=3), place + axis, **size) for axis in axes]
    space = Space.of(place + points, views)
    assert space.contracted
    assert 2 < space.radius < 3


CUBE, SIDES = solids.box((1, 1, 1)).vertices.astype(float) + 0.5, solids.box((1, 1, 1)).faces


def unit_space(contracted: bool = False) -> Space:
    return Space(np.zeros(3), 1.0, contracted, np.zeros(3), np.zeros(3))


def test_what_is_not_closed_and_manifold_is_mended() -> None:
    # Two cubes that touch at an edge, a flap on one of them, and a hole in the other.
    points = np.concatenate([CUBE, CUBE + np.array([1, 1, 0]), [[0.5, -0.5, 0.5]]])
    faces = np.concatenate([SIDES[1:], SIDES + 8, [[0, 4, 16], [4, 0, 16]]])
    faces[faces == 8], faces[faces == 9] = 6, 7
    assert not closed(points, faces)
    mended, whole = solid.mended(points, faces)
    assert audit_arrays(mended.astype(np.float32), whole)[0].verdict == "ok"
    assert closed(mended, whole)
    assert len(whole) == 24
    assert len(np.unique(mended, axis=0)) == len(mended)


def test_no_face_is_without_area_where_cells_lie_on_the_surface() -> None:
    at = np.arange(9) - 4
    x, y, z = np.meshgrid(at, at, at, indexing="ij")
    values = (np.abs(x) + np.abs(y) + np.abs(z) - 3).astype(np.float32)
    assert (values == 0).sum() == 38
    points, faces = solid.boundary(values, Grid(np.full(3, -4.0), 1.0, values.shape), 1.0)
    assert closed(points, faces)
    sides = points[faces[:, 1:]] - points[faces[:, :1]]
    assert np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).min() > 1e-6
    np.testing.assert_allclose(np.abs(points).sum(axis=1), 3, atol=0.03)


def test_faces_that_cross_are_smoothed() -> None:
    space, mesh = unit_space(), solids.ball(8)
    points, faces = mesh.vertices.astype(float), mesh.faces
    assert len(solid.crossing_faces(points, faces, space)) == 0
    wrong = points.copy()
    wrong[7] *= -1.5
    assert len(solid.crossing_faces(wrong, faces, space)) > 0
    smoothed, same = solid.uncrossed(wrong, faces, space)
    np.testing.assert_array_equal(same, faces)
    assert len(solid.crossing_faces(smoothed, faces, space)) == 0


@pytest.mark.parametrize("contracted", [False, True])
def test_of_points_that_went_anywhere_none_stays_that_makes_faces_cross(contracted: bool) -> None:
    space, mesh = unit_space(contracted), solids.ball(12)
    points = mesh.vertices.astype(float)
    wrong = points + np.random.default_rng(0).normal(0, 0.1, points.shape)
    assert len(solid.crossing_faces(wrong, mesh.faces, space)) > 50
    back = solid.put_back(wrong, points, mesh.faces, space)
    assert len(solid.crossing_faces(back, mesh.faces, space)) == 0
    assert 0.1 < (back == wrong).all(axis=1).mean() < 0.9
    assert ((back == wrong) | (back == points)).all()


def test_slivers_are_smoothed() -> None:
    space, mesh = unit_space(), solids.ball(6)
    points = mesh.vertices.astype(float)
    one, two = mesh.faces[20, :2]
    points[one] = points[two] + 1e-4 * (points[one] - points[two])
    smoothed, faces = solid.uncrossed(points, mesh.faces, space)
    sides = smoothed[faces[:, 1:]] - smoothed[faces[:, :1]]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    assert area.min() > 1e-3 * np.median(area)

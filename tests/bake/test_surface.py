"""Closed surfaces of triangle soups, and the votes, coordinate spaces and repairs that make them."""

from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msb.bake import candidate_surface, closed_mesh, vertex_descent
from msb.bake.candidate_surface import ClosedSurface, make_surface, refit_surface
from msb.bake.context import SearchContext
from msb.bake.depth_fusion import BEHIND, MIN_SEEN_RATIO, REACH, THICKNESS, DepthRenderer, Grid
from msb.bake.images import ViewImages
from msb.bake.simplification import is_closed_surface
from msb.bake.space import EDGE, Space
from msb.cl import Device
from msb.errors import AssetError
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.render import Renderer
from msb.scenes import Camera
from msb.scenes.paths import unit_at
from msb.topology import audit_arrays
from msb.topology.crossings import find_crossing_pairs
from msb.topology.faces import signed_volume
from tests.bake.depth_fusion_twin import vote
from tests.bake.soups import (
    BACKGROUND,
    Corners,
    ball,
    ball_soup,
    box,
    cameras,
    mesh_of,
    open_context,
    tiles,
    together,
)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Use coarse grids and few steps."""
    monkeypatch.setattr(candidate_surface, "CELLS", 48)
    monkeypatch.setattr(vertex_descent, "STEPS", 20)
    monkeypatch.setattr(vertex_descent, "VALIDATION_STEPS", 10)


def around(count: int, distance: float = 4.0) -> list[Camera]:
    """Return cameras all around the origin that look at it."""
    turn = np.arange(count) * 2.4
    height = np.linspace(-0.8, 0.8, count)
    level = np.sqrt(1 - height**2)
    places = distance * np.stack([level * np.cos(turn), height, level * np.sin(turn)], axis=1)
    return [Camera.look_at(place, (0, 0, 0), width=64, height=48, fov_y=0.7) for place in places]


def square(size: float, z: float) -> Corners:
    a, b, c, d = ((x * size, y * size, z) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1)))
    return np.array([[a, b, c], [a, c, d]], np.float32)


def surface_of(
    corners: Corners, colors: Corners, training: list[Camera], validation: list[Camera], faces: int = 400
) -> Mesh:
    with open_context((corners, colors), training, validation) as context:
        return make_surface(mesh_of(corners, colors), context, faces=faces)[0]


def depth_of(mesh: Mesh, camera: Camera) -> NDArray[np.float32]:
    with Renderer(asset_from_mesh(mesh), "standard") as renderer:
        return renderer.render(camera, BACKGROUND).depth


def check_solid(mesh: Mesh, *, inward: bool = False) -> None:
    """Assert that a mesh is closed, manifold, coloured, without crossings, and wound outwards or `inward`."""
    audit, *_ = audit_arrays(mesh.vertices, mesh.faces)
    assert audit.verdict == ("limited" if inward else "ok")
    assert audit.counts.boundary_edges == audit.counts.inconsistent_winding_edges == 0
    assert len(find_crossing_pairs(mesh.vertices[mesh.faces].astype(np.float64))) == 0
    assert (signed_volume(mesh.vertices, mesh.faces) < 0) == inward
    assert mesh.vertex_colors.shape == mesh.vertices.shape


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("scale", [1.0, 1e-6, 1e6])
def test_a_ball_of_any_size_becomes_a_closed_ball_of_its_colours(scale: float) -> None:
    corners, colors = ball_soup()
    training, validation = (
        [replace(view, unit=unit_at(away * scale)) for view in around(count, away * scale)]
        for count, away in ((12, 4.0), (4, 4.2))
    )
    large = surface_of(np.float32(scale) * corners, colors, training, validation)
    mesh = replace(large, vertices=large.vertices / np.float32(scale))
    check_solid(mesh)
    assert 300 < len(mesh.faces) <= 400
    assert np.abs(np.linalg.norm(mesh.vertices, axis=1) - 1).max() < 0.1
    assert signed_volume(mesh.vertices, mesh.faces) == pytest.approx(4 / 3 * np.pi, rel=0.06)
    assert np.abs(mesh.vertex_colors - (0.5 + 0.4 * mesh.vertices)).mean() < 0.05


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("count", [1, 80])
def test_specks_are_removed_and_noted_if_there_are_many(count: int) -> None:
    speck = box((0.004, 0.004, 0.004))
    places = np.float32([1.2, 0, 0]) + np.arange(count, dtype=np.float32)[:, None] * np.float32([0, 0, 0.006])
    specks = [replace(speck, vertices=speck.vertices + place) for place in places]
    mesh = together(ball(), *specks)
    points, views = mesh.vertices.astype(np.float64), around(6)
    with open_context(ball_soup(), views) as context:
        whole = ClosedSurface(points, mesh.faces, Space.fit(points, views))
        surface, notes = refit_surface(whole, len(mesh.faces) - 1, context)
    check_solid(surface)
    assert closed_mesh.label_parts(surface.vertices, surface.faces).max() == 0
    assert any("unseen parts" in note for note in notes) == (count > 1), notes


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_a_square_and_the_far_wall_behind_it_keep_their_places() -> None:
    corners, colors = tiles()
    wall = square(20, 10)
    soup = np.concatenate([corners, wall]), np.concatenate([colors, np.full_like(wall, 0.7)])
    mesh = surface_of(*soup, cameras(7), cameras(2), faces=3000)
    check_solid(mesh, inward=True)
    camera = cameras(1, 96, 72)[0]
    depth, target = (depth_of(part, camera) for part in (mesh, mesh_of(*soup)))
    near = (target > 0) & (target < 6)
    assert (depth > 0).mean() > 0.95
    assert np.median(np.abs(depth - target)[near]) < 0.2  # cells are 0.12 wide
    far = (target > 6) & (depth > 0)
    assert np.median(np.abs(depth[far] / target[far] - 1)) < 0.15  # a cell there is 0.3 of the depth wide


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_the_sky_of_a_scene_is_a_shell_around_it() -> None:
    corners, colors = tiles(8)
    wide = corners * np.float32([40, 40, 1]) + np.float32([0, 0, 1])
    ground = wide @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32).T
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
def test_odd_views_give_a_solid(case: str) -> None:
    """One view of a ball, a single face, a flat square, and views that contradict each other."""
    corners, colors = ball_soup()
    random = np.random.default_rng(0)

    def draw_noise(camera: Camera) -> NDArray[np.float32]:
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
        training, validation = (ViewImages(around(count), BACKGROUND, draw_noise) for count in (8, 2))
        with training, validation:
            context = SearchContext(training, validation)
            check_solid(make_surface(mesh_of(corners, colors), context, faces=400)[0])


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_leaves_without_thickness_stay_whole() -> None:
    # Two crossed sheets on a stick. The grid has 48 cells along the longest side; the stick is as thin as a
    # cell.
    blade = square(0.5, 0) * np.float32([1, 1.8, 1])
    turned = blade[..., [2, 1, 0]]
    stick = square(1, 0) * np.float32([0.02, 0.9, 1])
    places = np.float32([[0.5, 0, 0], [0, 0, -0.5], [-0.1, 0, 0]])
    soup = np.concatenate([blade + places[0], turned + places[1], stick + places[2]])
    colors = np.full_like(soup, 0.8)
    mesh = surface_of(soup, colors, around(16), around(4), faces=1500)
    check_solid(mesh)
    for camera in around(3, 4.5):
        visible, target = (depth_of(part, camera) > 0 for part in (mesh, mesh_of(soup, colors)))
        assert (visible & target).sum() / (visible | target).sum() > 0.8


@pytest.mark.usefixtures("quick")
@pytest.mark.slow
def test_a_search_that_ends_early_has_a_note() -> None:
    corners, colors = ball_soup()
    steps: list[int] = []

    def progress(stage: str, done: int, _total: int) -> bool:
        steps.append(done)
        return stage == "moving vertices" and done == 3

    soup = mesh_of(corners, colors)
    with open_context((corners, colors), around(8), around(2)) as context:
        stopped, notes = make_surface(soup, replace(context, progress=progress), faces=400)
        assert steps[-1] == 3
        assert any("3 of 20 steps" in note for note in notes), notes
        late, notes = make_surface(soup, context, faces=400, seconds=0)
        assert any("1 of 20 steps" in note for note in notes), notes
    check_solid(stopped)
    check_solid(late)


def test_a_surface_needs_a_view_that_sees_the_soup() -> None:
    corners, colors = tiles()
    away = [Camera.look_at((0, 0, -4), (0, 0, -8), width=48, height=36, fov_y=0.9)]
    with pytest.raises(AssetError) as caught:
        surface_of(corners, colors, away, away)
    assert caught.value.code == "TRIASSET_EMPTY"


@pytest.mark.parametrize("contracted", [False, True])
def test_votes_agree_with_numpy(device: Device, contracted: bool) -> None:
    soup = mesh_of(*(np.concatenate(parts) for parts in zip(tiles(), ball_soup(), strict=True)))
    views = [*cameras(3), *around(6)]
    half = np.full(3, 1.9)
    space = Space(np.array([0.1, -0.2, 0.05]), 0.8, contracted, -half, half)
    grid = Grid.covering(space, 14)
    with closing(DepthRenderer(soup, device)) as renderer:
        depths = [renderer.render(camera, BACKGROUND).depth for camera in views]
        votes = renderer.vote(views, space, grid)
    x, y, z = (grid.low[k] + grid.cell * np.arange(grid.shape[k]) for k in range(3))
    places = np.stack([axis.reshape(-1) for axis in np.meshgrid(x, y, z, indexing="ij")], axis=1)
    far = np.maximum(np.linalg.norm(places, axis=1), 1) if contracted else np.ones(len(places))
    cell = grid.cell * space.radius / np.maximum(2 - far, 0.01) ** 2
    world = space.to_world(places)
    twin = vote(world, REACH * cell, BEHIND * cell, views, depths, MIN_SEEN_RATIO, THICKNESS / REACH)
    if contracted:  # no view votes beyond the edge of a scene
        twin[np.linalg.norm(places, axis=1) > EDGE + REACH * grid.cell] = np.nan
    twin = twin.reshape(grid.shape)
    is_equal = np.isclose(votes, np.where(np.isnan(twin), 2, twin), atol=2e-3)
    assert is_equal.mean() > 0.995  # rounding may move a cell at the edge of a pixel to the next pixel
    assert 0.02 < (twin < 0).mean() < 0.98


@pytest.mark.parametrize("contracted", [False, True])
def test_a_space_is_invertible(contracted: bool) -> None:
    random = np.random.default_rng(0)
    space = Space(np.array([1.0, 2, 3]), 2.5, contracted, np.zeros(3), np.zeros(3))
    points = space.center + random.normal(size=(50, 3)) * 5
    inside = space.from_world(points)
    np.testing.assert_allclose(space.to_world(inside), points)
    weights = random.normal(size=3)
    moves = random.normal(size=inside.shape) * 1e-6
    change = (space.to_world(inside + moves) - space.to_world(inside - moves)) @ weights / 2
    gradients = space.pull_back(inside, np.tile(weights, (50, 1)))
    np.testing.assert_allclose((gradients * moves).sum(axis=1), change, atol=1e-9)
    if contracted:
        assert (np.linalg.norm(inside, axis=1) < 2).all()


@pytest.mark.parametrize("wobble", [0, 1e-16, 0.01])
def test_cameras_that_turn_in_one_place_are_inside_a_scene(wobble: float) -> None:
    random = np.random.default_rng(0)
    points = random.normal(size=(500, 3))
    points *= random.uniform(4, 6, size=(500, 1)) / np.linalg.norm(points, axis=1, keepdims=True)
    place = np.array([1.0, 2, 3])
    axes = [np.array([np.cos(turn), np.sin(turn), 0]) for turn in 2 * np.pi * np.arange(8) / 8]
    size: Any = {"up": (0, 0, 1), "width": 32, "height": 24, "fov_y": 0.9}
    views = [Camera.look_at(place + wobble * random.normal(size=3), place + axis, **size) for axis in axes]
    space = Space.fit(place + points, views)
    assert space.contracted
    assert 2 < space.radius < 3


CUBE, SIDES = box((1, 1, 1)).vertices.astype(float) + 0.5, box((1, 1, 1)).faces


def unit_space(contracted: bool = False) -> Space:
    return Space(np.zeros(3), 1.0, contracted, np.zeros(3), np.zeros(3))


def test_a_repair_closes_holes_and_splits_touching_edges() -> None:
    # Make two cubes that touch at an edge. One of them has a flap, the other has a hole.
    points = np.concatenate([CUBE, CUBE + np.array([1, 1, 0]), [[0.5, -0.5, 0.5]]])
    faces = np.concatenate([SIDES[1:], SIDES + 8, [[0, 4, 16], [4, 0, 16]]])
    faces[faces == 8], faces[faces == 9] = 6, 7
    assert not is_closed_surface(points, faces)
    repaired, whole = closed_mesh.repair_closed(points, faces)
    assert audit_arrays(repaired.astype(np.float32), whole)[0].verdict == "ok"
    assert is_closed_surface(repaired, whole)
    assert len(whole) == 24
    assert len(np.unique(repaired, axis=0)) == len(repaired)


def test_votes_of_zero_make_no_face_without_area() -> None:
    at = np.arange(9) - 4
    x, y, z = np.meshgrid(at, at, at, indexing="ij")
    values = (np.abs(x) + np.abs(y) + np.abs(z) - 3).astype(np.float32)
    assert (values == 0).sum() == 38
    grid = Grid(np.full(3, -4.0), 1.0, values.shape)
    points, faces = closed_mesh.extract_boundary(values, grid, 1.0)
    assert is_closed_surface(points, faces)
    sides = points[faces[:, 1:]] - points[faces[:, :1]]
    assert np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).min() > 1e-6
    np.testing.assert_allclose(np.abs(points).sum(axis=1), 3, atol=0.03)


def test_crossing_faces_are_smoothed() -> None:
    space, mesh = unit_space(), ball(8)
    points, faces = mesh.vertices.astype(float), mesh.faces
    assert len(closed_mesh.find_crossing_faces(points, faces, space)) == 0
    wrong = points.copy()
    wrong[7] *= -1.5
    assert len(closed_mesh.find_crossing_faces(wrong, faces, space)) > 0
    smoothed, same = closed_mesh.remove_crossings(wrong, faces, space)
    np.testing.assert_array_equal(same, faces)
    assert len(closed_mesh.find_crossing_faces(smoothed, faces, space)) == 0


@pytest.mark.parametrize("contracted", [False, True])
def test_moves_that_make_faces_cross_are_reverted(contracted: bool) -> None:
    space, mesh = unit_space(contracted), ball(12)
    points = mesh.vertices.astype(float)
    wrong = points + np.random.default_rng(0).normal(0, 0.1, points.shape)
    assert len(closed_mesh.find_crossing_faces(wrong, mesh.faces, space)) > 50
    back = closed_mesh.revert_crossings(wrong, points, mesh.faces, space)
    assert len(closed_mesh.find_crossing_faces(back, mesh.faces, space)) == 0
    assert 0.1 < (back == wrong).all(axis=1).mean() < 0.9
    assert ((back == wrong) | (back == points)).all()


def test_slivers_are_smoothed() -> None:
    space, mesh = unit_space(), ball(6)
    points = mesh.vertices.astype(float)
    start, end = mesh.faces[20, :2]
    points[start] = points[end] + 1e-4 * (points[start] - points[end])
    smoothed, faces = closed_mesh.remove_crossings(points, mesh.faces, space)
    sides = smoothed[faces[:, 1:]] - smoothed[faces[:, :1]]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    assert area.min() > 1e-3 * np.median(area)

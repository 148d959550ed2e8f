"""Collision meshes: always something closed, that says what it is and how near it is to what is seen."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from msb.bake.collision import Collision, collision
from msb.bake.fusion import seen_points
from msb.bake.hulls import smallest_box
from msb.bake.needs import check_model
from msb.bake.options import BakeOptions
from msb.bake.space import Space
from msb.bake.written import Part, write_all
from msb.errors import MeshError, UsageError
from msb.meshes import read_mesh
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.meshes.mesh import Mesh
from msb.topology.components import label_components
from msb.topology.faces import signed_volume
from tests.bake.soups import all_round, ball, box, mesh_of, soup_of, sparse, tiles, together, torus
from tests.bake.test_views import MODELS

KINDS = ("mesh:100", "hulls:4")
TURN = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def checked(made: Collision) -> Collision:
    """Return what was made, once it is closed, wound outwards and float32."""
    assert msb.audit(made.mesh.vertices, made.mesh.faces).verdict == "ok"
    assert signed_volume(made.mesh.vertices, made.mesh.faces) > 0
    assert made.mesh.vertices.dtype == np.float32
    assert made.mean_distance >= 0
    assert 0 <= made.mid_air_share <= 1
    return made


def solids(made: Collision) -> list[NDArray[np.float64]]:
    """Return the planes (n, 4) of each convex part, outwards."""
    points, faces = made.mesh.vertices.astype(np.float64), made.mesh.faces
    ends = faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1)
    label = label_components(len(points), *ends)[1][faces[:, 0]]
    found = []
    for number in np.unique(label):
        corners = points[faces[label == number]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        found.append(np.column_stack([normal, -(normal * corners[:, 0]).sum(axis=1)]))
    return found


def test_a_box_is_found_as_it_is_turned() -> None:
    made = checked(collision(box((1, 2, 3), TURN), "box"))
    assert (made.kind, made.parts, len(made.mesh.faces), made.why) == ("box", 1, 12, "")
    assert signed_volume(made.mesh.vertices, made.mesh.faces) == pytest.approx(6, rel=1e-3)
    assert made.mean_distance < 1e-4
    assert made.mid_air_share == 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mesh:100", "hulls:4"])
def test_a_room_of_few_large_faces_has_a_shape(kind: str) -> None:
    """All of its corners are so far off that they are taken for the sky."""
    room = box((60, 60, 60))
    inside = Mesh(room.vertices, room.faces[:, ::-1].copy())
    made = collision(inside, kind, all_round(2, (-0.5, 0.5)))
    assert msb.audit(made.mesh.vertices, made.mesh.faces).verdict == "ok"


def test_a_closed_surface_gets_fewer_faces() -> None:
    made = checked(collision(ball(), "mesh:200"))
    assert (made.kind, made.parts, made.why) == ("mesh", 1, "")
    assert 100 < len(made.mesh.faces) <= 200
    assert made.mean_distance < 0.01
    assert made.mid_air_share < 0.05


def test_a_surface_whose_vertices_are_only_doubled_is_closed() -> None:
    assert collision(soup_of(ball()), "mesh:200").kind == "mesh"


@pytest.mark.slow
def test_an_open_mesh_gets_hulls_that_cover_it_and_says_why() -> None:
    whole = soup_of(ball())
    faces = whole.faces[whole.vertices[whole.faces].mean(axis=1)[:, 2] > -0.7]
    made = checked(collision(Mesh(whole.vertices, faces), "mesh:1000"))
    assert (made.kind, bool(made.why)) == ("hulls", True)
    assert 8 < made.parts <= 31
    assert len(made.mesh.faces) < 2000
    assert made.mean_distance < 0.02
    assert made.mid_air_share < 0.4  # the hulls' inner sides
    points = whole.vertices[faces].mean(axis=1)
    planes = solids(made)
    assert len(planes) == made.parts
    out = np.min([(points @ each[:, :3].T + each[:, 3]).max(axis=1) for each in planes], axis=0)
    assert out.max() < 0.07


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_what_cameras_see_of_a_soup_is_enclosed(size: float) -> None:
    whole = soup_of(ball())
    faces = whole.faces[whole.vertices[whole.faces].mean(axis=1)[:, 2] > -0.9]
    soup = Mesh(whole.vertices * np.float32(size), faces)
    views = [replace(camera, unit=size) for camera in all_round(3 * size, (-size, size))]
    made = checked(collision(soup, "mesh:500", views))
    assert (made.kind, made.parts, made.why) == ("mesh", 1, "")
    assert 400 < len(made.mesh.faces) <= 520
    assert made.mean_distance < 0.005
    assert made.mid_air_share < 0.05


@pytest.mark.slow
def test_the_bottom_of_a_plate_that_nobody_sees_is_near_it() -> None:
    plate = box((2, 2, 0.07))
    faces = plate.faces[plate.vertices[plate.faces].mean(axis=1)[:, 2] > -0.03]
    made = checked(collision(soup_of(Mesh(plate.vertices, faces)), "mesh:200", all_round(3, (1, 2))))
    assert made.kind == "mesh"
    assert made.mean_distance < 0.005
    assert made.mid_air_share < 0.05


@pytest.mark.slow
def test_of_a_scene_a_sheet_lies_behind_what_is_seen() -> None:
    """A bump on a large floor, seen from above it."""
    corners, _ = tiles(12)
    floor = 20 * corners.reshape(-1, 3)
    rises = np.exp(-np.square(floor[:, :2]).sum(axis=1, keepdims=True))
    floor[:, 2:] = rises.astype(np.float32)
    made = checked(collision(mesh_of(floor.reshape(-1, 3, 3), corners), "mesh:400", all_round(4, (2, 3))))
    assert (made.kind, made.why) == ("mesh", "")
    assert made.mean_distance < 0.005
    assert made.mid_air_share < 0.1
    assert np.abs(made.mesh.vertices).max() < 25  # no sky
    hulls = checked(collision(mesh_of(floor.reshape(-1, 3, 3), corners), "hulls:8", all_round(4, (2, 3))))
    assert hulls.kind == "hulls"
    assert "scene" in hulls.why


@pytest.mark.slow
def test_what_encloses_nothing_gets_hulls_and_says_why() -> None:
    """A face that cameras see from both sides, and one that none sees."""
    face = Mesh(np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    away = Mesh(face.vertices + np.float32([0, 0, 99]), face.faces)
    for mesh, why in ((face, "encloses nothing"), (away, "not closed")):
        made = checked(collision(mesh, "mesh:100", all_round(3, (-1, 1))))
        assert made.kind == "hulls"
        assert why in made.why
        assert made.mean_distance < 0.01


@pytest.mark.slow
def test_more_hulls_leave_less_in_mid_air() -> None:
    apart = Mesh(ball(8).vertices + np.float32([9, 0, 0]), ball(8).faces)
    two = together(ball(8), Mesh(apart.vertices, apart.faces[1:]))
    one, both = (checked(collision(two, f"hulls:{count}")) for count in (1, 2))
    assert (one.parts, both.parts) == (1, 2)
    assert one.mid_air_share > 0.5 > 0.05 > both.mid_air_share


@pytest.mark.slow
def test_without_the_time_for_a_solid_hulls_are_of_its_surface() -> None:
    made = checked(collision(ball(), "hulls:8", seconds=1e-3))
    assert made.kind == "hulls"
    assert made.parts == 8
    assert made.why


@pytest.mark.slow
def test_a_solid_is_cut_into_convex_parts() -> None:
    pytest.importorskip("coacd", reason="extra trial is not installed")
    made = checked(collision(torus(), "hulls:16", seconds=300))
    assert (made.kind, made.why) == ("hulls", "")
    assert 4 <= made.parts <= 16
    assert made.mean_distance < 0.02
    assert made.mid_air_share < 0.02


FACE = Mesh(np.float32([[0, 0, 0], [1, 0, 0], [0.3, 0.2, 0.9]]), np.array([[0, 1, 2]]))
FLAT = mesh_of(np.float32(1e-6) * tiles(3)[0], tiles(3)[1])
ODD = {
    "a face": FACE,
    "a tiny face": replace(FACE, vertices=FACE.vertices * np.float32(1e-6)),
    "a huge face": replace(FACE, vertices=FACE.vertices * np.float32(1e6)),
    "a tiny sheet": FLAT,
    "faces in one place": replace(FACE, vertices=np.ones((3, 3), np.float32)),
    "vertices of no face": Mesh(
        np.append(ball(8).vertices, [[np.nan, 0, 0], [9, 9, 9]], axis=0), ball(8).faces
    ),
}


@pytest.mark.parametrize("mesh", ODD.values(), ids=ODD)
@pytest.mark.parametrize("kind", ["box", *(pytest.param(each, marks=pytest.mark.slow) for each in KINDS)])
def test_odd_meshes_have_a_shape(mesh: Mesh, kind: str) -> None:
    made = checked(collision(mesh, kind))
    assert made.mean_distance < (0.1 if len(mesh.faces) > 100 else 0.01)
    used = np.abs(mesh.vertices[mesh.faces]).max()
    assert np.abs(made.mesh.vertices).max() < 2 * used


def test_boxes_look_outwards_however_they_are_turned() -> None:
    """A mesh without a hull has a box along its principal axes, which may be mirrored."""
    for seed in range(8):
        corners = np.random.default_rng(seed).normal(size=(3, 3))
        assert signed_volume(*smallest_box(corners)) > 0


def test_meshes_without_faces_or_finite_corners_are_rejected() -> None:
    for value, count, code in ((1.0, 0, "MESH_ARRAY"), (np.nan, 1, "MESH_NONFINITE")):
        mesh = Mesh(np.full((3, 3), value, np.float32), np.array([[0, 1, 2]])[:count])
        with pytest.raises(MeshError) as caught:
            collision(mesh, "box")
        assert caught.value.code == code


def test_only_a_mesh_that_no_repair_closes_needs_the_library_that_encloses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("msb.base.extras.is_installed", lambda name: name != "skimage")
    options = BakeOptions("kept", color="vertex", collision="mesh:12")
    cube = box((1, 1, 1))
    turned = cube.faces.copy()
    turned[0] = turned[0, ::-1]
    beside = together(cube, replace(cube, vertices=cube.vertices + np.float32([1, 1, 0])))
    for mesh in (replace(cube, faces=turned), beside):
        check_model(options, asset_from_mesh(mesh))
    with pytest.raises(UsageError) as caught:
        check_model(options, asset_from_mesh(replace(cube, faces=cube.faces[1:])))
    assert caught.value.code == "EXTRA_MISSING"


@pytest.mark.slow
def test_a_stage_has_each_part_that_it_collides_as_and_draws_none(tmp_path: Path) -> None:
    pxr = pytest.importorskip("pxr", reason="usd-core, of the extra usd, is not installed")
    from pxr import Usd, UsdGeom, UsdPhysics

    del pxr
    seen = together(box((1, 1, 1)), ball(8))
    shape = collision(seen, "hulls:2", seconds=1e-3)
    path = tmp_path / "a.usdc"
    part = Part("", asset_from_mesh(seen), {}, asset_from_mesh(shape.mesh), is_convex=True)
    write_all([part], [path])
    stage = Usd.Stage.Open(str(path))
    guides = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert len(guides) == shape.parts
    for prim in guides:
        assert UsdGeom.Imageable(prim).ComputePurpose() == "guide"
        assert UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() == "convexHull"
    assert len(read_mesh(path).faces) == len(seen.faces)


Reals = NDArray[np.float64]
HALF = 0.08
"""Of the box, as everything here in the unit in which what is seen is placed."""
THICK = 0.03
SECONDS, STEP, STILL = 30, 0.002, 0.02
"""At most, and those of a step; how far a box may creep in a second that is at rest."""
ROUGH = {"friction": [2, 0.1, 0.1], "condim": 6}


def resting(mesh: Mesh, shape: Mesh, kind: str, unit: float, middle: Reals, up: Reals) -> tuple[float, float]:
    """Return how far above what is seen a box rests that falls onto the shape over its middle, and how fast
    it still is; lengths are of `unit`. It may creep off a stone first, and tumble."""
    mujoco: Any = pytest.importorskip("mujoco", reason="extra test is not installed")
    seen, solid = ((each.vertices.astype(np.float64) - middle) / unit for each in (mesh, shape))
    across = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    sides = across, np.cross(up, across)
    spots = [HALF * (i * sides[0] + j * sides[1]) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    top = max(height(spot, up, seen[mesh.faces]) for spot in spots)
    spec = mujoco.MjSpec()
    spec.option.gravity, spec.option.timestep = -9.81 * up, STEP
    for number, points in enumerate(convex(solid, shape.faces, kind)):
        spec.add_mesh(
            name=str(number),
            uservert=points.reshape(-1),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX,
        )
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=str(number), **ROUGH)
    falling = spec.worldbody.add_body(pos=up * (top + 2 * HALF))
    falling.add_freejoint()
    falling.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[HALF] * 3, **ROUGH)
    model = spec.compile()
    state = mujoco.MjData(model)
    for _ in range(SECONDS):
        before = state.qpos[:3].copy()
        mujoco.mj_step(model, state, round(1 / STEP))
        if np.linalg.norm(state.qpos[:3] - before) < STILL:
            break
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, state.qpos[3:7])
    along = np.linspace(-1, 1, 7)
    surface = [(x, y, z) for x in along for y in along for z in along if max(abs(x), abs(y), abs(z)) == 1]
    points = state.qpos[:3] + HALF * np.array(surface) @ turn.reshape(3, 3).T
    gaps = [point @ up - height(point, up, seen[mesh.faces]) for point in points]
    return float(min(gaps)), float(np.linalg.norm(state.qvel))


def height(place: Reals, up: Reals, corners: Reals) -> float:
    """Return how high the highest face above or below a place is, -inf without one."""
    a, b, c = corners.transpose(1, 0, 2)
    one, two = b - a, c - a
    across = np.cross(up, two)
    area = (one * across).sum(axis=1)
    there = np.abs(area) > 1e-15
    area = np.where(there, area, 1)
    away = place - a
    u = (away * across).sum(axis=1) / area
    turned = np.cross(away, one)
    v = (turned @ up) / area
    there &= (u >= 0) & (v >= 0) & (u + v <= 1)
    along = (two * turned).sum(axis=1) / area
    return float((place @ up + along[there]).max(initial=-np.inf))


def convex(points: Reals, faces: NDArray[np.int64], kind: str) -> list[Reals]:
    """Return the corners of convex solids that make up a shape."""
    if kind != "mesh":
        ends = faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1)
        label = label_components(len(points), *ends)[1]
        return [points[label == number] for number in np.unique(label[faces])]
    corners = points[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1)
    return [
        np.concatenate([own, own - THICK * out / length])
        for own, out, length in zip(corners, normal, size, strict=True)
        if length > 1e-9
    ]


def pebble() -> Mesh:
    """Return a soup like a flat pebble, which is not closed below."""
    whole = ball()
    faces = whole.faces[whole.vertices[whole.faces].mean(axis=1)[:, 2] > -0.7]
    return soup_of(Mesh(whole.vertices * np.float32([1, 1, 0.5]), faces))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mesh:300", "hulls:8", "box"])
def test_a_box_rests_on_what_is_seen(kind: str) -> None:
    mesh = pebble()
    made = collision(mesh, kind, all_round(3, (0.5, 2)), seconds=1e-3)
    assert made.kind == kind.partition(":")[0]
    above, speed = resting(mesh, made.mesh, made.kind, 1.0, np.zeros(3), np.array([0.0, 0.0, 1.0]))
    assert abs(above) < 0.05
    assert speed < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "geometry"), [("nerf_synthetic/pebble", "kept"), ("mipnerf360/pebble", "fitted")]
)
def test_a_box_rests_on_a_trained_model(scene: str, geometry: Any) -> None:
    model = MODELS / ("pebble" if "synthetic" in scene else "walled") / "two_dts"
    views = sparse(scene, "two_dts")
    baked = msb.bake(model, scene=views, geometry=geometry, seconds=0, collision="mesh:1000")
    said, shape = baked.report.collision, baked.collision
    assert said.kind == "mesh"
    assert said.mean_distance < 0.005
    assert said.mid_air_share < 0.1
    seen = mesh_from_asset(baked.asset)
    space = Space.of(seen_points(seen, views.train, None), views.train)
    up = (1 if seen.up[0] == "+" else -1) * np.eye(3)["xyz".index(seen.up[1])]
    above, speed = resting(seen, mesh_from_asset(shape), said.kind, space.radius, space.center, up)
    assert abs(above) < 0.1
    assert speed < 0.1

"""Collision meshes: always something closed, that says what it is and how near it is to what is seen."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from msb.bake.collision import Collision, collision
from msb.bake.hulls import smallest_box
from msb.bake.needs import check_model
from msb.bake.options import BakeOptions
from msb.bake.written import Part, write_all
from msb.errors import MeshError, UsageError
from msb.meshes import read_mesh
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.topology.components import label_components
from msb.topology.faces import signed_volume
from tests.bake.soups import MODELS, all_round, ball, box, mesh_of, soup_of, sparse, tiles, together, torus

KINDS = ("mesh:100", "hulls:4")
TURN = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def checked(made: Collision, kind: str = "", distance: float = 1.0, mid_air: float = 1.0) -> Collision:
    """Return what was made, once it is closed, wound outwards, float32, of this kind and within bounds."""
    assert made.kind == (kind or made.kind)
    assert msb.audit(made.mesh.vertices, made.mesh.faces).verdict == "ok"
    assert signed_volume(made.mesh.vertices, made.mesh.faces) > 0
    assert made.mesh.vertices.dtype == np.float32
    assert 0 <= made.mean_distance < distance
    assert 0 <= made.mid_air_share <= mid_air
    return made


def labels(mesh: Mesh) -> NDArray[np.int32]:
    """Return the number of the part (V,) that each vertex belongs to."""
    faces = mesh.faces
    return label_components(len(mesh.vertices), faces[:, :2].reshape(-1), faces[:, 1:].reshape(-1))[1]


def solids(made: Collision) -> list[NDArray[np.float64]]:
    """Return the planes (n, 4) of each convex part, outwards."""
    points, faces = made.mesh.vertices.astype(np.float64), made.mesh.faces
    label = labels(made.mesh)[faces[:, 0]]
    found = []
    for number in np.unique(label):
        corners = points[faces[label == number]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        found.append(np.column_stack([normal, -(normal * corners[:, 0]).sum(axis=1)]))
    return found


def test_a_box_is_found_as_it_is_turned() -> None:
    made = checked(collision(box((1, 2, 3), TURN), "box"), "box", 1e-4, 0)
    assert (made.parts, len(made.mesh.faces), made.why) == (1, 12, "")
    assert signed_volume(made.mesh.vertices, made.mesh.faces) == pytest.approx(6, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mesh:100", "hulls:4"])
def test_a_room_of_few_large_faces_has_a_shape(kind: str) -> None:
    """All of its corners are so far off that they are taken for the sky."""
    room = box((60, 60, 60))
    inside = Mesh(room.vertices, room.faces[:, ::-1].copy())
    made = collision(inside, kind, all_round(2, (-0.5, 0.5)))
    assert msb.audit(made.mesh.vertices, made.mesh.faces).verdict == "ok"


def test_a_closed_surface_gets_fewer_faces() -> None:
    for mesh in (ball(), soup_of(ball())):  # one whose vertices are only doubled is closed, too
        made = checked(collision(mesh, "mesh:200"), "mesh", 0.01, 0.05)
        assert (made.parts, made.why) == (1, "")
        assert 100 < len(made.mesh.faces) <= 200


@pytest.mark.slow
def test_an_open_mesh_gets_hulls_that_cover_it_and_says_why() -> None:
    whole = soup_of(ball())
    faces = whole.faces[whole.vertices[whole.faces].mean(axis=1)[:, 2] > -0.7]
    # The hulls' inner sides are in mid-air.
    made = checked(collision(Mesh(whole.vertices, faces), "mesh:1000"), "hulls", 0.02, 0.4)
    assert made.why
    assert 8 < made.parts <= 31
    assert len(made.mesh.faces) < 2000
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
    made = checked(collision(soup, "mesh:500", views), "mesh", 0.005, 0.05)
    assert (made.parts, made.why) == (1, "")
    assert 400 < len(made.mesh.faces) <= 520


@pytest.mark.slow
def test_the_bottom_of_a_plate_that_nobody_sees_is_near_it() -> None:
    plate = box((2, 2, 0.07))
    faces = plate.faces[plate.vertices[plate.faces].mean(axis=1)[:, 2] > -0.03]
    views = all_round(3, (1, 2))
    checked(collision(soup_of(Mesh(plate.vertices, faces)), "mesh:200", views), "mesh", 0.005, 0.05)


@pytest.mark.slow
def test_of_a_scene_a_sheet_lies_behind_what_is_seen() -> None:
    """A bump on a large floor, seen from above it."""
    corners, _ = tiles(12)
    floor = 20 * corners.reshape(-1, 3)
    rises = np.exp(-np.square(floor[:, :2]).sum(axis=1, keepdims=True))
    floor[:, 2:] = rises.astype(np.float32)
    mesh, views = mesh_of(floor.reshape(-1, 3, 3), corners), all_round(4, (2, 3))
    made = checked(collision(mesh, "mesh:400", views), "mesh", 0.005, 0.1)
    assert not made.why
    assert np.abs(made.mesh.vertices).max() < 25  # no sky
    assert "scene" in checked(collision(mesh, "hulls:8", views), "hulls").why


@pytest.mark.slow
def test_what_encloses_nothing_gets_hulls_and_says_why() -> None:
    """A face that cameras see from both sides, and one that none sees."""
    face = Mesh(np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    away = Mesh(face.vertices + np.float32([0, 0, 99]), face.faces)
    for mesh, why in ((face, "encloses nothing"), (away, "not closed")):
        made = checked(collision(mesh, "mesh:100", all_round(3, (-1, 1))), "hulls", 0.01)
        assert why in made.why


@pytest.mark.slow
def test_more_hulls_leave_less_in_mid_air() -> None:
    apart = Mesh(ball(8).vertices + np.float32([9, 0, 0]), ball(8).faces)
    two = together(ball(8), Mesh(apart.vertices, apart.faces[1:]))
    one, both = (checked(collision(two, f"hulls:{count}")) for count in (1, 2))
    assert (one.parts, both.parts) == (1, 2)
    assert one.mid_air_share > 0.5 > 0.05 > both.mid_air_share


@pytest.mark.slow
def test_without_the_time_for_a_solid_hulls_are_of_its_surface() -> None:
    made = checked(collision(ball(), "hulls:8", seconds=1e-3), "hulls")
    assert (made.parts, bool(made.why)) == (8, True)


@pytest.mark.slow
def test_a_solid_is_cut_into_convex_parts() -> None:
    pytest.importorskip("coacd", reason="extra trial is not installed")
    made = checked(collision(torus(), "hulls:16", seconds=300), "hulls", 0.02, 0.02)
    assert 4 <= made.parts <= 16
    assert not made.why


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


def pebble() -> Mesh:
    """Return a soup of the part of a flat ellipsoid, half as high as wide, that lies above z = -0.35."""
    whole = ball()
    faces = whole.faces[whole.vertices[whole.faces].mean(axis=1)[:, 2] > -0.7]
    return soup_of(Mesh(whole.vertices * np.float32([1, 1, 0.5]), faces))


def convex(shape: Mesh, kind: str) -> list[NDArray[np.float64]]:
    """Return the corners of convex solids that make up a shape: its parts, or 0.03 thick faces of a mesh."""
    if kind != "mesh":
        label = labels(shape)
        return [shape.vertices[label == number] for number in np.unique(label[shape.faces])]
    corners = shape.vertices[shape.faces].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return list(np.concatenate([corners, corners - 0.03 * normal[:, None]], axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mesh:300", "hulls:8", "box"])
def test_a_box_rests_on_what_is_seen(kind: str) -> None:
    """A box, 0.16 wide, falls onto the shape in a simulator and comes to rest at the visible surface."""
    mujoco: Any = pytest.importorskip("mujoco", reason="extra test is not installed")
    made = collision(pebble(), kind, all_round(3, (0.5, 2)), seconds=1e-3)
    assert made.kind == kind.partition(":")[0]
    rough = {"friction": [2, 0.1, 0.1], "condim": 6}
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.002
    inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    for number, points in enumerate(convex(made.mesh, made.kind)):
        spec.add_mesh(name=str(number), uservert=np.float64(points).reshape(-1), inertia=inertia)
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=str(number), **rough)
    falling = spec.worldbody.add_body(pos=[0, 0, 0.66])
    falling.add_freejoint()
    falling.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.08] * 3, **rough)
    model = spec.compile()
    state = mujoco.MjData(model)
    mujoco.mj_step(model, state, 5000)  # 10 s
    assert np.linalg.norm(state.qvel) < 0.1
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, state.qpos[3:7])
    corners = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    x, y, z = (state.qpos[:3] + 0.08 * corners @ turn.reshape(3, 3).T).T
    assert abs((z - 0.5 * np.sqrt(1 - x**2 - y**2)).min()) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "geometry"), [("nerf_synthetic/pebble", "kept"), ("mipnerf360/pebble", "fitted")]
)
def test_the_shape_of_a_trained_model_is_near_it(scene: str, geometry: Any) -> None:
    model = MODELS / ("pebble" if "synthetic" in scene else "walled") / "two_dts"
    views = sparse(scene, "two_dts")
    baked = msb.bake(model, scene=views, geometry=geometry, seconds=0, collision="mesh:1000")
    said = baked.report.collision
    assert said.kind == "mesh"
    assert said.mean_distance < 0.005
    assert said.mid_air_share < 0.1

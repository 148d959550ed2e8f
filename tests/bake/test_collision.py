"""Collision shapes: always closed, with a correct kind and distance to the visible surface."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from msb.bake.collision import Collision, make_collision
from msb.bake.options import BakeOptions
from msb.bake.output_files import OutputAsset, write_assets
from msb.bake.requirements import check_model
from msb.delivery.hulls import fit_box
from msb.errors import MeshError, UsageError
from msb.meshes import read_mesh
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.topology import audit_arrays
from msb.topology.components import label_components
from msb.topology.faces import signed_volume
from tests.bake.soups import (
    MODELS,
    all_round,
    ball,
    box,
    mesh_of,
    soup_of,
    sparse,
    tiles,
    together,
    torus,
    upper_part,
)

KINDS = ("mesh:100", "hulls:4")
TURN = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def check(shape: Collision, kind: str = "", distance: float = 1.0, mid_air: float = 1.0) -> Collision:
    """Assert that a shape is of this kind, closed, wound outwards, float32 and within bounds; return it."""
    assert shape.kind == (kind or shape.kind)
    # Hulls may overlap each other, and the back of a sheet may cross itself.
    assert audit_arrays(shape.mesh.vertices, shape.mesh.faces, check_crossings=False)[0].verdict == "ok"
    assert signed_volume(shape.mesh.vertices, shape.mesh.faces) > 0
    assert shape.mesh.vertices.dtype == np.float32
    assert 0 <= shape.mean_distance < distance
    assert 0 <= shape.mid_air_share <= mid_air
    return shape


def label_parts(mesh: Mesh) -> NDArray[np.int32]:
    """Return the number of the part (V,) that each vertex belongs to."""
    faces = mesh.faces
    return label_components(len(mesh.vertices), faces[:, :2].reshape(-1), faces[:, 1:].reshape(-1))[1]


def outward_planes(shape: Collision) -> list[NDArray[np.float64]]:
    """Return the planes (n, 4) of each convex part, normals outwards."""
    points, faces = shape.mesh.vertices.astype(np.float64), shape.mesh.faces
    label = label_parts(shape.mesh)[faces[:, 0]]
    planes = []
    for number in np.unique(label):
        corners = points[faces[label == number]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        planes.append(np.column_stack([normal, -(normal * corners[:, 0]).sum(axis=1)]))
    return planes


def test_a_turned_box_is_found() -> None:
    shape = check(make_collision(box((1, 2, 3), TURN), "box"), "box", 1e-4, 0)
    assert (shape.parts, len(shape.mesh.faces), shape.why) == (1, 12, "")
    assert signed_volume(shape.mesh.vertices, shape.mesh.faces) == pytest.approx(6, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_room_of_few_large_faces_has_a_shape(kind: str) -> None:
    """All corners of the room are so far away that they count as sky."""
    room = box((60, 60, 60))
    inside = Mesh(room.vertices, room.faces[:, ::-1].copy())
    shape = make_collision(inside, kind, all_round(2, (-0.5, 0.5)))
    assert msb.audit(shape.mesh.vertices, shape.mesh.faces).verdict == "ok"


@pytest.mark.parametrize("mesh", [ball(), soup_of(ball())], ids=["connected", "doubled vertices"])
def test_a_closed_surface_gets_fewer_faces(mesh: Mesh) -> None:
    shape = check(make_collision(mesh, "mesh:200"), "mesh", 0.01, 0.05)
    assert (shape.parts, shape.why) == (1, "")
    assert 100 < len(shape.mesh.faces) <= 200


@pytest.mark.slow
def test_an_open_mesh_gets_hulls_that_cover_it() -> None:
    mesh = upper_part(soup_of(ball()), -0.7)
    # The inner sides of the hulls protrude.
    shape = check(make_collision(mesh, "mesh:1000"), "hulls", 0.02, 0.4)
    assert shape.why
    assert 8 < shape.parts <= 31
    assert len(shape.mesh.faces) < 2000
    planes = outward_planes(shape)
    assert len(planes) == shape.parts
    points = mesh.vertices[mesh.faces].mean(axis=1)
    outside = np.min([(points @ part[:, :3].T + part[:, 3]).max(axis=1) for part in planes], axis=0)
    assert outside.max() < 0.07


@pytest.mark.slow
@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
def test_the_visible_part_of_a_soup_is_enclosed(size: float) -> None:
    mesh = upper_part(soup_of(ball()), -0.9)
    soup = replace(mesh, vertices=mesh.vertices * np.float32(size))
    views = [replace(camera, unit=size) for camera in all_round(3 * size, (-size, size))]
    shape = check(make_collision(soup, "mesh:500", views), "mesh", 0.005, 0.05)
    assert (shape.parts, shape.why) == (1, "")
    assert 400 < len(shape.mesh.faces) <= 520


@pytest.mark.slow
def test_the_unseen_bottom_of_a_plate_does_not_protrude() -> None:
    plate = soup_of(upper_part(box((2, 2, 0.07)), -0.03))
    check(make_collision(plate, "mesh:200", all_round(3, (1, 2))), "mesh", 0.005, 0.05)


@pytest.mark.slow
def test_a_scene_gets_a_sheet_behind_the_visible_surface() -> None:
    """A bump on a large floor, seen from above."""
    corners, _ = tiles(12)
    floor = 20 * corners.reshape(-1, 3)
    rises = np.exp(-np.square(floor[:, :2]).sum(axis=1, keepdims=True))
    floor[:, 2:] = rises.astype(np.float32)
    mesh, views = mesh_of(floor.reshape(-1, 3, 3), corners), all_round(4, (2, 3))
    shape = check(make_collision(mesh, "mesh:400", views), "mesh", 0.005, 0.1)
    assert not shape.why
    assert np.abs(shape.mesh.vertices).max() < 25  # no sky
    assert "scene" in check(make_collision(mesh, "hulls:8", views), "hulls").why


@pytest.mark.slow
def test_a_mesh_that_encloses_nothing_gets_hulls() -> None:
    """Test a face that cameras see from both sides, and a face that no camera sees."""
    face = Mesh(np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    away = Mesh(face.vertices + np.float32([0, 0, 99]), face.faces)
    for mesh, why in ((face, "encloses nothing"), (away, "not closed")):
        assert why in check(make_collision(mesh, "mesh:100", all_round(3, (-1, 1))), "hulls", 0.01).why


@pytest.mark.slow
def test_more_hulls_protrude_less() -> None:
    apart = Mesh(ball(8).vertices + np.float32([9, 0, 0]), ball(8).faces[1:])
    two = together(ball(8), apart)
    single, both = (check(make_collision(two, f"hulls:{count}")) for count in (1, 2))
    assert (single.parts, both.parts) == (1, 2)
    assert single.mid_air_share > 0.5 > 0.05 > both.mid_air_share


@pytest.mark.slow
def test_without_time_for_coacd_hulls_of_patches_are_used() -> None:
    shape = check(make_collision(ball(), "hulls:8", seconds=1e-3), "hulls")
    assert (shape.parts, bool(shape.why)) == (8, True)


@pytest.mark.slow
def test_a_solid_is_cut_into_convex_parts() -> None:
    pytest.importorskip("coacd", reason="extra trial is not installed")
    shape = check(make_collision(torus(), "hulls:16", seconds=300), "hulls", 0.02, 0.02)
    assert 4 <= shape.parts <= 16
    assert not shape.why


FACE = Mesh(np.float32([[0, 0, 0], [1, 0, 0], [0.3, 0.2, 0.9]]), np.array([[0, 1, 2]]))
ODD = {
    "a face": FACE,
    "a tiny face": replace(FACE, vertices=FACE.vertices * np.float32(1e-6)),
    "a huge face": replace(FACE, vertices=FACE.vertices * np.float32(1e6)),
    "a tiny sheet": mesh_of(np.float32(1e-6) * tiles(3)[0], tiles(3)[1]),
    "faces in one place": replace(FACE, vertices=np.ones((3, 3), np.float32)),
    "vertices of no face": Mesh(
        np.append(ball(8).vertices, [[np.nan, 0, 0], [9, 9, 9]], axis=0), ball(8).faces
    ),
}


@pytest.mark.parametrize("mesh", ODD.values(), ids=ODD)
@pytest.mark.parametrize("kind", ["box", *(pytest.param(kind, marks=pytest.mark.slow) for kind in KINDS)])
def test_odd_meshes_have_a_shape(mesh: Mesh, kind: str) -> None:
    shape = check(make_collision(mesh, kind))
    assert shape.mean_distance < (0.1 if len(mesh.faces) > 100 else 0.01)
    used = np.abs(mesh.vertices[mesh.faces]).max()
    assert np.abs(shape.mesh.vertices).max() < 2 * used


def test_boxes_are_wound_outwards_in_mirrored_frames() -> None:
    """A mesh without a hull has a box along its principal axes, which may be mirrored."""
    for seed in range(8):
        corners = np.random.default_rng(seed).normal(size=(3, 3))
        assert signed_volume(*fit_box(corners)) > 0


def test_meshes_without_faces_or_finite_corners_are_rejected() -> None:
    for value, count, code in ((1.0, 0, "MESH_ARRAY"), (np.nan, 1, "MESH_NONFINITE")):
        mesh = Mesh(np.full((3, 3), value, np.float32), np.array([[0, 1, 2]])[:count])
        with pytest.raises(MeshError) as caught:
            make_collision(mesh, "box")
        assert caught.value.code == code


def test_only_meshes_that_repairs_leave_open_need_an_enclosure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("msb.base.extras.is_installed", lambda name: name != "skimage")
    options = BakeOptions("kept", color="vertex", collision="mesh:12")
    cube = box((1, 1, 1))
    turned = cube.faces.copy()
    turned[0] = turned[0, ::-1]
    touching = together(cube, replace(cube, vertices=cube.vertices + np.float32([1, 1, 0])))
    for mesh in (replace(cube, faces=turned), touching):
        check_model(options, asset_from_mesh(mesh))
    with pytest.raises(UsageError) as caught:
        check_model(options, asset_from_mesh(replace(cube, faces=cube.faces[1:])))
    assert caught.value.code == "EXTRA_MISSING"


@pytest.mark.slow
def test_a_usd_stage_has_each_part_as_an_invisible_collider(tmp_path: Path) -> None:
    pytest.importorskip("pxr", reason="usd-core, of the extra usd, is not installed")
    from pxr import Usd, UsdGeom, UsdPhysics

    drawn = together(box((1, 1, 1)), ball(8))
    shape = make_collision(drawn, "hulls:2", seconds=1e-3)
    path = tmp_path / "a.usdc"
    collision = asset_from_mesh(shape.mesh)
    write_assets([OutputAsset("", asset_from_mesh(drawn), {}, collision, is_convex=True)], [path])
    stage = Usd.Stage.Open(str(path))
    colliders = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert len(colliders) == shape.parts
    for prim in colliders:
        assert UsdGeom.Imageable(prim).ComputePurpose() == "guide"
        assert UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() == "convexHull"
    assert len(read_mesh(path).faces) == len(drawn.faces)


def convex_corners(shape: Collision) -> list[NDArray[np.float64]]:
    """Return the corners of the convex solids of a shape.

    They are its parts, or its faces with a thickness of 0.03.
    """
    mesh = shape.mesh
    if shape.kind != "mesh":
        label = label_parts(mesh)
        return [mesh.vertices[label == number] for number in np.unique(label[mesh.faces])]
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return list(np.concatenate([corners, corners - 0.03 * normal[:, None]], axis=1))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mesh:300", "hulls:8", "box"])
def test_a_simulated_box_rests_on_the_visible_surface(kind: str) -> None:
    """A box of side 0.16 falls on the shape of an open ellipsoid and comes to rest on the ellipsoid."""
    mujoco: Any = pytest.importorskip("mujoco", reason="extra test is not installed")
    flat = Mesh(ball().vertices * np.float32([1, 1, 0.5]), ball().faces)
    pebble = upper_part(soup_of(flat), -0.35)
    shape = check(make_collision(pebble, kind, all_round(3, (0.5, 2)), seconds=1e-3), kind.split(":")[0])
    rough = {"friction": [2, 0.1, 0.1], "condim": 6}
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.002
    inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    for number, points in enumerate(convex_corners(shape)):
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
    report = baked.report.collision
    assert report.kind == "mesh"
    assert report.mean_distance < 0.005
    assert report.mid_air_share < 0.1

"""A box that falls onto a collision shape in a physics engine comes to rest on what is seen.

The engine takes convex shapes: each part of hulls as it is, and each face of a mesh as a prism behind it.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from msb.bake.collision import collision
from msb.bake.fusion import seen_points
from msb.bake.space import Space
from msb.meshes.assets import mesh_from_asset
from msb.meshes.mesh import Mesh
from msb.topology.components import label_components
from tests.bake.soups import all_round, ball, soup_of, sparse

mujoco: Any = pytest.importorskip("mujoco", reason="extra test is not installed")
Reals = NDArray[np.float64]
MODELS = Path(__file__).parents[2] / "data_stubs/models"
HALF = 0.08
"""Of the box, as everything here in the unit in which what is seen is placed."""
THICK = 0.03
SECONDS, STEP, STILL = 30, 0.002, 0.02
"""At most, and those of a step; how far a box may creep in a second that is at rest."""
ROUGH = {"friction": [2, 0.1, 0.1], "condim": 6}


def resting(mesh: Mesh, shape: Mesh, kind: str, unit: float, middle: Reals, up: Reals) -> tuple[float, float]:
    """Return how far above what is seen a box rests that falls onto the shape over its middle, and how fast
    it still is; lengths are of `unit`. It may creep off a stone first, and tumble."""
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
    assert said is not None
    assert shape is not None
    assert said.kind == "mesh"
    assert said.mean_distance < 0.005
    assert said.mid_air_share < 0.1
    seen = mesh_from_asset(baked.asset)
    space = Space.of(seen_points(seen, views.train, None), views.train)
    up = (1 if seen.up[0] == "+" else -1) * np.eye(3)["xyz".index(seen.up[1])]
    above, speed = resting(seen, mesh_from_asset(shape), said.kind, space.radius, space.center, up)
    assert abs(above) < 0.1
    assert speed < 0.1

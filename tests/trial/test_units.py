"""Libraries are handed the same in any unit of length; what they make comes back in the asset's."""

from typing import Any

import numpy as np
import pytest

from msb.base.limits import Limits
from msb.trial.attempts import Unit, run_attempt
from msb.trial.mesh import TriedMesh
from msb.trial.registry import TASKS
from msb.trial.task import Made
from tests.trial.conftest import NoLook, box, grid, made_of, together

BOXES = together(*(box(3.0 * k, 1 + 0.1 * k) for k in range(3)))


def scaled(mesh: TriedMesh, by: float) -> TriedMesh:
    return made_of(mesh.vertices * by, mesh.faces)


@pytest.mark.parametrize("power", [-20, -10, 10, 20])
def test_the_mesh_a_library_gets_does_not_depend_on_the_unit_of_length(power: int) -> None:
    wanted = Unit.of(BOXES).enter(BOXES).vertices
    other = scaled(BOXES, 2.0**power)
    np.testing.assert_array_equal(Unit.of(other).enter(other).vertices, wanted)


@pytest.mark.parametrize("mesh", [BOXES, scaled(BOXES, 1e-6), made_of(BOXES.vertices + 1e3, BOXES.faces)])
def test_what_is_not_changed_comes_back_where_it_was(mesh: TriedMesh) -> None:
    unit = Unit.of(mesh)
    back = unit.leave(Made({}, {"again": unit.enter(mesh)}), {}).meshes["again"]
    np.testing.assert_allclose(back.vertices, mesh.vertices, rtol=0, atol=1e-15 * mesh.diagonal)
    assert back.vertices.dtype == np.float32


def test_a_face_far_away_does_not_make_the_others_small() -> None:
    far = made_of(1e4 * np.eye(3), [[0, 1, 2]])
    faces = grid(20)
    alone, beside = (Unit.of(mesh).length for mesh in (faces, together(faces, far)))
    assert beside == alone == pytest.approx(np.sqrt(0.5) / 20)


@pytest.mark.parametrize("vertices", [np.zeros((3, 3)), [[0, 0, 0], [1, 1, 1], [2, 2, 2]]])
def test_a_mesh_without_area_has_a_unit(vertices: Any) -> None:
    unit = Unit.of(made_of(vertices, [[0, 1, 2]]))
    assert unit.length > 0
    assert np.isfinite(unit.enter(made_of(vertices, [[0, 1, 2]])).vertices).all()


def test_lengths_areas_volumes_and_points_are_those_of_the_asset() -> None:
    unit = Unit(0.5, np.array([1.0, 2.0, 3.0]))
    made = Made(
        {"far": 2.0, "area": 2.0, "volume": 2.0, "parts": 2, "none": None}, {}, {"at": np.ones((1, 3))}
    )
    left = unit.leave(made, {"far": 1, "area": 2, "volume": 3, "none": 3})
    assert left.numbers == {"far": 1.0, "area": 0.5, "volume": 0.25, "parts": 2, "none": None}
    np.testing.assert_array_equal(left.arrays["at"], [[1.5, 2.5, 3.5]])
    np.testing.assert_array_equal(unit.enter_points(left.arrays)["at"], np.ones((1, 3)))


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("radius", [1e-6, 1e-3, 1e3, 1e6])
def test_a_ball_of_any_size_unwraps_loses_its_faces_and_is_cut_alike(radius: float) -> None:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(3)
    mesh = made_of(radius * ball.vertices, ball.faces)
    numbers, outcomes = {}, {}
    for name in ("uv", "decimate_50", "boolean", "collision", "solid"):
        task = TASKS[name]
        for one in task.attempts:
            for module in one.modules:
                pytest.importorskip(module)
        replies = {one.library: run_attempt(task, one, mesh, {}, Limits()) for one in task.attempts}
        made = {library: reply.made for library, reply in replies.items() if reply.made is not None}
        look: Any = NoLook()
        judged = task.judge(mesh, made, look)
        numbers[name], outcomes[name] = judged.numbers, judged.outcome
    assert outcomes == dict.fromkeys(outcomes, "works")
    assert numbers["uv"]["faces_left_out"] == 0
    assert numbers["decimate_50"]["fast_simplification"]["faces"] == 640
    volume = radius**3 * ball.volume
    for name in ("boolean", "collision", "solid"):
        assert numbers[name]["volume"] == pytest.approx(volume, rel=1e-3)
    assert numbers["boolean"]["volume_left"] == pytest.approx(volume / 2, rel=0.01)

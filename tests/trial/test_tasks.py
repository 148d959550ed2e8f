"""Check each task on meshes with known results, in any unit of length."""

import math
from typing import Any

import numpy as np
import pytest

from msb.base.limits import Limits
from msb.topology.steps import orient
from msb.trial.attempts import Unit, run_attempt
from msb.trial.mesh import TrialMesh
from msb.trial.registry import TASKS
from msb.trial.task import Output
from msb.trial.tasks import uv
from msb.trial.tasks.boolean import TASKS as BOOLEAN
from msb.trial.tasks.collision import TASKS as COLLISION
from msb.trial.tasks.collision import sample_inside
from msb.trial.tasks.self_intersections import find_slivers
from msb.trial.tasks.solid import cut_section
from msb.trial.tasks.subdivide import cut_apart
from msb.trial.tasks.uv import TASKS as UV
from msb.trial.tasks.uv import measure_stretch
from tests.trial.conftest import (
    MESHES,
    NoRenderings,
    attempt,
    bow_tie,
    box,
    concatenate,
    grid,
    pages,
    soup,
    white_mesh,
)


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "outcome"),
    [
        ("box", "works"),
        ("two boxes", "works"),
        ("open grid", "fails"),
        ("bow-tie", "fails"),
        ("soup", "care"),
        ("pages", "fails"),
    ],
)
@pytest.mark.parametrize("task", ["solid", "boolean"])
def test_closed_meshes_are_solids(task: str, name: str, outcome: str) -> None:
    outputs, judgement = attempt(task, MESHES[name])
    assert judgement.outcome == outcome, judgement.why
    assert (judgement.why is None) == (outcome == "works")
    if task == "solid" and outcome == "works":
        bodies = 2 if name == "two boxes" else 1
        assert outputs["manifold3d"].numbers["volume"] == pytest.approx(bodies)


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("task", ["solid", "boolean"])
def test_an_inside_out_box_works_with_limitations(task: str) -> None:
    _, judgement = attempt(task, white_mesh(box().vertices, box().faces[:, ::-1]))
    assert judgement.outcome == "care"
    assert judgement.numbers["volume"] == pytest.approx(-1.0)


def test_volumes_of_opposite_winding_do_not_hide_errors() -> None:
    (task,) = BOOLEAN
    numbers = {"accepted_merged": True, "accepted": True, "volume": 1e-9, "volume_left": 1.0}
    renderings: Any = NoRenderings()
    for taken, outcome in ((-1.0, "works"), (-0.5, "fails")):
        output = Output({**numbers, "volume_taken": taken, "faces_left": 8})
        assert task.judge(box(), {"manifold3d": output}, renderings).outcome == outcome


@pytest.mark.slow
@pytest.mark.oracle
def test_a_box_has_at_most_six_charts_and_the_soup_of_a_grid_one() -> None:
    outputs, judgement = attempt("uv", concatenate(*(box(3.0 * k) for k in range(20))))
    assert judgement.numbers["charts"] <= 6 * 20
    assert judgement.numbers["stretch_l2"] == pytest.approx(1.0, abs=1e-3)
    assert judgement.numbers["faces_left_out"] == 0
    unwrapped = outputs["xatlas"].meshes["uv"]
    assert ((unwrapped.uv >= 0) & (unwrapped.uv <= 1)).all()
    _, of_soup = attempt("uv", soup(grid()))  # xatlas merges coincident vertices
    assert (of_soup.outcome, of_soup.numbers["charts"]) == ("works", 1)


@pytest.mark.parametrize(
    ("charts", "faces", "outcome"), [(1, 1, "works"), (2, 2, "fails"), (5, 22, "care"), (1, 22, "works")]
)
def test_charts_with_few_faces_worsen_the_outcome(charts: int, faces: int, outcome: str) -> None:
    (task,) = UV
    per_1000 = 1000 * charts / faces
    numbers = {"charts": charts, "charts_per_1000_faces": per_1000, "packing": 0.5, "faces_left_out": 0}
    renderings: Any = NoRenderings()
    judgement = task.judge(box(), {"xatlas": Output({**numbers, "stretch_l2": 1.0})}, renderings)
    assert (judgement.outcome, judgement.why is None) == (outcome, outcome == "works")


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("percent", [50, 25, 10])
def test_decimation_reaches_its_target_and_keeps_colours(percent: int) -> None:
    flat = grid(20)
    colored = TrialMesh(flat.vertices, flat.faces, np.full_like(flat.colors, 0.25))
    outputs, judgement = attempt(f"decimate_{percent}", colored)
    for library, output in outputs.items():
        entry = judgement.numbers[library.replace("-", "_")]
        assert entry["reached"], library
        assert entry["faces"] <= 1.05 * 800 * percent / 100
        np.testing.assert_allclose(output.meshes["mesh"].colors, 0.25, atol=0.01)


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize(
    ("name", "outcome"), [("box", "works"), ("open grid", "works"), ("two boxes", "works")]
)
def test_subdivision_is_defined_on_manifold_meshes(name: str, outcome: str) -> None:
    outputs, judgement = attempt("subdivide", MESHES[name])
    assert (judgement.outcome, judgement.numbers["defined"]) == (outcome, True)
    assert judgement.numbers["gap_area"] == 0
    assert len(outputs["libigl"].meshes["mesh"].faces) == 4 * len(MESHES[name].faces)


@pytest.mark.slow
@pytest.mark.oracle
def test_cracks_open_between_unconnected_faces() -> None:
    # Two unconnected triangles of a flat square. Loop's boundary rule moves each corner a quarter of the way
    # to the average of its neighbours. The copies of the diagonal therefore move apart.
    square = soup(grid(1))
    _, judgement = attempt("subdivide", square)
    assert judgement.outcome == "fails"
    corners = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]])
    ends = 0.75 * corners + 0.25 * (corners.sum(axis=0) - corners) / 2
    first = np.array([ends[0], [0.5, 0.5], ends[1]])
    second = 1 - first[::-1]  # the other triangle is rotated by 180 degrees
    gap = 0.0
    for k in (0, 1):
        shape = np.array([first[k], first[k + 1], second[k + 1], second[k]])
        x, y = shape.T
        gap += abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2
    assert judgement.numbers["gap_area"] == pytest.approx(gap, rel=1e-5)
    assert judgement.numbers["gap_share"] == pytest.approx(gap, rel=1e-5)


@pytest.mark.slow
@pytest.mark.oracle
def test_subdivision_of_lone_faces_fails() -> None:
    apart = concatenate(*(white_mesh([[0, 0, k], [1, 0, k], [0, 1, k]], [[0, 1, 2]]) for k in range(5)))
    _, judgement = attempt("subdivide", apart)
    assert (judgement.outcome, judgement.numbers["lone_share"], judgement.numbers["gap_area"]) == (
        "fails",
        1.0,
        0.0,
    )


@pytest.mark.slow
@pytest.mark.oracle
def test_decimation_of_lone_faces_keeps_colours() -> None:
    apart = concatenate(*(white_mesh([[0, 0, k], [1, 0, k], [0, 1, k]], [[0, 1, 2]]) for k in range(20)))
    outputs, judgement = attempt("decimate_50", apart)
    assert judgement.numbers["fast_simplification"]["reached"]
    np.testing.assert_allclose(outputs["fast-simplification"].meshes["mesh"].colors, 1.0)


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize(("name", "parts"), [("box", 1), ("two boxes", 2)])
def test_each_convex_body_is_a_part(name: str, parts: int) -> None:
    outputs, judgement = attempt("collision", MESHES[name])
    assert judgement.outcome == "works"
    assert judgement.numbers["parts"] == parts
    assert judgement.numbers["volume"] == pytest.approx(parts, rel=0.05)
    inside = outputs["coacd"].arrays["inside"]
    assert len(inside) > 1000
    nearest = np.round(inside.mean(axis=0), 1)
    np.testing.assert_allclose(nearest, 0.5 if parts == 1 else 2.0, atol=0.15)


def distance(point: Any, corners: Any) -> float:
    """Return the distance of a point from a triangle, measured to its plane or to the nearest edge."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    edges = [(corners[k], corners[(k + 1) % 3]) for k in range(3)]
    if normal.any() and all(normal @ np.cross(b - a, point - a) >= 0 for a, b in edges):
        return abs(float((point - corners[0]) @ normal)) / float(np.linalg.norm(normal))
    distances = []
    for a, b in edges:
        along = b - a
        share = min(max(float((point - a) @ along) / max(float(along @ along), 1e-300), 0.0), 1.0)
        distances.append(float(np.linalg.norm(point - a - share * along)))
    return min(distances)


@pytest.mark.slow
@pytest.mark.oracle
def test_distances_to_the_shape_match_brute_force() -> None:
    for module in ("coacd", "igl"):
        pytest.importorskip(module)
    (task,) = COLLISION
    seen = np.random.default_rng(0).uniform(-1, 5, (60, 3))
    output = task.attempts[0].work(MESHES["two boxes"], {"visible": seen})
    shape = output.meshes["shape"]
    corners = shape.vertices.astype(np.float64)[shape.faces]
    wanted = [min(distance(point, triangle) for triangle in corners) for point in seen]
    assert output.numbers["distance_mean"] == pytest.approx(np.mean(wanted), rel=1e-5)
    assert output.numbers["distance_95"] == pytest.approx(np.quantile(wanted, 0.95), rel=1e-5)


@pytest.mark.parametrize("name", sorted(MESHES.keys() - {"boxes that cross"}))
def test_neighbouring_faces_do_not_cross(name: str) -> None:
    _, judgement = attempt("self_intersections", MESHES[name])
    assert (judgement.outcome, judgement.numbers["pairs"], judgement.numbers["slivers"]) == ("works", 0, 0)


def test_crossing_boxes_and_slivers_are_counted() -> None:
    _, judgement = attempt("self_intersections", MESHES["boxes that cross"])
    assert judgement.outcome == "fails"
    assert judgement.numbers["faces"] > 0
    needle = white_mesh(
        [[0, 0, 0], [1, 0, 0], [0.5, 0.005, 0], [0, 5, 0], [1, 5, 0], [0, 6, 0]], [[0, 1, 2], [3, 4, 5]]
    )
    _, judgement = attempt("self_intersections", needle)
    assert (judgement.numbers["slivers"], judgement.numbers["sliver_share"]) == (1, 0.5)


@pytest.mark.parametrize(
    ("mesh", "vertices"), [(box(), 8), (bow_tie(), 6), (pages(), 9), (soup(box()), 36), (grid(2), 9)]
)
def test_cutting_leaves_one_fan_at_every_vertex(mesh: TrialMesh, vertices: int) -> None:
    cut, origin = cut_apart(mesh.faces, len(mesh.vertices))
    assert len(origin) == vertices
    np.testing.assert_array_equal(origin[cut], mesh.faces)


def test_faces_of_opposite_winding_are_cut() -> None:
    faces = box().faces.copy()
    faces[::3] = faces[::3, ::-1]
    assert len(cut_apart(faces, 8)[1]) > 8
    assert len(cut_apart(orient(faces, 8).faces, 8)[1]) == 8


def test_stretch_is_one_for_a_scaled_map_and_larger_for_a_squeezed_one() -> None:
    flat = grid(3)
    uv = flat.vertices[:, :2] * 7
    assert measure_stretch(flat.vertices, flat.faces, uv) == pytest.approx(1.0)
    # The map is scaled by a and 1/a. The singular values are then a and 1/a, and the stretch is sqrt((a^2 +
    # 1/a^2) / 2).
    assert measure_stretch(flat.vertices, flat.faces, uv * (2.0, 0.5)) == pytest.approx(
        math.sqrt((4 + 0.25) / 2)
    )
    assert measure_stretch(flat.vertices, flat.faces, uv * 0) is None


def test_points_are_uniform_over_the_volume_of_all_parts() -> None:
    small, large = box(), box(5.0, 2.0)
    parts: list[Any] = [(mesh.vertices, mesh.faces) for mesh in (small, large)]
    points = sample_inside(parts, np.array([1.0, 8.0]), 9000)
    first = (points < 2).all(axis=1)
    assert first.mean() == pytest.approx(1 / 9, abs=0.02)
    np.testing.assert_allclose(points[first].mean(axis=0), 0.5, atol=0.05)
    assert ((points[~first] >= 5) & (points[~first] <= 7)).all()


def test_the_cross_section_of_a_box_is_a_square() -> None:
    lines = cut_section(box())
    assert len(lines) == 8
    assert np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum() == pytest.approx(4.0)


def test_slivers_are_thin_or_have_no_area() -> None:
    rows = [[[0, 0, 0], [1, 0, 0], [0.5, h, 0]] for h in (0.5, 0.02, 0.009, 0.0)] + [[[1, 1, 1]] * 3]
    assert find_slivers(np.array(rows, np.float64)).tolist() == [False, False, True, True, True]


BOXES = concatenate(*(box(3.0 * k, 1 + 0.1 * k) for k in range(3)))


def scaled(mesh: TrialMesh, by: float) -> TrialMesh:
    return white_mesh(mesh.vertices * by, mesh.faces)


@pytest.mark.parametrize("power", [-20, -10, 10, 20])
def test_the_mesh_for_libraries_is_independent_of_the_unit(power: int) -> None:
    wanted = Unit.of(BOXES).to_unit(BOXES).vertices
    other = scaled(BOXES, 2.0**power)
    np.testing.assert_array_equal(Unit.of(other).to_unit(other).vertices, wanted)


@pytest.mark.parametrize("mesh", [BOXES, scaled(BOXES, 1e-6), white_mesh(BOXES.vertices + 1e3, BOXES.faces)])
def test_conversion_to_the_unit_and_back_is_exact(mesh: TrialMesh) -> None:
    unit = Unit.of(mesh)
    back = unit.from_unit(Output({}, {"again": unit.to_unit(mesh)}), {}).meshes["again"]
    np.testing.assert_allclose(back.vertices, mesh.vertices, rtol=0, atol=1e-15 * mesh.diagonal)
    assert back.vertices.dtype == np.float32


def test_a_distant_face_does_not_change_the_unit() -> None:
    far = white_mesh(1e4 * np.eye(3), [[0, 1, 2]])
    faces = grid(20)
    alone, beside = (Unit.of(mesh).length for mesh in (faces, concatenate(faces, far)))
    assert beside == alone == pytest.approx(np.sqrt(0.5) / 20)


@pytest.mark.parametrize("vertices", [np.zeros((3, 3)), [[0, 0, 0], [1, 1, 1], [2, 2, 2]]])
def test_a_mesh_without_area_has_a_unit(vertices: Any) -> None:
    unit = Unit.of(white_mesh(vertices, [[0, 1, 2]]))
    assert unit.length > 0
    assert np.isfinite(unit.to_unit(white_mesh(vertices, [[0, 1, 2]])).vertices).all()


def test_numbers_and_points_are_converted_to_the_unit_of_the_asset() -> None:
    unit = Unit(0.5, np.array([1.0, 2.0, 3.0]))
    output = Output(
        {"far": 2.0, "area": 2.0, "volume": 2.0, "parts": 2, "none": None}, {}, {"at": np.ones((1, 3))}
    )
    left = unit.from_unit(output, {"far": 1, "area": 2, "volume": 3, "none": 3})
    assert left.numbers == {"far": 1.0, "area": 0.5, "volume": 0.25, "parts": 2, "none": None}
    np.testing.assert_array_equal(left.arrays["at"], [[1.5, 2.5, 3.5]])
    np.testing.assert_array_equal(unit.arrays_to_unit(left.arrays)["at"], np.ones((1, 3)))


@pytest.mark.slow
@pytest.mark.oracle
@pytest.mark.parametrize("radius", [1e-6, 1e-3, 1e3, 1e6])
def test_tasks_work_for_a_ball_of_any_size(radius: float) -> None:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(3)
    mesh = white_mesh(radius * ball.vertices, ball.faces)
    numbers, outcomes = {}, {}
    for name in ("uv", "decimate_50", "boolean", "collision", "solid"):
        task = TASKS[name]
        for entry in task.attempts:
            for module in entry.modules:
                pytest.importorskip(module)
        replies = {entry.library: run_attempt(task, entry, mesh, {}, Limits()) for entry in task.attempts}
        outputs = {library: reply.output for library, reply in replies.items() if reply.output is not None}
        renderings: Any = NoRenderings()
        judgement = task.judge(mesh, outputs, renderings)
        numbers[name], outcomes[name] = judgement.numbers, judgement.outcome
    assert outcomes == dict.fromkeys(outcomes, "works")
    assert numbers["uv"]["faces_left_out"] == 0
    assert numbers["decimate_50"]["fast_simplification"]["faces"] == 640
    volume = radius**3 * ball.volume
    for name in ("boolean", "collision", "solid"):
        assert numbers[name]["volume"] == pytest.approx(volume, rel=1e-3)
    assert numbers["boolean"]["volume_left"] == pytest.approx(volume / 2, rel=0.01)


def test_large_meshes_are_unwrapped_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("xatlas")
    mesh = grid(20)
    monkeypatch.setattr(uv, "UNWRAP_FACES", 200)
    output = UV[0].attempts[0].work(mesh, {})
    assert output.numbers["charts"] >= 4
    assert output.numbers["faces_left_out"] == 0
    unwrapped = output.meshes["uv"]
    assert np.array_equal(unwrapped.vertices[unwrapped.faces], mesh.vertices[mesh.faces])

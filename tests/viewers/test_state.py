"""State, legend, picking and fans of the viewer, without a window."""

import numpy as np
import pytest

from msb.errors import UsageError
from msb_viewers.camera import Pose, default_pose, element_pose, up_vector
from msb_viewers.fans import find_neighbourhood
from msb_viewers.legend import legend_panel
from msb_viewers.model import ViewModel
from msb_viewers.picking import pick
from msb_viewers.sheet import help_panel
from msb_viewers.state import HELP, ViewState, parse_element, parse_kinds
from tests.viewers.conftest import model_of


def test_stepping_goes_round_and_back(demo: ViewModel) -> None:
    state = ViewState.first(demo)
    state.active = "multifan_vertices"
    for expected in (0, 1, 2):
        assert state.step(1)
        assert state.element == ("multifan_vertices", expected)
    for expected in (1, 0, len(demo.layers["multifan_vertices"]) - 1):
        state.step(-1)
        assert state.element == ("multifan_vertices", expected)


def test_stepping_stays_in_the_isolated_component(faults: ViewModel) -> None:
    state = ViewState.first(faults)
    book = int(faults.face_component[2])
    state.isolate(book)
    state.active = "boundary_edges"
    seen = set()
    for _ in range(6):
        assert state.step(1)
        seen.add(state.element[1])
        assert state.component_of(*state.element) == book
    assert len(seen) == 6
    state.active = "multifan_vertices"
    assert not state.step(1)


def test_isolating_counts_by_size(demo: ViewModel) -> None:
    state = ViewState.first(demo)
    state.isolate_next(1)
    assert state.component == 0
    state.isolate_next(1)
    assert state.component == 1
    state.isolate_selection()
    assert state.component is None


@pytest.mark.parametrize("scale", [0.62, 1.0, 2.0])
def test_rows_of_the_legend_have_actions(faults: ViewModel, scale: float) -> None:
    panel = legend_panel(ViewState.first(faults), scale)
    actions = [action for _, _, action in panel.targets]
    assert actions == [*faults.layers, "components", "help"]
    for top, bottom, action in panel.targets:
        assert panel.hit(20, (top + bottom) / 2) == action
    assert panel.hit(20, 2) == ""
    assert panel.hit(panel.image.shape[1] + 1, 20) is None
    bottoms = [bottom for _, bottom, _ in panel.targets]
    assert bottoms == sorted(bottoms)
    assert bottoms[-1] <= panel.image.shape[0]
    assert help_panel(HELP, scale).image.shape[2] == 4


def test_names_of_elements_and_layers_are_parsed(demo: ViewModel) -> None:
    assert parse_element(demo, "boundary_edges:3") == ("boundary_edges", 2)
    assert parse_kinds(demo, ["all"]) == {kind for kind, layer in demo.layers.items() if len(layer)}
    assert parse_kinds(demo, ["none"]) == set()
    for text in ("boundary_edges:0", "boundary_edges:x", "boundary_edges", "duplicate_faces:1", "edges:1"):
        with pytest.raises(UsageError, match="NAME_UNKNOWN"):
            parse_element(demo, text)
    with pytest.raises(UsageError, match="NAME_UNKNOWN"):
        parse_kinds(demo, ["edges"])


@pytest.mark.parametrize("axis", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_the_first_view_shows_the_unit_sphere_upright(axis: str) -> None:
    pose = default_pose(axis, 1.5)
    assert pose.eye @ up_vector(axis) > 0
    assert pose.up.tolist() == up_vector(axis).tolist()
    assert np.sin(np.radians(15)) * pose.distance == pytest.approx(1.04)


def test_the_view_of_an_element_is_not_hidden() -> None:
    # A small triangle in a box that is only open at the top.
    box = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    walls = [[0, 1, 3], [0, 3, 2], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [0, 2, 6], [0, 6, 4]]
    walls += [[1, 3, 7], [1, 7, 5]]
    model = model_of([*box, [-0.1, -0.8, 0], [0.1, -0.8, 0], [0, -0.8, 0.2]], [*walls, [8, 9, 10]])
    current = Pose(np.array([0.0, 0.0, 5.0]), np.zeros(3), np.array([0.0, 1.0, 0.0]))
    pose = element_pose(model, np.array([8, 9, 10]), current)
    way = pose.eye - pose.target
    assert way[1] / np.linalg.norm(way) > 0.6


def test_picking_ignores_clipped_faces() -> None:
    points = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0], [-1, -1, 1], [1, -1, 1], [0, 1, 1]], np.float32)
    faces = np.arange(6).reshape(2, 3)
    ray = np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.0, -1.0])
    box = np.array([[-2, 2], [-2, 2], [-0.5, 0.5]])
    allowed = np.ones(2, bool)
    assert pick(points, faces, allowed, *ray).face == 1
    assert pick(points, faces, allowed, *ray, box).face == 0


def test_picking_agrees_with_brute_force(demo: ViewModel) -> None:
    random = np.random.default_rng(2)
    triangles = demo.points[demo.faces].astype(np.float64)
    for _ in range(12):
        eye = random.normal(size=3)
        eye *= 4 / np.linalg.norm(eye)
        way = random.normal(size=3) * 0.2 - eye
        way /= np.linalg.norm(way)
        a, ab, ac = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
        normal = np.cross(ab, ac)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = ((a - eye) * normal).sum(axis=1) / (normal @ way)
            inner = eye + t[:, None] * way - a
            u = (np.cross(inner, ac) * normal).sum(axis=1) / (normal**2).sum(axis=1)
            v = (np.cross(ab, inner) * normal).sum(axis=1) / (normal**2).sum(axis=1)
        good = (t > 0) & (u > 0) & (v > 0) & (u + v < 1)
        hit = pick(demo.points, demo.faces, demo.drawn, eye, way)
        if not good.any():
            assert hit is None
            continue
        assert hit.face == int(np.argmin(np.where(good, t, np.inf)))


def test_fans_of_a_bow_tie_are_apart(faults: ViewModel) -> None:
    around = find_neighbourhood(faults, 2)
    assert (around.fan_count, around.group_count, around.on_crowded_edge) == (2, 2, False)
    assert sorted(fan.faces.tolist() for fan in around.fans) == [[0], [1]]
    first, second = (fan.triangles.reshape(-1, 3) @ around.frame[:2].T for fan in around.fans)
    gap = np.linalg.norm(first[:, None] - second[None], axis=2).min()
    assert gap > 0.5


def test_fans_on_a_crowded_edge_are_one_face_each(faults: ViewModel) -> None:
    around = find_neighbourhood(faults, 5)
    assert around.fan_count == 3
    assert around.group_count == 1
    assert around.on_crowded_edge
    assert [len(fan.crowded) for fan in around.fans] == [1, 1, 1]
    assert [len(fan.boundary) for fan in around.fans] == [1, 1, 1]
    assert len(around.lines()) == 3


def test_fans_of_every_vertex_agree_with_the_audit(demo: ViewModel) -> None:
    wanted = demo.analysis.fans.fans_per_vertex
    for vertex in np.random.default_rng(0).choice(len(wanted), 40, replace=False).tolist():
        around = find_neighbourhood(demo, vertex)
        fan_count = len(around.fans)
        assert fan_count == min(wanted[vertex], 12)
        parts = [face for fan in around.fans for face in fan.faces.tolist()]
        assert len(parts) == len(set(parts))

"""The real viewer, off-screen: what must be seen is looked for at the pixels where it must be."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any

import numpy as np
import pytest

from msb_viewers.camera import Pose
from msb_viewers.model import ViewModel
from msb_viewers.palette import BACKGROUND, HIGHLIGHT, STYLES
from msb_viewers.viewed_mesh import Colors
from msb_viewers.viewer import TopologyViewer
from tests.viewers.conftest import GREEN, MOVE, PRESS, RED, RELEASE, model_of, mouse, square

Image = np.ndarray
FRONT = Pose(np.array([0.0, 0.0, 4.2]), np.zeros(3), np.array([0.0, 1.0, 0.0]))


@pytest.fixture
def opened(gl: None) -> Iterator[Any]:
    """Return a function that opens a viewer, bare and looking along -z, and closes it in the end."""
    with ExitStack() as stack:

        def start(
            model: ViewModel, *, plain: bool = True, size: tuple[int, int] = (640, 480)
        ) -> TopologyViewer:
            viewer = stack.enter_context(closing(TopologyViewer(model, off_screen=True, size=size)))
            if plain:
                viewer.state.legend, viewer.state.message, viewer.state.visible = False, "", set()
                viewer.pose = FRONT
                viewer.refresh()
            return viewer

        yield start


def around(image: Image, place: np.ndarray, radius: int = 2) -> np.ndarray:
    """Return the colours (n, 3) near a pixel."""
    x, y = (round(float(value) - 0.5) for value in place)
    return image[max(y - radius, 0) : y + radius + 1, max(x - radius, 0) : x + radius + 1].reshape(-1, 3)


def has(image: Image, place: np.ndarray, color: tuple[int, int, int], radius: int = 2) -> bool:
    return bool((np.abs(around(image, place, radius).astype(int) - color) <= 12).all(axis=1).any())


def middle(viewer: TopologyViewer, vertices: list[int]) -> np.ndarray:
    return viewer.project(viewer.model.points[vertices].mean(axis=0)[None])[0]


def test_colours_are_shown_as_stored(opened: Any, faults: ViewModel) -> None:
    viewer = opened(faults)
    image = viewer.image()
    assert tuple(around(image, middle(viewer, [0, 1, 2]), 0)[0]) == RED
    assert tuple(around(image, middle(viewer, [10, 11, 12]), 0)[0]) == GREEN
    assert tuple(image[2, 2]) == BACKGROUND


@pytest.mark.parametrize("domain", ["vertex", "face", "corner"])
def test_colours_of_any_domain_reach_their_faces(opened: Any, domain: Any) -> None:
    points = [*square(1, 0, left=-1), *square(1, 0, left=1)]
    faces = [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]
    rows = {
        "vertex": [RED] * 4 + [GREEN] * 4,
        "face": [RED] * 2 + [GREEN] * 2,
        "corner": [RED] * 6 + [GREEN] * 6,
    }
    viewer = opened(model_of(points, faces, colors=Colors(np.array(rows[domain], np.uint8), domain)))
    for component, color in ((None, RED), (None, GREEN), (0, RED), (1, GREEN)):
        viewer.state.component = component
        place = middle(viewer, [0, 1, 2] if color is RED else [4, 5, 6])
        assert tuple(around(viewer.image(), place, 0)[0]) == color
    viewer.state.component = 0
    assert tuple(around(viewer.image(), middle(viewer, [4, 5, 6]), 0)[0]) == BACKGROUND


@pytest.mark.parametrize(
    ("kind", "vertices"),
    [
        ("boundary_edges", [0, 1]),
        ("nonmanifold_edges", [5, 6]),
        ("multifan_vertices", [2]),
        ("nonmanifold_edge_endpoints", [5]),
        ("degenerate_faces", [13, 14, 14]),
        ("duplicate_faces", [10, 11]),
        ("unreferenced_vertices", [15]),
    ],
)
def test_a_layer_is_seen_where_its_elements_are_and_goes_again(
    opened: Any, faults: ViewModel, kind: str, vertices: list[int]
) -> None:
    viewer = opened(faults)
    place = middle(viewer, vertices)
    color, radius = STYLES[kind].color, 7
    assert not has(viewer.image(), place, color, radius)
    assert viewer.controls.key(STYLES[kind].key)
    viewer.state.message = ""
    assert has(viewer.image(), place, color, radius)
    viewer.controls.key(STYLES[kind].key)
    assert not has(viewer.image(), place, color, radius)


def test_winding_flips_are_dashed(opened: Any) -> None:
    flipped = model_of(
        square(2, 0), [[0, 1, 2], [0, 3, 2]], colors=Colors(np.full((4, 3), 250, np.uint8), "vertex")
    )
    viewer = opened(flipped)
    viewer.controls.key("7")
    image = viewer.image()
    start, end = viewer.model.points[[0, 2]]
    places = viewer.project(np.array([start + t * (end - start) for t in (0.1, 0.3, 0.5, 0.7, 0.9)]))
    color = STYLES["inconsistent_winding_edges"].color
    seen = [has(image, place, color, 1) for place in places]
    assert seen == [True, False, True, False, True]


def test_a_surface_hides_layers_until_they_are_seen_through_it(opened: Any) -> None:
    # A small open triangle behind a large one.
    points = [[-2, -2, 1], [2, -2, 1], [0, 2.5, 1], [-0.5, -0.5, -1], [0.5, -0.5, -1], [0, 0.5, -1]]
    viewer = opened(model_of(points, [[0, 1, 2], [3, 4, 5]]))
    viewer.state.visible = {"boundary_edges"}
    place = middle(viewer, [3, 4])
    color = STYLES["boundary_edges"].color
    assert not has(viewer.image(), place, color)
    viewer.controls.key("x")
    assert has(viewer.image(), place, color)
    viewer.controls.key("x")
    assert not has(viewer.image(), place, color)


def test_stepping_flies_to_the_element_and_rings_it(opened: Any, demo: ViewModel) -> None:
    viewer = opened(demo)
    viewer.state.active = "nonmanifold_edges"
    before = viewer.pose
    for name, expected in (("n", 0), ("n", 1), ("n", 2), ("p", 1)):
        viewer.controls.key(name)
        assert viewer.state.element == ("nonmanifold_edges", expected)
        vertices = demo.layers["nonmanifold_edges"].vertices[expected]
        place = viewer.project(demo.points[vertices].mean(axis=0)[None])[0]
        assert place == pytest.approx([320, 240], abs=1)
        ring = place + np.array([16, 0])
        assert has(viewer.image(), ring, HIGHLIGHT, 3)
    assert viewer.pose.distance < before.distance / 5
    viewer.controls.key("Home")
    assert viewer.pose.distance > before.distance / 2


@pytest.mark.parametrize("shared", [True, False], ids=["indexed", "soup"])
def test_clicking_picks_the_vertex_under_the_mouse(opened: Any, shared: bool) -> None:
    points = np.array([*square(2, 0), *square(1, 1)])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    if not shared:
        points, faces = points[faces].reshape(-1, 3), np.arange(12).reshape(4, 3)
    viewer = opened(model_of(points, faces))
    for face in range(4):
        for corner in range(3):
            vertex = int(faces[face, corner])
            inner = 0.85 * viewer.model.points[vertex] + 0.15 * viewer.model.points[faces[face]].mean(axis=0)
            x, y = viewer.project(inner[None])[0]
            hidden = face < 2 and bool(
                np.abs(inner[:2]).max() < np.abs(viewer.model.points[faces[2]][:, :2]).max()
            )
            viewer.controls.click(int(x), int(y))
            found = viewer.model.analysis.vertices[viewer.state.vertex]
            if not hidden:
                assert found.tolist() == points[vertex].tolist()
    viewer.controls.click(3, 3)
    assert viewer.state.vertex is None
    assert "nothing there" in viewer.state.message


def test_the_fan_inspector_shows_each_fan_in_its_colour(opened: Any, faults: ViewModel) -> None:
    from msb_viewers.palette import FAN_COLORS

    viewer = opened(faults)
    x, y = viewer.project(faults.points[2][None])[0]
    viewer.controls.click(int(x) - 4, int(y))
    assert viewer.state.vertex == 2
    assert len(viewer.inset.shown.fans) == 2
    assert "bow-tie" in viewer.state.message
    picture = viewer._pictures["fans"]
    corner = viewer.image()[-picture.size[0] :, -picture.size[0] :]
    for color in FAN_COLORS[:2]:
        assert (np.abs(corner.astype(int) - color) <= 3).all(axis=2).sum() > 200
    viewer.controls.key("Escape")
    assert not (np.abs(viewer.image().astype(int) - FAN_COLORS[0]) <= 3).all(axis=2).any()


def test_the_box_clips_surface_and_layers(opened: Any, faults: ViewModel) -> None:
    viewer = opened(faults)
    viewer.state.visible = {"boundary_edges"}
    left, right = middle(viewer, [0, 1, 2]), middle(viewer, [10, 11, 12])
    viewer.set_box(np.array([[-0.1, 2], [-2, 2], [-2, 2]]))
    image = viewer.image()
    assert tuple(around(image, left, 0)[0]) == BACKGROUND
    assert tuple(around(image, right, 0)[0]) == GREEN
    assert not has(image, middle(viewer, [0, 1]), STYLES["boundary_edges"].color)
    viewer.controls.key("k")  # off: there is a box
    assert tuple(around(viewer.image(), left, 0)[0]) == RED
    viewer.controls.key("k")
    assert viewer.stage.box is not None


def test_isolating_leaves_one_component_in_the_middle(opened: Any, faults: ViewModel) -> None:
    viewer = opened(faults)
    viewer.state.visible = {"boundary_edges", "multifan_vertices"}
    viewer.controls.key("bracketright")
    assert viewer.state.component == 0
    faces = faults.faces[faults.faces_of(0)]
    places = viewer.project(faults.points[np.unique(faces)])
    assert (places > 0).all()
    assert (places < [640, 480]).all()
    viewer.controls.key("i")
    assert viewer.state.component is None


def test_the_legend_is_clicked_like_a_row_of_check_boxes(opened: Any, faults: ViewModel) -> None:
    viewer = opened(faults, plain=False, size=(1280, 800))
    for top, bottom, action in viewer._legend.targets:
        if action not in faults.layers or not len(faults.layers[action]):
            continue
        on = action in viewer.state.visible
        viewer.controls.click(30, 12 + (top + bottom) // 2)
        assert (action in viewer.state.visible) != on, action
    image = viewer.image()
    panel = viewer._legend.image
    seen = image[12 : 12 + panel.shape[0], 12 : 12 + panel.shape[1]].astype(int)
    solid = panel[..., 3] > 250
    assert np.abs(seen - panel[..., :3])[solid].max() <= 2


@pytest.mark.parametrize("size", [(1280, 800), (800, 600), (400, 300), (2560, 1440)])
def test_the_first_view_leaves_the_legend_free(opened: Any, faults: ViewModel, size: tuple[int, int]) -> None:
    viewer = opened(faults, plain=False, size=size)
    places = viewer.project(faults.points[:13])  # those that faces use
    assert (places[:, 0] > viewer._taken()).all()
    assert (places[:, 0] < size[0]).all()
    assert ((places[:, 1] > 0) & (places[:, 1] < size[1])).all()
    assert viewer.image().shape == (size[1], size[0], 3)


def test_every_key_of_the_help_does_something(opened: Any, faults: ViewModel) -> None:
    viewer = opened(faults, plain=False)
    for name in [*"12345678", "0", "Tab", *"npfci", "[", "]", *"kxlh", "Home", "Escape", "r", "KP_1"]:
        assert viewer.controls.key(name), name
    assert not viewer.controls.key("j")
    assert not viewer.controls.key("F12")


def test_events_of_the_window_reach_the_controls(opened: Any, faults: ViewModel) -> None:
    viewer = opened(faults, plain=False)
    viewer.controls.attach()
    interactor = viewer.plotter.iren.interactor
    interactor.SetKeySym("3")
    on = "multifan_vertices" in viewer.state.visible
    interactor.InvokeEvent("KeyPressEvent")
    interactor.InvokeEvent("CharEvent")
    assert ("multifan_vertices" in viewer.state.visible) != on
    x, y = middle(viewer, [10, 11, 12])
    mouse(viewer, x, y, PRESS, RELEASE)
    assert viewer.state.vertex in (10, 11, 12)
    before = viewer.pose
    mouse(viewer, x, y, PRESS)
    mouse(viewer, x - 40, y, MOVE)
    assert viewer.stage.moving
    mouse(viewer, x - 40, y, RELEASE)
    assert not viewer.stage.moving
    assert np.linalg.norm(viewer.pose.eye - before.eye) > 0.05


def test_a_stand_in_is_drawn_while_a_slow_view_moves(opened: Any, demo: ViewModel) -> None:
    viewer = opened(demo)
    viewer.state.visible = {"boundary_edges"}
    viewer.refresh()
    viewer.stage.seconds = 10.0
    viewer.controls.moving(True)
    assert not viewer.stage._surface[0].GetVisibility()
    assert viewer.stage._stand_in[0].GetVisibility()
    thin = viewer.stage._layers["boundary_edges"][2]
    assert thin[0].GetVisibility()
    assert thin[0].GetMapper().GetInput().GetNumberOfCells() < len(demo.layers["boundary_edges"])
    viewer.controls.moving(False)
    assert viewer.stage._surface[0].GetVisibility()
    assert not thin[0].GetVisibility()


@pytest.mark.parametrize("count", [0, 1])
def test_next_to_nothing_to_draw_is_no_error(opened: Any, count: int) -> None:
    faces = np.array([[0, 1, 2]])[:count]
    viewer = opened(model_of(np.eye(3), faces), plain=False)
    for name in ("0", "n", "c", "i", "k", "f"):
        viewer.controls.key(name)
    viewer.controls.click(500, 200)
    assert viewer.image().shape == (480, 640, 3)


def test_the_figure_has_four_panels_with_their_marks(gl: None, demo: ViewModel) -> None:
    from msb_viewers.figure import PANELS, compose, panel_images

    images = panel_images(demo, side=240)
    assert len(images) == 4
    for panel, (whole, close) in zip(PANELS, images, strict=True):
        for image in (whole, close):
            assert image.shape == (240, 240, 3)
            for kind in panel.kinds[:1]:
                near = np.abs(image.astype(int) - STYLES[kind].color).max(axis=2) < 60
                assert near.sum() > 20, (panel.title, kind)
    pytest.importorskip("matplotlib")
    figure = compose(demo, images)
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    for axes in figure.axes:
        legend = axes.get_legend()
        if legend is not None:
            box = legend.get_window_extent(renderer)
            assert box.y0 >= 0
            assert box.width <= axes.get_window_extent(renderer).width * 1.02

"""The viewer off-screen: check the colours of pixels where elements must be visible."""

from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any

import numpy as np
import pytest

from msb_viewers.camera import Pose
from msb_viewers.model import ViewModel
from msb_viewers.palette import BACKGROUND, FAN_COLORS, HIGHLIGHT, STYLES
from msb_viewers.viewed_mesh import Colors
from msb_viewers.viewer import TopologyViewer
from tests.viewers.conftest import GREEN, MOVE, PRESS, RED, RELEASE, model_of, mouse, square

Image = np.ndarray
FRONT = Pose(np.array([0.0, 0.0, 4.2]), np.zeros(3), np.array([0.0, 1.0, 0.0]))


@pytest.fixture
def opened(gl: None) -> Iterator[Any]:
    """Return a function that opens a viewer without panels, looking along -z.

    The viewer is closed after the test.
    """
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


def test_layers_are_drawn_at_their_elements_and_can_be_hidden(opened: Any, faults: ViewModel) -> None:
    viewer = opened(faults)
    assert tuple(viewer.image()[2, 2]) == BACKGROUND
    for kind, vertices in {
        "boundary_edges": [0, 1],
        "nonmanifold_edges": [5, 6],
        "multifan_vertices": [2],
        "nonmanifold_edge_endpoints": [5],
        "degenerate_faces": [13, 14, 14],
        "duplicate_faces": [10, 11],
        "unreferenced_vertices": [15],
    }.items():
        place, style = middle(viewer, vertices), STYLES[kind]
        for on in (True, False):
            viewer.controls.key(style.key)
            viewer.state.message = ""
            assert has(viewer.image(), place, style.color, 7) == on, kind


def test_a_click_selects_a_vertex_and_shows_its_fans(opened: Any, faults: ViewModel) -> None:
    viewer = opened(faults)
    x, y = viewer.project(faults.points[2][None])[0]
    viewer.controls.click(int(x) - 4, int(y))
    assert viewer.state.vertex == 2
    assert len(viewer.inset.neighbourhood.fans) == 2
    picture = viewer._overlays["fans"]
    corner = viewer.image()[-picture.size[0] :, -picture.size[0] :]
    for color in FAN_COLORS[:2]:
        assert (np.abs(corner.astype(int) - color) <= 3).all(axis=2).sum() > 200
    viewer.controls.click(3, 3)
    assert viewer.state.vertex is None
    assert not (np.abs(viewer.image().astype(int) - FAN_COLORS[0]) <= 3).all(axis=2).any()


def test_a_click_on_a_row_of_the_legend_switches_its_layer(opened: Any, faults: ViewModel) -> None:
    viewer = opened(faults, plain=False, size=(1280, 800))
    viewer.controls.attach()
    for top, bottom, action in viewer._legend.targets:
        if action in faults.layers and len(faults.layers[action]):
            before = action in viewer.state.visible
            mouse(viewer, 30, 12 + (top + bottom) // 2, PRESS, RELEASE)
            assert (action in viewer.state.visible) != before, action


def test_stepping_goes_to_the_element_and_marks_it(opened: Any, demo: ViewModel) -> None:
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


def test_the_box_clips_surface_and_layers(opened: Any, faults: ViewModel) -> None:
    viewer = opened(faults)
    viewer.state.visible = {"boundary_edges"}
    left, right = middle(viewer, [0, 1, 2]), middle(viewer, [10, 11, 12])
    viewer.set_box(np.array([[-0.1, 2], [-2, 2], [-2, 2]]))
    image = viewer.image()
    assert tuple(around(image, left, 0)[0]) == BACKGROUND
    assert tuple(around(image, right, 0)[0]) == GREEN
    assert not has(image, middle(viewer, [0, 1]), STYLES["boundary_edges"].color)
    viewer.controls.key("k")  # the box is switched off
    assert tuple(around(viewer.image(), left, 0)[0]) == RED
    viewer.controls.key("k")
    assert viewer.stage.box is not None


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


def test_the_figure_has_four_panels_with_their_marks(gl: None, demo: ViewModel) -> None:
    from msb_viewers.figure import COLUMNS, render_columns

    images = render_columns(demo, side=240)
    assert len(images) == 4
    for column, (whole, close) in zip(COLUMNS, images, strict=True):
        for image in (whole, close):
            assert image.shape == (240, 240, 3)
            for kind in column.kinds[:1]:
                near = np.abs(image.astype(int) - STYLES[kind].color).max(axis=2) < 60
                assert near.sum() > 20, (column.title, kind)

"""The deployment viewer's window, off-screen, with the real renderers, thread and child process."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.errors import DeviceError
from msb_viewers.camera import Pose
from msb_viewers.deployment.painter import Order, Painter
from msb_viewers.deployment.shots import Shot, TierRenderers
from msb_viewers.deployment.solver import ReferenceSolver
from msb_viewers.deployment.state import CompareState
from msb_viewers.deployment.viewer import CompareViewer
from tests.viewers.compare import (
    HEIGHT,
    WIDTH,
    checkpoint_asset,
    comparison,
    flat_shot,
    photographs,
    seen_by_vtk,
    small_cameras,
)
from tests.viewers.conftest import MOVE, PRESS, RELEASE, mouse

FAST = ("dedicated", "standard")


@pytest.fixture
def opened(gl: None) -> Iterator[Any]:
    """Return a function that opens a viewer off-screen; all are closed in the end."""
    with ExitStack() as stack:

        def start(state: CompareState, size: tuple[int, int] = (640, 480)) -> CompareViewer:
            viewer = stack.enter_context(closing(CompareViewer(state, size=size, off_screen=True)))
            viewer.settle(60)
            viewer.refresh()
            return viewer

        yield start


def free_state(**more: Any) -> CompareState:
    return CompareState.first(comparison([], FAST), **more)


def test_the_window_shows_the_composed_picture(opened: Any) -> None:
    viewer = opened(CompareState.first(comparison(tiers=FAST)))
    assert viewer.settled
    assert set(viewer.shots) == set(FAST)
    assert viewer.shots["dedicated"].image.shape == (HEIGHT, WIDTH, 3)
    assert (viewer.image() == viewer.composition.image).all()


def test_dragging_turns_the_asset_in_every_path(opened: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("msb_viewers.deployment.painter.FLUID_SECONDS", 1e-6)  # nothing is fast enough
    viewer = opened(free_state())
    viewer.controls.attach()
    before = dict(viewer.shots)
    full = before["standard"].image.shape
    mouse(viewer, 200, 240, PRESS)
    for x in range(210, 300, 10):
        mouse(viewer, x, 240, MOVE)
    end = time.monotonic() + 30
    while viewer.shots["standard"].image.shape == full and time.monotonic() < end:
        mouse(viewer, 290, 240, "TimerEvent")
        time.sleep(0.01)
    moving = viewer.shots["standard"].image
    assert moving.shape[0] < full[0]
    assert viewer.shots["dedicated"].image.shape == moving.shape  # both of one moment
    angle = viewer.pose
    mouse(viewer, 290, 240, "TimerEvent")
    assert (viewer.pose.eye == angle.eye).all()  # VTK's style does not go on by itself
    mouse(viewer, 290, 240, RELEASE)
    viewer.settle(60)
    for tier in FAST:
        assert viewer.shots[tier].image.shape == full
        assert (viewer.shots[tier].image != before[tier].image).any()
    around = viewer.state.around
    assert np.linalg.norm(viewer.state.free.center - around.center) == pytest.approx(
        around.first_pose().distance, rel=1e-3
    )


def test_what_is_drawn_is_what_vtks_camera_sees(opened: Any) -> None:
    viewer = opened(free_state(layout="wipe"))
    target = viewer.state.around.center
    viewer.pose = Pose(target + np.array([0.3, 0.9, 2.0]), target + 0.05, np.array([0.1, 1.0, 0.0]))
    viewer.turned()
    viewer.settle(60)
    camera = viewer.state.picture_camera(viewer.size)
    box = viewer.composition.pictures["wipe"]
    assert (camera.width, camera.height) == (box.width, box.height)
    viewer._set_angle()
    viewer.camera.SetClippingRange(0.1, 10)
    points = np.random.default_rng(0).uniform(0.2, 0.8, (20, 3))
    # From the middle of the window as from the middle of the picture: a drag moves things with the mouse.
    theirs = seen_by_vtk(viewer.camera, viewer.size, points)
    ours = camera.project(points)[0] - [camera.width / 2, camera.height / 2]
    assert ours == pytest.approx(theirs, abs=1e-6)


def test_where_there_is_no_camera_the_view_stays(opened: Any) -> None:
    viewer = opened(free_state())
    before = viewer.state.free
    viewer.pose = Pose(viewer.pose.eye, viewer.pose.eye, viewer.pose.up)
    viewer.turned()
    assert viewer.state.free is before
    assert "same point" in viewer.state.message
    assert viewer.pose.distance == pytest.approx(viewer.state.around.first_pose().distance)


def test_stepping_shows_each_camera_with_its_photograph(opened: Any, tmp_path: Path) -> None:
    colors = [(200, 0, 0), (0, 200, 0), (0, 0, 200)]
    scene = comparison(photographs(tmp_path, colors), ("truth", "standard"))
    viewer = opened(CompareState.first(scene))
    for key, at in (("n", 1), ("n", 2), ("p", 1), ("p", 0), ("p", 2)):
        assert viewer.controls.key(key)
        viewer.settle(60)
        box = viewer.composition.pictures["truth"]
        image = viewer.image()
        assert tuple(image[box.top + box.height // 2, box.left + box.width // 2]) == colors[at]
        assert viewer.composer.decibels(viewer.shots["truth"], viewer.shots["standard"]) is not None
    viewer.turned()
    viewer.settle(60)
    assert viewer.state.view is None
    assert viewer.shots["truth"].image is None
    viewer.controls.key("Home")
    viewer.settle(60)
    assert viewer.state.view is scene.views[2]
    assert viewer.shots["truth"].image is not None


def test_the_divider_is_dragged_and_moved_by_keys(opened: Any) -> None:
    viewer = opened(free_state(layout="wipe"))
    viewer.controls.attach()
    box, grip = viewer.composition.pictures["wipe"], viewer.composition.divider
    pose, y = viewer.pose, box.top + box.height // 2
    mouse(viewer, grip.left + grip.width // 2, y, PRESS)
    mouse(viewer, box.left + box.width // 4, y, MOVE, RELEASE)
    assert viewer.state.divider == pytest.approx(0.25, abs=0.01)
    assert (viewer.pose.eye == pose.eye).all()
    viewer.controls.key("Right")
    assert viewer.state.divider == pytest.approx(0.27, abs=0.01)
    assert not viewer.controls.press(box.left + 3, box.top + 30)


def test_layouts_and_paths_are_switched_by_keys(opened: Any) -> None:
    viewer = opened(free_state())
    for key, kinds in (
        ("2", ["wipe"]),
        ("3", ["difference", "dedicated", "standard"]),
        ("1", ["dedicated", "standard"]),
    ):
        viewer.controls.key(key)
        viewer.settle(60)
        viewer.refresh()
        assert list(viewer.composition.pictures) == kinds
        assert all(shot.image is not None for shot in viewer.shots.values())


def test_every_key_of_the_help_does_something(
    opened: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    viewer = opened(CompareState.first(comparison(tiers=FAST)), (400, 300))
    names = [*"123abnprgl", "plus", "minus", "Left", "Right", "s", "Home", "h", "Escape", "KP_Add"]
    for name in names:
        assert viewer.controls.key(name), name
    assert not viewer.controls.key("j")
    assert [path.name for path in tmp_path.iterdir()] == ["demo_view_1.png"]


def test_the_window_does_not_wait_for_the_reference(opened: Any) -> None:
    state = CompareState.first(comparison(settings={"supersample": 1}))
    state.reference = False
    viewer = opened(state)
    assert "reference" not in viewer.shots
    assert "R computes it" in viewer.busy()["reference"]
    start = time.perf_counter()
    viewer.controls.key("r")
    assert time.perf_counter() - start < 2
    viewer.settle(60)
    assert viewer.shots["reference"].image.shape == (HEIGHT, WIDTH, 3)
    close = viewer.composer.decibels(viewer.shots["reference"], viewer.shots["dedicated"])
    assert close > 50
    viewer.controls.key("n")  # of another camera
    assert "reference" not in viewer.shots


# The thread and the process alone ------------------------------------------------------------------------


class Slow(TierRenderers):
    """Paths that draw nothing, in a time that is told."""

    def __init__(self, seconds: dict[str, float]) -> None:
        super().__init__(comparison())
        self.seconds = seconds
        self.threads: set[int] = set()

    def shoot(self, tier: str, camera: Any, view: Any = None, background: Any = None) -> Shot:
        self.threads.add(threading.get_ident())
        time.sleep(self.seconds[tier])
        if tier == "standard" and camera.width > 1000:
            raise DeviceError("DEVICE_MEMORY", "it does not fit")
        return flat_shot(tier, (0, 0, 0), (camera.width, camera.height))


def order(number: int, tiers: tuple[str, ...] = FAST, *, moving: bool = False, width: int = 64) -> Order:
    camera = small_cameras(1)[0].resized(width, width)
    return Order(number, camera, None, tiers, (0.0, 0.0, 0.0), moving)


def wait(painter: Painter, seconds: float = 20.0) -> list[tuple[Order, Shot]]:
    end = time.monotonic() + seconds
    while not painter.idle and time.monotonic() < end:
        time.sleep(0.002)
    return [*painter.collect()]


def test_the_newest_order_counts() -> None:
    renderers = Slow({"dedicated": 0.05, "standard": 0.05})
    with closing(Painter(renderers)) as painter:
        for number in range(1, 30):
            painter.ask(order(number))
        found = wait(painter)
        assert [one.number for one, _ in found][-2:] == [29, 29]
        assert len(found) < 12
        assert threading.get_ident() not in renderers.threads


@pytest.mark.slow
def test_while_moving_paths_come_together_and_slow_ones_are_left_out() -> None:
    renderers = Slow({"dedicated": 0.3, "standard": 0.0})
    with closing(Painter(renderers)) as painter:
        for number in range(1, 6):
            painter.ask(order(number, moving=True, width=512))
            found = wait(painter)
            assert {one.number for one, _ in found} == {number}
            assert len({shot.image.shape[1] for _, shot in found}) == 1
        assert [shot.tier for _, shot in found] == ["standard"]
        assert painter.skips("dedicated")
        renderers.seconds["dedicated"] = 0.0
        painter.ask(order(6))
        assert len(wait(painter)) == 2
        assert not painter.skips("dedicated")


def test_an_error_is_said_in_its_panel_and_the_rest_goes_on() -> None:
    with closing(Painter(Slow({"dedicated": 0.0, "standard": 0.0}))) as painter:
        painter.ask(order(1, width=1100))
        shots = {shot.tier: shot for _, shot in wait(painter)}
        assert shots["dedicated"].image is not None
        assert shots["standard"].image is None
        assert shots["standard"].why == "DEVICE_MEMORY: it does not fit"


def collected(solver: ReferenceSolver, seconds: float = 60.0) -> list[Shot]:
    end, found = time.monotonic() + seconds, []
    while solver.busy and time.monotonic() < end:
        shot = solver.collect()
        found += [] if shot is None else [shot]
        time.sleep(0.01)
    return found


@pytest.mark.slow
def test_the_reference_comes_from_a_child_first_small_then_whole() -> None:
    camera = small_cameras(1)[0].resized(200, 150)
    with closing(ReferenceSolver(checkpoint_asset(), {"sh_degree": 0, "supersample": 1})) as solver:
        solver.start(small_cameras(1)[0].resized(3000, 2000), (1.0, 1.0, 1.0))
        assert "3000 x 2000" in solver.busy
        solver.start(camera, (1.0, 0.0, 1.0))  # instead of it
        shots = collected(solver)
        assert [shot.image.shape for shot in shots] == [(120, 160, 3), (150, 200, 3)]
        scene = comparison(settings={"sh_degree": 0, "supersample": 1})
        with TierRenderers(scene) as renderers:
            wanted = renderers.shoot("reference", camera, None, (1.0, 0.0, 1.0)).image
        assert (shots[-1].image == wanted).all()
    assert solver._process is None


@pytest.mark.slow
def test_a_child_that_died_is_told_and_replaced() -> None:
    with closing(ReferenceSolver(checkpoint_asset(), {})) as solver:
        solver.start(small_cameras(1)[0].resized(2000, 1500), (1.0, 1.0, 1.0))
        solver._process.kill()
        shots = collected(solver)
        assert "ended" in shots[-1].why
        solver.start(small_cameras(1)[0], (1.0, 1.0, 1.0))
        assert collected(solver)[-1].image is not None

"""The remaining time of a run is estimated from finished tasks of the same kind."""

import contextlib
import io
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rich.console import Console

from msb.bench.commands.run import draw_stage
from msb.bench.progress import RemainingTime, Stage
from msb.bench.run import run_protocol
from tests.bench.protocols import Notes, make_protocol


class Clock:
    """A clock that is set by hand."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def make_stage(kinds: str, at_once: int = 1) -> tuple[Stage, Clock]:
    """Return a stage with one task for each letter, which is the kind of the task, and its clock."""
    clock = Clock()
    names = [f"{kind}{number}" for number, kind in enumerate(kinds)]
    return Stage("cells", names, kinds, at_once=at_once, clock=clock), clock


def test_there_is_no_estimate_before_a_task_of_the_kind_has_ended() -> None:
    stage, clock = make_stage("abab")
    assert (stage.current, stage.done, stage.estimate_rest()) == (("a0",), 0, None)
    clock.now += 10
    stage.end(0)
    assert (stage.current, stage.done) == (("b1",), 1)
    assert stage.estimate_rest() == RemainingTime(10, at_least=True)  # no task of kind b has ended
    clock.now += 2
    stage.end(1)
    assert stage.estimate_rest() == RemainingTime(12, at_least=False)
    clock.now += 4
    assert stage.estimate_rest() == RemainingTime(8, at_least=False)
    stage.end(2)
    stage.end(3)
    assert (stage.current, stage.done, stage.estimate_rest()) == ((), 4, None)


def test_a_task_that_takes_longer_than_the_average_is_not_estimated() -> None:
    stage, clock = make_stage("aaa")
    clock.now += 10
    stage.end(0)
    clock.now += 15
    assert stage.estimate_rest() == RemainingTime(10, at_least=True)
    stage.end(1)
    clock.now += 20
    assert stage.estimate_rest() is None


def test_several_workers_share_the_remaining_time() -> None:
    stage, clock = make_stage("aaaaa", at_once=2)
    assert stage.current == ("a0", "a1")
    clock.now += 10
    stage.end(1)
    assert stage.current == ("a0", "a2")
    assert stage.estimate_rest() == RemainingTime(15, at_least=True)  # a0 takes longer than a1 did
    stage.end(0, 10.0)
    assert stage.estimate_rest() == RemainingTime(15, at_least=False)
    stage.end(2)
    stage.end(3)
    clock.now += 1
    assert stage.current == ("a4",)
    assert stage.estimate_rest() == RemainingTime(pytest.approx(10 * 2 / 4 - 1), at_least=False)


@pytest.mark.parametrize("seconds", [0.2, 44, 12_000])
def test_the_progress_bar_takes_two_lines(seconds: float) -> None:
    name = "tanksandtemples truck triangle_splatting dedicated"
    stage = Stage("cells", [name, "b", "c"], "aab", then=["timing", "videos"], at_once=2, clock=lambda: 0.0)
    stage.end(0, seconds)
    text = io.StringIO()
    Console(file=text, width=80, color_system=None, force_terminal=True).print(draw_stage(stage))
    bar, second = text.getvalue().splitlines()
    assert bar.split()[:2] == ["cells", "1/3"]
    assert len(bar) == 80
    assert len(second) <= 80


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_run_updates_its_stages(tmp_path: Path, jobs: int) -> None:
    states: list[tuple[str, int, tuple[str, ...], tuple[str, ...]]] = []

    class Watch(Notes):
        """Records the state of each stage at its start and after each task."""

        @contextlib.contextmanager
        def stage(self, stage: Stage) -> Iterator[Callable[[str], None]]:
            def record(_name: str = "") -> None:
                states.append((stage.title, stage.done, stage.current, stage.then))

            record()
            yield record
            assert stage.done == len(stage.names)

    assert run_protocol(make_protocol(tmp_path, ("two_dts",)), jobs=jobs, watch=Watch()).exit_status == 0
    cells = [f"nerf_synthetic pebble two_dts {name}" for name in ("dedicated", "standard", "exported_mesh")]
    first = next(state for state in states if state[0] == "cells")
    assert first == ("cells", 0, tuple(cells[:jobs]), ("timing",))
    timing = [state[1:] for state in states if state[0] == "timing"]
    assert timing == [(0, (cells[0],), ()), (1, (cells[1],), ()), (2, (), ())]

"""The time left is told from finished tasks of the same kind, and not told where there are none."""

import contextlib
import io
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from rich.console import Console

from msb.bench.commands.run import stage_lines
from msb.bench.progress import Left, Stage
from msb.bench.run import run_protocol
from tests.bench.protocols import Notes, protocol


class Clock:
    """A clock that is set by hand."""

    now = 100.0

    def __call__(self) -> float:
        """Return its time."""
        return self.now


def stage(kinds: str, at_once: int = 1) -> tuple[Stage, Clock]:
    """Return a stage with a task a letter, which is its kind, and its clock."""
    clock = Clock()
    names = [f"{kind}{number}" for number, kind in enumerate(kinds)]
    return Stage("cells", names, kinds, at_once=at_once, clock=clock), clock


def test_nothing_is_told_before_a_task_of_the_kind_has_ended() -> None:
    one, clock = stage("abab")
    assert (one.now, one.done, one.left()) == (("a0",), 0, None)
    clock.now += 10
    one.end(0)
    assert (one.now, one.done) == (("b1",), 1)
    assert one.left() == Left(10, at_least=True)  # of kind b nothing is known
    clock.now += 2
    one.end(1)
    assert one.left() == Left(12, at_least=False)
    clock.now += 4
    assert one.left() == Left(8, at_least=False)
    one.end(2)
    one.end(3)
    assert (one.now, one.done, one.left()) == ((), 4, None)


def test_a_task_that_takes_longer_than_others_did_is_of_unknown_length() -> None:
    one, clock = stage("aaa")
    clock.now += 10
    one.end(0)
    clock.now += 15
    assert one.left() == Left(10, at_least=True)
    one.end(1)
    clock.now += 20
    assert one.left() is None


def test_several_workers_take_the_first_tasks_and_share_the_time() -> None:
    one, clock = stage("aaaaa", at_once=2)
    assert one.now == ("a0", "a1")
    clock.now += 10
    one.end(1)
    assert one.now == ("a0", "a2")
    assert one.left() == Left(15, at_least=True)  # a0 takes longer
    one.end(0, 10.0)
    assert one.left() == Left(15, at_least=False)
    one.end(2)
    one.end(3)
    clock.now += 1
    assert one.now == ("a4",)
    assert one.left() == Left(pytest.approx(10 * 2 / 4 - 1), at_least=False)


@pytest.mark.parametrize("seconds", [0.2, 44, 12_000])
def test_the_bar_takes_two_lines_of_a_terminal(seconds: float) -> None:
    name = "tanksandtemples truck triangle_splatting dedicated"
    one = Stage("cells", [name, "b", "c"], "aab", then=["timing", "videos"], at_once=2, clock=lambda: 0.0)
    one.end(0, seconds)
    text = io.StringIO()
    Console(file=text, width=80, color_system=None, force_terminal=True).print(stage_lines(one))
    bar, second = text.getvalue().splitlines()
    assert bar.split()[:2] == ["cells", "1/3"]
    assert len(bar) == 80
    assert len(second) <= 80


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_run_keeps_its_stages_up_to_date(tmp_path: Path, jobs: int) -> None:
    seen: list[tuple[str, int, tuple[str, ...], tuple[str, ...]]] = []

    class Watch(Notes):
        """Writes down the state at the beginning and after each task."""

        @contextlib.contextmanager
        def stage(self, stage: Stage) -> Iterator[Callable[[str], None]]:
            def look(_name: str = "") -> None:
                seen.append((stage.title, stage.done, stage.now, stage.then))

            look()
            yield look
            assert stage.done == len(stage.names)

    assert run_protocol(protocol(tmp_path, ("two_dts",)), jobs=jobs, watch=Watch()).exit_status == 0
    cells = [f"nerf_synthetic pebble two_dts {name}" for name in ("dedicated", "standard", "exported_mesh")]
    first = next(one for one in seen if one[0] == "cells")
    assert first == ("cells", 0, tuple(cells[:jobs]), ("timing",))
    timing = [one[1:] for one in seen if one[0] == "timing"]
    assert timing == [(0, (cells[0],), ()), (1, (cells[1],), ()), (2, (), ())]

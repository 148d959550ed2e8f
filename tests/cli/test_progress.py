"""If standard error is not a terminal, long work reports its progress as lines."""

import io
import sys
import threading
import time
from collections.abc import Callable
from itertools import pairwise

import pytest

from msb.cli import progress
from msb.cli.output import Output
from msb.cli.progress import ProgressLines


class Terminal(io.StringIO):
    """A stream that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write a line every 0.05 s."""
    monkeypatch.setattr(progress, "INTERVAL", 0.05)


def wait_for(condition: Callable[[], bool]) -> None:
    """Wait until `condition` is true, at most 10 s."""
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


class Written:
    """The text on standard error so far."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys, self._text = capsys, ""

    def getvalue(self) -> str:
        self._text += self._capsys.readouterr().err
        return self._text


@pytest.fixture
def stream(capsys: pytest.CaptureFixture[str]) -> Written:
    """Return the text on standard error, which is not a terminal."""
    return Written(capsys)


def test_one_step_that_takes_long_is_reported(stream: Written) -> None:
    with Output().counted("rendering", 1):
        wait_for(lambda: "rendering 0/1" in stream.getvalue())
    with Output().progress("reading a.ply"):
        wait_for(lambda: "reading a.ply" in stream.getvalue())


def test_finished_steps_and_stages_are_counted(stream: Written) -> None:
    with Output().counted("trying", 3) as step:
        step()
        step()
        wait_for(lambda: "trying 2/3" in stream.getvalue())
    with Output().bars("steps") as update:
        update("views", 0, 1)
        wait_for(lambda: "progress: views," in stream.getvalue())
        update("texture", 1, 4)
        wait_for(lambda: "texture 25 %" in stream.getvalue())


def test_a_run_names_its_stage_and_cell(stream: Written) -> None:
    pytest.importorskip("msb.bench")
    from msb.bench.commands.run import show_stage
    from msb.bench.progress import Stage

    stage = Stage("cells", ["a", "b"], "kk")
    with show_stage(stage, Output()):
        stage.end(0)
        wait_for(lambda: "cells 1/2, b" in stream.getvalue())


def test_quiet_and_terminals_get_no_lines(stream: Written, monkeypatch: pytest.MonkeyPatch) -> None:
    assert Output(quiet=True).progress_lines is None
    with Output(quiet=True).counted("rendering", 1):
        time.sleep(0.2)
    assert not stream.getvalue()
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert Output().progress_lines is None


def test_lines_are_at_most_one_per_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "INTERVAL", 0.2)
    lines: list[float] = []
    begin = time.monotonic()
    writer = ProgressLines(lambda _: lines.append(time.monotonic()))
    with writer.watch(lambda: "outer"):
        for _ in range(6):
            writer.write_first("first")
            with writer.watch(lambda: "inner"):
                time.sleep(0.1)
    assert lines[0] - begin < 0.1
    assert 2 <= len(lines) <= 4
    assert all(after - before >= 0.19 for before, after in pairwise(lines))


def test_the_innermost_work_is_reported_and_threads_end() -> None:
    lines: list[str] = []
    writer = ProgressLines(lines.append)
    before = threading.active_count()
    with writer.watch(lambda: "outer"):
        with writer.watch(lambda: "inner"):
            wait_for(lambda: bool(lines))
        assert lines[0] == "inner"
        wait_for(lambda: lines[-1] == "outer")
    wait_for(lambda: threading.active_count() <= before)

"""Functions in child processes: results, time and memory limits, crashes and interrupts."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.base import children
from msb.base.children import Reply, run_in_child, run_in_children
from msb.base.limits import Limits
from msb.errors import OutputError, UsageError
from tests.base.children_work import describe, misbehave
from tests.conftest import ROOT

LINUX = pytest.mark.skipif(sys.platform != "linux", reason="only Linux has this")


def fail(way: str, limits: Limits | None = None) -> Reply:
    return run_in_child(misbehave, way, {}, limits or Limits())


def test_data_and_arrays_travel_both_ways(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("numpy.py", "json.py"):  # the child must not import files of the current folder
        (tmp_path / name).write_text("raise SystemExit('taken over')")
    given = {"mesh.faces": np.arange(6, dtype=np.int32).reshape(2, 3), "points": np.ones((2, 3), np.float32)}
    reply = run_in_child(describe, "a word", given, Limits())
    assert reply.why == "", reply
    assert reply.data == {"word": "a word", "arrays": {"mesh.faces": ["<i4", 2, 3], "points": ["<f4", 2, 3]}}
    assert {name: array.tolist() for name, array in reply.arrays.items()} == {
        name: (2 * array).tolist() for name, array in given.items()
    }
    assert reply.seconds is not None
    assert reply.ended_by is None
    assert {path.name for path in tmp_path.iterdir()} == {"numpy.py", "json.py"}
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("way", "why", "ended_by"),
    [
        ("raise", "there are holes", None),
        ("abort", "SIGABRT", "crash"),
        ("exit", "status 1): xxx", "crash"),
        ("half a reply", "status 0", "crash"),
        ("no JSON", "ValueError", "crash"),
        ("bad_alloc", "4 GiB", "memory"),
    ],
)
def test_the_reason_of_a_failure_is_reported(way: str, why: str, ended_by: str | None) -> None:
    reply = fail(way)
    assert (reply.data, reply.arrays, reply.ended_by) == (None, {}, ended_by)
    assert why in reply.why
    assert len(reply.why) < 300


def test_a_hang_ends_at_its_limit() -> None:
    start = time.monotonic()
    reply = fail("hang", Limits(0.3))
    assert (reply.data, reply.ended_by, reply.seconds) == (None, "time", 0.3)
    assert time.monotonic() - start < 30


@pytest.mark.slow
@LINUX
def test_children_of_a_hanging_process_are_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)  # it caches the folder
    assert fail("hang with a child", Limits(10.0)).ended_by == "time"
    assert is_gone(int((tmp_path / "pid").read_text()))
    assert [path.name for path in tmp_path.iterdir()] == ["pid"]


@LINUX
def test_too_much_memory_is_reported_with_the_limit() -> None:
    reply = fail("memory of NumPy", Limits(memory=1.0))
    assert reply.ended_by == "memory"
    assert "1 GiB" in reply.why


def test_a_crash_does_not_affect_other_calls() -> None:
    replies = run_in_children(misbehave, ["abort", "one", "raise", "two"], {}, Limits(), at_once=2)
    assert {word: reply.data for word, reply in replies.items()} == {
        "abort": None,
        "one": "one",
        "raise": None,
        "two": "two",
    }


def test_a_full_disk_blames_the_folder_of_temporary_files() -> None:
    with pytest.raises(OutputError, match="OUTPUT_UNWRITABLE") as caught:
        fail("full disk")
    assert caught.value.file == tempfile.gettempdir()


def test_an_interrupt_leaves_no_child_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []
    honest = children._start

    def start(*args: Any) -> Any:
        started.append(honest(*args))
        return started[-1]

    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(children, "_start", start)
    monkeypatch.setattr(children.time, "sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_in_children(misbehave, ["hang", "hang too", "hang again"], {}, Limits(), at_once=2)
    assert [child.returncode for child in started] == [-signal.SIGKILL] * 2


@pytest.mark.slow
@LINUX
def test_a_child_ends_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    code = (
        "from msb.base.children import run_in_child\nfrom msb.base.limits import Limits\n"
        "from tests.base.children_work import misbehave\n"
        "run_in_child(misbehave, 'hang with a child', {}, Limits())"
    )
    variables = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    parent = subprocess.Popen([sys.executable, "-c", code], env=variables)
    deadline = time.monotonic() + 60
    pid_file = tmp_path / "pid"
    while not (pid_file.exists() and pid_file.read_text()) and time.monotonic() < deadline:
        time.sleep(0.05)
    grandchild = int(pid_file.read_text())
    child = int(Path(f"/proc/{grandchild}/stat").read_text("ascii").rpartition(")")[2].split()[1])
    parent.kill()
    parent.wait()
    try:
        assert is_gone(child)
    finally:
        os.kill(grandchild, signal.SIGKILL)  # grandchildren are not killed automatically


def is_gone(number: int) -> bool:
    """Return whether a process ends within 20 s. A zombie counts as ended."""
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        try:
            if Path(f"/proc/{number}/stat").read_text("ascii").rpartition(")")[2].split()[0] == "Z":
                return True
        except OSError:
            return True
        time.sleep(0.05)
    return False


@pytest.mark.parametrize(
    "limits", [{"seconds": 0.0}, {"memory": -1.0}, {"seconds": float("nan")}, {"seconds": "x"}]
)
def test_limits_are_positive_numbers(limits: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="USAGE"):
        Limits(**limits)

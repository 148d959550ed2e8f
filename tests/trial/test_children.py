"""Attempts in child processes: one that hangs, crashes or takes too much is ended and reported so."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

import msb
from msb.base import extras
from msb.errors import MeshError, OutputError, UsageError
from msb.trial import children, registry
from msb.trial.children import run_attempt
from msb.trial.limits import Limits
from msb.trial.registry import TASKS, chosen_tasks
from msb.trial.run import try_asset
from tests.conftest import ROOT
from tests.trial.conftest import box

if TYPE_CHECKING:
    from msb.trial.task import Reply

FAKE = """
import sys
from dataclasses import replace
from pathlib import Path
import numpy as np
from msb.trial import children
from msb.trial.task import Made
def work(mesh, parameters, given):
    {work}
task = children.TASKS["solid"]
children.TASKS["solid"] = replace(task, attempts=(replace(task.attempts[1], work=work),))
children.serve("solid", "trimesh", Path(sys.argv[1]), float(sys.argv[2]))
"""


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Return a function that puts a statement in the place of what trimesh is asked."""

    def become(work: str) -> None:
        def command(_task: str, _library: str, folder: str, memory: str) -> list[str]:
            return [sys.executable, "-c", FAKE.replace("{work}", work), folder, memory]

        monkeypatch.setattr(children, "command", command)

    return become


def ask(limits: Limits | None = None) -> Reply:
    task = TASKS["solid"]
    return run_attempt(task, task.attempts[1], box(), {}, limits or Limits())


def test_what_is_made_comes_back(fake: Callable[[str], None]) -> None:
    fake("return Made({'faces': len(mesh.faces)}, {'again': mesh}, {'rows': np.arange(3)})")
    reply = ask()
    assert reply.made is not None, reply.why
    assert reply.made.numbers == {"faces": 12}
    assert reply.made.meshes["again"].sha256 == box().sha256
    assert reply.made.arrays["rows"].tolist() == [0, 1, 2]
    assert reply.version
    assert reply.seconds is not None


def test_a_task_that_hangs_is_ended_and_reported_with_its_limit(fake: Callable[[str], None]) -> None:
    fake("import time; time.sleep(600)")
    start = time.monotonic()
    reply = ask(Limits(seconds=0.3))
    assert (reply.made, reply.why, reply.ended_by) == (
        None,
        "it did not end within 0.3 s (--seconds gives more)",
        "time",
    )
    assert time.monotonic() - start < 30


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux holds a process to a limit of memory")
@pytest.mark.parametrize("work", ["return np.ones(1 << 29)", "return bytearray(1 << 32)"])
def test_a_task_that_takes_too_much_memory_is_reported_with_its_limit(
    fake: Callable[[str], None], work: str
) -> None:
    fake(work)
    reply = ask(Limits(memory=1.0))
    assert (reply.why, reply.ended_by) == ("it needs more memory than 1 GiB", "memory")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("work", "why", "ended_by"),
    [
        ("raise ValueError('there are holes')", "there are holes", None),
        ("raise KeyError", "KeyError", None),
        ("import os; os.abort()", "it crashed (SIGABRT)", "crash"),
        ("sys.exit(3)", "it crashed (status 3)", "crash"),
        ("sys.exit(0)", "[Errno 2] No such file", "crash"),
        (
            "mesh.vertices[0] = np.nan; return Made({}, {'again': mesh})",
            "vertices of the mesh again are not all finite",
            "crash",
        ),
        ("return Made({'volume': float('nan')})", "it crashed (status 1)", "crash"),
        (
            "sys.stderr.write('std::bad_alloc'); import os; os.abort()",
            "it needs more memory than 4 GiB",
            "memory",
        ),
    ],
)
def test_what_a_library_says_is_the_reason(
    fake: Callable[[str], None], work: str, why: str, ended_by: str | None
) -> None:
    fake(work)
    reply = ask()
    assert reply.made is None
    assert reply.why.startswith(why)
    assert reply.ended_by == ended_by


def test_a_child_that_has_no_room_for_what_it_made_blames_the_folder_of_temporary_files(
    fake: Callable[[str], None],
) -> None:
    full = "import errno; raise OSError(errno.ENOSPC, 'no room')"
    fake(f"children.write_npy = lambda *_: exec({full!r}); return Made({{}}, {{}}, {{'a': np.ones(3)}})")
    with pytest.raises(OutputError, match="temporary files cannot be written: No space left") as caught:
        ask()
    assert (caught.value.code, caught.value.file) == ("OUTPUT_UNWRITABLE", tempfile.gettempdir())


def test_an_interrupt_leaves_no_child_behind(
    fake: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    fake("import time; time.sleep(600)")
    started: list[subprocess.Popen[bytes]] = []
    honest = subprocess.Popen

    def start(*args: Any, **options: Any) -> Any:
        started.append(honest(*args, **options))
        return started[-1]

    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(children.subprocess, "Popen", start)
    monkeypatch.setattr(children.time, "sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        ask()
    assert [child.returncode for child in started] == [-signal.SIGKILL]


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="a child asks Linux to be ended with its parent")
def test_a_child_ends_with_a_parent_that_is_killed(tmp_path: Path) -> None:
    code = (
        "import subprocess, sys\n"
        "child = subprocess.Popen([sys.executable, '-c', 'from msb.trial.limits import end_with_parent\\n"
        "end_with_parent(); print(1, flush=True); import time; time.sleep(600)'], stdout=subprocess.PIPE)\n"
        "child.stdout.readline(); print(child.pid, flush=True); import time; time.sleep(600)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, cwd=ROOT)
    assert parent.stdout is not None
    number = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline:
        try:
            os.kill(number, 0)
        except ProcessLookupError:
            return
        if _is_zombie(number):
            return
        time.sleep(0.05)
    pytest.fail("the child is still there")


def _is_zombie(number: int) -> bool:
    try:
        with open(f"/proc/{number}/stat", encoding="ascii") as file:  # noqa: PTH123 - it may vanish
            return file.read().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def test_a_missing_library_is_not_run_and_named(monkeypatch: pytest.MonkeyPatch, demo_asset: Path) -> None:
    monkeypatch.setattr(registry, "is_installed", lambda module: module not in ("coacd", "igl"))
    found = try_asset(msb.load(demo_asset), ["collision", "subdivide"])
    assert [one.outcome for one in found.trials] == ["not_run", "not_run"]
    assert found.trials[1].why is not None
    assert "coacd and igl not installed" in found.trials[1].why
    assert 'pip install "meshsplatbench[trial]"' in found.trials[1].why


@pytest.mark.parametrize(
    ("tasks", "absent", "said"),
    [
        ("", "xatlas fast_simplification pymeshlab igl manifold3d coacd trimesh",
         "trying uv, decimate_50, decimate_25, decimate_10, subdivide, boolean, collision, solid needs"),
        ("", "xatlas fast_simplification pymeshlab igl manifold3d coacd trimesh",
         "self_intersections can be tried without it"),
        ("uv", "xatlas", "trying uv needs the extra trial (xatlas is not installed)"),
        ("uv,intersections", "xatlas", "self_intersections can be tried without it"),
        ("uv,boolean", "xatlas", None),
        ("solid", "manifold3d", None),
        ("intersections", "manifold3d", None),
    ],
)  # fmt: skip
def test_where_no_library_is_there_for_some_task_the_extra_is_missing(
    monkeypatch: pytest.MonkeyPatch, tasks: str, absent: str, said: str | None
) -> None:
    for module in (registry, extras):
        monkeypatch.setattr(module, "is_installed", lambda name: name not in absent.split())
    chosen = chosen_tasks([tasks] if tasks else [])
    if said is None:
        registry.check_libraries(chosen)
        return
    with pytest.raises(UsageError) as caught:
        registry.check_libraries(chosen)
    assert caught.value.code == "EXTRA_MISSING"
    assert said in caught.value.message


@pytest.mark.parametrize(
    "limits", [{"seconds": 0.0}, {"memory": -1.0}, {"seconds": float("nan")}, {"seconds": "x"}]
)
def test_limits_are_positive_numbers(limits: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="it must be a positive number"):
        Limits(**limits)


@pytest.mark.parametrize("weld", [-1e-3, 0, True, float("nan"), float("inf"), "EXACT"])
def test_a_weld_that_is_none_is_refused_as_an_audit_refuses_it(weld: Any, demo_asset: Path) -> None:
    with pytest.raises(MeshError) as caught:
        msb.trial(demo_asset, "intersections", weld=weld)
    assert caught.value.code == "WELD_DISTANCE"


@pytest.mark.parametrize("wrong", [{"tasks": 3}, {"limits": 3}, {"tasks": [3]}])
def test_what_is_no_task_and_no_limits_is_wrong_usage(wrong: dict[str, Any], demo_asset: Path) -> None:
    with pytest.raises(UsageError):
        msb.trial(demo_asset, **wrong)


def test_a_word_of_a_name_chooses_all_tasks_that_have_it() -> None:
    names = [task.name for task in chosen_tasks(["intersections", "decimate"])]
    assert names == ["decimate_50", "decimate_25", "decimate_10", "self_intersections"]
    assert [task.name for task in chosen_tasks("solid")] == ["solid"]
    assert [task.name for task in chosen_tasks("solid, uv")] == ["uv", "solid"]
    assert [task.name for task in chosen_tasks(["solid,uv"])] == ["uv", "solid"]
    assert [task.name for task in chosen_tasks([])] == list(TASKS)
    with pytest.raises(UsageError, match="there is no task"):
        chosen_tasks(["uvs"])

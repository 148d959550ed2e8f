"""Attempts in child processes, their reasons and limits; tasks, libraries and wrong arguments."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.base import extras
from msb.base.children import Reply
from msb.base.limits import Limits
from msb.errors import MeshError, UsageError
from msb.trial import attempts, registry
from msb.trial.attempts import run_attempt
from msb.trial.registry import TASKS, chosen_tasks
from msb.trial.run import try_asset
from msb.trial.task import Attempted
from tests.trial.conftest import box


def ask(limits: Limits | None = None) -> Attempted:
    task = TASKS["solid"]
    return run_attempt(task, task.attempts[1], box(), {}, limits or Limits())


@pytest.mark.slow
def test_what_is_made_comes_back() -> None:
    tried = ask()
    assert tried.made is not None, tried.why
    assert tried.made.numbers["volume"] == pytest.approx(1)
    assert tried.version
    assert tried.seconds is not None


def test_meshes_and_arrays_travel_as_arrays() -> None:
    meshes, further = {"again": box(), "more": box(2.0)}, {"rows": np.arange(3)}
    made, others = attempts._parted(attempts._joined(meshes, further))
    assert {name: mesh.sha256 for name, mesh in made.items()} == {
        name: mesh.sha256 for name, mesh in meshes.items()
    }
    assert others["rows"].tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("reply", "expected"),
    [
        (Reply(why="too slow", ended_by="time", seconds=1.0), ("too slow", "time", 1.0, False)),
        (Reply(why="holes", seconds=2.0), ("holes", None, 2.0, True)),
        (
            Reply({}, {f"a.{key}": np.full((1, 3), np.nan) for key in ("vertices", "faces", "colors")}),
            ("finite", "crash", None, False),
        ),
    ],
)
def test_why_nothing_was_made_is_told(
    reply: Reply, expected: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(attempts, "run_apart", lambda *_: reply)
    tried = ask()
    assert expected[0] in tried.why
    assert (tried.ended_by, tried.seconds, tried.version is not None) == expected[1:]
    assert tried.made is None


def test_a_missing_library_is_not_run_and_named(monkeypatch: pytest.MonkeyPatch, demo_asset: Path) -> None:
    monkeypatch.setattr(registry, "is_installed", lambda module: module not in ("coacd", "igl"))
    found = try_asset(msb.load(demo_asset), ["collision", "subdivide"])
    assert [one.outcome for one in found.trials] == ["not_run", "not_run"]
    assert all(word in found.trials[1].why for word in ("coacd", "igl", "meshsplatbench[trial]"))


ALL = "xatlas fast_simplification pymeshlab igl manifold3d coacd trimesh"


@pytest.mark.parametrize(
    ("tasks", "absent", "needed"),
    [
        ("", ALL, ["solid", "self_intersections", "xatlas"]),
        ("uv", "xatlas", ["uv", "xatlas"]),
        ("uv,intersections", "xatlas", ["uv", "self_intersections"]),
        ("uv,boolean", "xatlas", []),
        ("solid", "manifold3d", []),
        ("intersections", "manifold3d", []),
    ],
)
def test_the_extra_is_missing_if_no_library_can_do_a_task(
    monkeypatch: pytest.MonkeyPatch, tasks: str, absent: str, needed: list[str]
) -> None:
    for module in (registry, extras):
        monkeypatch.setattr(module, "is_installed", lambda name: name not in absent.split())
    chosen = chosen_tasks([tasks] if tasks else [])
    if not needed:
        registry.check_libraries(chosen)
        return
    with pytest.raises(UsageError) as caught:
        registry.check_libraries(chosen)
    assert caught.value.code == "EXTRA_MISSING"
    assert all(word in caught.value.message for word in needed)


@pytest.mark.parametrize("weld", [-1e-3, 0, True, float("nan"), float("inf"), "EXACT"])
def test_a_weld_that_is_none_is_refused_as_an_audit_refuses_it(weld: Any, demo_asset: Path) -> None:
    with pytest.raises(MeshError) as caught:
        msb.trial(demo_asset, "intersections", weld=weld)
    assert caught.value.code == "WELD_DISTANCE"


def test_a_word_of_a_name_chooses_all_tasks_that_have_it() -> None:
    names = [task.name for task in chosen_tasks(["intersections", "decimate"])]
    assert names == ["decimate_50", "decimate_25", "decimate_10", "self_intersections"]
    assert [task.name for task in chosen_tasks("solid")] == ["solid"]
    assert [task.name for task in chosen_tasks("solid, uv")] == ["uv", "solid"]
    assert [task.name for task in chosen_tasks(["solid,uv"])] == ["uv", "solid"]
    assert [task.name for task in chosen_tasks([])] == list(TASKS)
    for wrong in (["uvs"], 3, [3]):
        with pytest.raises(UsageError):
            chosen_tasks(wrong)


@pytest.mark.parametrize("given", [(-1,), (1, np.nan)])
def test_limits_must_be_positive(given: tuple[Any, ...]) -> None:
    with pytest.raises(msb.MsbError) as caught:
        Limits(*given)
    assert caught.value.code == "USAGE"


def test_cameras_must_be_cameras(demo_asset: Path) -> None:
    cameras: Any = 3
    with pytest.raises(msb.MsbError) as caught:
        msb.trial(msb.open(demo_asset), ["uv"], cameras=cameras)
    assert caught.value.code == "USAGE"

"""Attempts in child processes, the results of trials, and the comparison of repairs."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import Asset, build_asset
from msb.base import extras
from msb.base.children import Reply
from msb.base.limits import Limits
from msb.errors import DeviceError, MeshError, UsageError
from msb.meshes import read_mesh
from msb.meshes.assets import asset_from_mesh
from msb.repair.plan import Options
from msb.scenes import Camera
from msb.trial import attempts, registry, repairs, run
from msb.trial.attempts import run_attempt
from msb.trial.mesh import TrialMesh, prepare_mesh
from msb.trial.registry import TASKS, select_tasks
from msb.trial.repairs import STORED, compare
from msb.trial.run import Trial, try_asset
from msb.trial.task import Attempt, AttemptResult, Output, Task
from tests.conftest import BOOK, TETRAHEDRON
from tests.meshes.glb_json import read_positions
from tests.topology.seamed import textured_cube
from tests.trial.conftest import box, grid, pages, soup, white_mesh


def run_trimesh(limits: Limits | None = None) -> AttemptResult:
    """Run trimesh's attempt at the task "solid" on a box."""
    task = TASKS["solid"]
    return run_attempt(task, task.attempts[1], box(), {}, limits or Limits())


@pytest.mark.slow
def test_the_output_of_a_child_process_is_returned() -> None:
    tried = run_trimesh()
    assert tried.output is not None, tried.why
    assert tried.output.numbers["volume"] == pytest.approx(1)
    assert tried.version
    assert tried.seconds is not None


def test_meshes_and_arrays_are_packed_and_unpacked() -> None:
    meshes, further = {"again": box(), "more": box(2.0)}, {"rows": np.arange(3)}
    outputs, others = attempts._unpack(attempts._pack(meshes, further))
    assert {name: mesh.sha256 for name, mesh in outputs.items()} == {
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
def test_the_reason_of_a_failed_attempt_is_returned(
    reply: Reply, expected: tuple[Any, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(attempts, "run_in_child", lambda *_: reply)
    tried = run_trimesh()
    assert expected[0] in tried.why
    assert (tried.ended_by, tried.seconds, tried.version is not None) == expected[1:]
    assert tried.output is None


def test_a_task_without_its_library_is_not_run(monkeypatch: pytest.MonkeyPatch, demo_asset: Path) -> None:
    monkeypatch.setattr(registry, "is_installed", lambda module: module not in ("coacd", "igl"))
    result = try_asset(msb.load(demo_asset), ["collision", "subdivide"])
    assert [trial.outcome for trial in result.trials] == ["not_run", "not_run"]
    assert all(word in result.trials[1].why for word in ("coacd", "igl", "meshsplatbench[trial]"))


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
    chosen = select_tasks([tasks] if tasks else [])
    if not needed:
        registry.check_libraries(chosen)
        return
    with pytest.raises(UsageError) as caught:
        registry.check_libraries(chosen)
    assert caught.value.code == "EXTRA_MISSING"
    assert all(word in caught.value.message for word in needed)


@pytest.mark.parametrize("weld", [-1e-3, 0, True, float("nan"), float("inf"), "EXACT"])
def test_invalid_welds_are_rejected(weld: Any, demo_asset: Path) -> None:
    with pytest.raises(MeshError) as caught:
        msb.trial(demo_asset, "intersections", weld=weld)
    assert caught.value.code == "WELD_DISTANCE"


def test_tasks_are_selected_by_words_of_their_names() -> None:
    names = [task.name for task in select_tasks(["intersections", "decimate"])]
    assert names == ["decimate_50", "decimate_25", "decimate_10", "self_intersections"]
    assert [task.name for task in select_tasks("solid")] == ["solid"]
    assert [task.name for task in select_tasks("solid, uv")] == ["uv", "solid"]
    assert [task.name for task in select_tasks(["solid,uv"])] == ["uv", "solid"]
    assert [task.name for task in select_tasks([])] == list(TASKS)
    for wrong in (["uvs"], 3, [3]):
        with pytest.raises(UsageError):
            select_tasks(wrong)


@pytest.mark.parametrize("given", [(-1,), (1, np.nan)])
def test_limits_must_be_positive(given: tuple[Any, ...]) -> None:
    with pytest.raises(msb.MsbError) as caught:
        Limits(*given)
    assert caught.value.code == "USAGE"


UV = {"charts": 1, "charts_per_1000_faces": 1.0, "packing": 0.5, "faces_left_out": 0, "stretch_l2": 1.0}


@pytest.fixture
def replying(monkeypatch: pytest.MonkeyPatch) -> Callable[[Mapping[str, Output | str]], None]:
    """Return a function that replaces the results of libraries. It takes outputs, or reasons of failure."""

    def replace_results(answers: Mapping[str, Output | str]) -> None:
        def reply(_task: Task, attempt: Attempt, mesh: TrialMesh, arrays: Any, _limits: Any) -> AttemptResult:
            answer = answers.get(attempt.library)
            if answer is None:
                try:
                    return AttemptResult(attempt.work(mesh, arrays))
                except ValueError as error:
                    return AttemptResult(None, str(error))
            return (
                AttemptResult(None, answer, "time", 60.0)
                if isinstance(answer, str)
                else AttemptResult(answer)
            )

        monkeypatch.setattr(run, "run_attempt", reply)
        monkeypatch.setattr(run, "select_installed", list)

    return replace_results


def try_task(task: str, mesh: TrialMesh, keep: Path | None = None) -> Trial:
    """Try a single task on a mesh."""
    (result,) = try_asset(asset_from_mesh(mesh.to_mesh()), task, keep=keep).trials
    return result


def with_uv(mesh: TrialMesh) -> TrialMesh:
    """Return the mesh with random texture coordinates."""
    uv = np.random.default_rng(3).random((len(mesh.vertices), 2)).astype(np.float32)
    return TrialMesh(mesh.vertices, mesh.faces, mesh.colors, uv)


def test_uv_seams_do_not_count_as_defects(replying: Any) -> None:
    replying({"xatlas": Output(dict(UV), {"uv": with_uv(soup(box()))}, {"chart": np.zeros(36, np.int64)})})
    result = try_task("uv", box())
    assert (result.outcome, result.why) == ("works", None)
    assert result.says.endswith(" OK")
    assert result.numbers["verdict"]["level"] == "ok"
    assert "28 vertices" in result.numbers["verdict"]["sentence"]


def test_a_bad_result_works_with_limitations(replying: Any, tmp_path: Path) -> None:
    replying({"xatlas": Output(dict(UV), {"uv": with_uv(pages())}, {"chart": np.zeros(5, np.int64)})})
    result = try_task("uv", pages(), tmp_path)
    assert (result.outcome, "BAD" in result.why) == ("care", True)
    assert result.numbers["verdict"]["level"] == "bad"
    assert "uv.glb" in result.files


def test_saved_files_are_rotated_upright(replying: Any, tmp_path: Path) -> None:
    replying({"xatlas": Output(dict(UV), {"uv": with_uv(soup(box()))}, {"chart": np.zeros(36, np.int64)})})
    mesh = replace(box().to_mesh(), up="-y")
    try_asset(asset_from_mesh(mesh), ["uv"], keep=tmp_path)
    assert np.array_equal(read_positions(tmp_path / "uv.glb"), soup(box()).vertices * [1, -1, -1])
    assert np.array_equal(read_mesh(tmp_path / "uv.glb").vertices, soup(box()).vertices)


def test_a_result_worse_than_the_original_works_with_limitations(replying: Any) -> None:
    replying({"libigl": Output({"defined": True, "vertices_cut": 0, "lone_share": 0.0, "gap_share": 0.0,
                              "faces": 72}, {"mesh": grid()})})  # fmt: skip
    result = try_task("subdivide", box())
    assert result.outcome == "care"
    assert "LIMITED" in result.why


def test_the_better_of_two_libraries_is_listed_first(replying: Any, tmp_path: Path) -> None:
    whole = box()
    half, two = (white_mesh(whole.vertices, whole.faces[:count]) for count in (5, 2))
    replying({"fast-simplification": Output({}, {"mesh": half}), "pymeshlab": Output({}, {"mesh": two})})
    result = try_task("decimate_50", whole, tmp_path)
    best = result.numbers["best"]
    assert best == "fast-simplification"
    assert result.says.index(f"5 faces by {best}, ") < result.says.index("2 faces by pymeshlab")
    assert f"decimate_50-{best}.glb is " in f"{result.says}; {result.why}"
    for library in ("fast_simplification", "pymeshlab"):
        assert set(result.numbers[library]["verdict"]) == {"level", "sentence"}


@pytest.mark.slow
@pytest.mark.oracle
def test_a_hull_and_a_decimated_mesh_are_saved_if_coacd_fails(replying: Any, tmp_path: Path) -> None:
    for module in ("manifold3d", "igl", "pymeshlab"):
        pytest.importorskip(module)
    replying({"coacd": "too slow"})
    result = try_task("collision", grid(20), tmp_path)
    assert result.outcome == "care"
    # A flat mesh has no convex hull with a volume, so that only the decimated mesh is saved.
    assert result.why.startswith("coacd: too slow; ")
    assert "80 faces" in result.why
    assert result.says == ""
    assert result.files == ("collision-mesh.glb", "collision.png")
    ball = try_task("collision", round_sheet(), tmp_path)
    assert ball.why.startswith("coacd: too slow; ")
    assert ball.files == ("collision-hull.glb", "collision-mesh.glb", "collision.png")
    assert ball.numbers["instead"]["manifold3d"]["faces"] <= 252
    assert ball.numbers["instead"]["manifold3d"]["distance_95_of_diagonal"] < 0.02


def round_sheet() -> TrialMesh:
    """Return a sphere that is made of a fine grid. It is closed, except for a seam."""
    sheet = grid(40)
    turn, height = 2 * np.pi * sheet.vertices[:, 0], np.pi * sheet.vertices[:, 1]
    places = [np.cos(turn) * np.sin(height), np.sin(turn) * np.sin(height), np.cos(height)]
    return white_mesh(np.stack(places, axis=1), sheet.faces)


def test_fallbacks_have_a_minimum_time_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, float] = {}

    def reply(_task: Task, attempt: Attempt, _mesh: TrialMesh, _arrays: Any, limits: Limits) -> AttemptResult:
        given[attempt.library] = limits.seconds
        return AttemptResult(None, "no", "time", limits.seconds)

    monkeypatch.setattr(run, "run_attempt", reply)
    monkeypatch.setattr(run, "select_installed", list)
    mesh = asset_from_mesh(box().to_mesh())
    try_asset(mesh, "collision", limits=Limits(1.0))
    assert given == {"coacd": 1.0, "manifold3d": 20.0, "pymeshlab": 20.0}
    try_asset(mesh, "collision", limits=Limits(30.0))
    assert set(given.values()) == {30.0}


@pytest.mark.parametrize(
    ("ended_by", "outcome"),
    [("crash", "not_run"), ("time", "not_run"), ("memory", "not_run"), (None, "fails")],
)
def test_a_crash_or_a_limit_is_no_fault_of_the_mesh(
    monkeypatch: pytest.MonkeyPatch, ended_by: Any, outcome: str
) -> None:
    monkeypatch.setattr(run, "run_attempt", lambda *_: AttemptResult(None, "no", ended_by, 1.0))
    monkeypatch.setattr(run, "select_installed", list)
    (trial,) = try_asset(asset_from_mesh(box().to_mesh()), "uv").trials
    assert trial.outcome == outcome
    assert trial.why == "xatlas: no"


@pytest.mark.parametrize("by", ["vertex", "corner"])
def test_seams_are_merged_before_trials(by: str) -> None:
    mesh = prepare_mesh(asset_from_mesh(textured_cube(by)))
    assert (len(mesh.vertices), len(mesh.faces), mesh.verdict.level) == (8, 12, "ok")
    assert "seams" not in mesh.verdict.sentence
    assert np.ptp(mesh.colors) > 0


def test_equal_results_of_strategies_are_tried_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[int] = []

    def try_asset(asset: Asset, tasks: tuple[str, ...], **_: Any) -> Any:
        asked.append(asset.manifest.vertex_count)
        outcome = "fails" if len(asked) == 1 else "care"
        trial = SimpleNamespace(task=tasks[0], outcome=outcome)
        return SimpleNamespace(trials=(trial,))

    monkeypatch.setattr(repairs, "try_asset", try_asset)
    ways = {"orient,cut": (("orient", "cut"), None), "cut": (("cut",), None), "weld": (("weld",), None)}
    monkeypatch.setattr(repairs, "STRATEGIES", ways)
    points, faces = BOOK
    asset = build_asset({"positions": points, "indices": faces.astype(np.uint32)}, {})
    camera = Camera.look_at((2, 3, -4), (0, 0, 0), up=(0, 1, 0), width=32, height=24, fov_y=0.8)
    rows = {row.strategy: row for row in compare(asset, [camera], Options(("weld",)), tasks=("solid",))}
    assert asked == [5, 9]
    assert rows[STORED].to_dict()["trials"] == rows["weld"].to_dict()["trials"] == {"solid": "fails"}
    after = rows["cut"].to_dict()
    assert (after["trials_passed_before"], after["trials_passed_after"]) == (0, 1)
    assert after["looks"]["standard"] == {"psnr": None, "same": True, "why": None}


def test_repairs_are_compared_without_a_device(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def no_device(*_: object, **__: object) -> None:
        raise DeviceError("DEVICE_NOT_FOUND", "no device")

    for place in ("msb.views", "msb.trial.repairs", "msb.repair.pictures"):
        monkeypatch.setattr(f"{place}.Renderer", no_device)
    monkeypatch.setattr(repairs, "STRATEGIES", {"orient": (("orient",), None)})
    asset = build_asset({"positions": TETRAHEDRON[0], "indices": TETRAHEDRON[1].astype(np.uint32)}, {})
    camera = Camera.look_at((2, 3, -4), (0, 0, 0), up=(0, 1, 0), width=32, height=24, fov_y=0.8)
    rows = compare(asset, [camera], Options(("orient",)), tasks=(), keep=tmp_path)
    assert [(row.strategy, row.picture, row.why) for row in rows] == [
        (STORED, None, None),
        ("orient", None, None),
    ]
    assert rows[1].looks["standard"].why.startswith("DEVICE_NOT_FOUND")

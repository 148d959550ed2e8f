"""Attempts in child processes and what a trial says of what they make; repairs that are compared."""

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
from msb.trial.registry import TASKS, chosen_tasks
from msb.trial.repairs import STORED, compare
from msb.trial.run import Trial, try_asset
from msb.trial.task import Attempt, AttemptResult, Output, Task
from tests.conftest import BOOK, TETRAHEDRON
from tests.topology.seamed import textured_cube
from tests.trial.conftest import box, grid, made_of, pages, soup


def ask(limits: Limits | None = None) -> AttemptResult:
    task = TASKS["solid"]
    return run_attempt(task, task.attempts[1], box(), {}, limits or Limits())


@pytest.mark.slow
def test_what_is_made_comes_back() -> None:
    tried = ask()
    assert tried.output is not None, tried.why
    assert tried.output.numbers["volume"] == pytest.approx(1)
    assert tried.version
    assert tried.seconds is not None


def test_meshes_and_arrays_travel_as_arrays() -> None:
    meshes, further = {"again": box(), "more": box(2.0)}, {"rows": np.arange(3)}
    made, others = attempts._unpack(attempts._pack(meshes, further))
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
    assert tried.output is None


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


UV = {"charts": 1, "charts_per_1000_faces": 1.0, "packing": 0.5, "faces_left_out": 0, "stretch_l2": 1.0}


@pytest.fixture
def replying(monkeypatch: pytest.MonkeyPatch) -> Callable[[Mapping[str, Output | str]], None]:
    """Return a function that puts answers, or reasons for none, in the place of those of libraries."""

    def become(answers: Mapping[str, Output | str]) -> None:
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

    return become


def tried(task: str, mesh: TrialMesh, keep: Path | None = None) -> Trial:
    (found,) = try_asset(asset_from_mesh(mesh.to_mesh()), task, keep=keep).trials
    return found


def with_uv(mesh: TrialMesh) -> TrialMesh:
    uv = np.random.default_rng(3).random((len(mesh.vertices), 2)).astype(np.float32)
    return TrialMesh(mesh.vertices, mesh.faces, mesh.colors, uv)


def test_seams_of_uvs_are_no_fault_of_a_file(replying: Any) -> None:
    replying({"xatlas": Output(dict(UV), {"uv": with_uv(soup(box()))}, {"chart": np.zeros(36, np.int64)})})
    found = tried("uv", box())
    assert (found.outcome, found.why) == ("works", None)
    assert found.says.endswith(" OK")
    assert found.numbers["verdict"]["level"] == "ok"
    assert "28 vertices" in found.numbers["verdict"]["sentence"]


def test_a_file_that_is_bad_as_the_mesh_was_works_with_care(replying: Any, tmp_path: Path) -> None:
    replying({"xatlas": Output(dict(UV), {"uv": with_uv(pages())}, {"chart": np.zeros(5, np.int64)})})
    found = tried("uv", pages(), tmp_path)
    assert (found.outcome, "BAD" in found.why) == ("care", True)
    assert found.numbers["verdict"]["level"] == "bad"
    assert "uv.glb" in found.files


def test_files_are_upright_as_glb_files_are(replying: Any, tmp_path: Path) -> None:
    replying({"xatlas": Output(dict(UV), {"uv": with_uv(soup(box()))}, {"chart": np.zeros(36, np.int64)})})
    mesh = replace(box().to_mesh(), up="-y")
    try_asset(asset_from_mesh(mesh), ["uv"], keep=tmp_path)
    assert np.array_equal(read_mesh(tmp_path / "uv.glb").vertices, soup(box()).vertices * [1, -1, -1])


def test_a_file_that_is_worse_than_the_mesh_says_why(replying: Any) -> None:
    replying({"libigl": Output({"defined": True, "vertices_cut": 0, "lone_share": 0.0, "gap_share": 0.0,
                              "faces": 72}, {"mesh": grid()})})  # fmt: skip
    found = tried("subdivide", box())
    assert found.outcome == "care"
    assert "LIMITED" in found.why


def test_of_two_libraries_the_better_file_is_named_first(replying: Any, tmp_path: Path) -> None:
    whole = box()
    half, two = (made_of(whole.vertices, whole.faces[:count]) for count in (5, 2))
    replying({"fast-simplification": Output({}, {"mesh": half}), "pymeshlab": Output({}, {"mesh": two})})
    found = tried("decimate_50", whole, tmp_path)
    best = found.numbers["best"]
    assert best == "fast-simplification"
    assert found.says.index(f"5 faces by {best}, ") < found.says.index("2 faces by pymeshlab")
    assert f"decimate_50-{best}.glb is " in f"{found.says}; {found.why}"
    for library in ("fast_simplification", "pymeshlab"):
        assert set(found.numbers[library]["verdict"]) == {"level", "sentence"}


@pytest.mark.slow
@pytest.mark.oracle
def test_where_coacd_does_not_end_a_hull_and_a_mesh_are_made_and_kept(replying: Any, tmp_path: Path) -> None:
    for module in ("manifold3d", "igl", "pymeshlab"):
        pytest.importorskip(module)
    replying({"coacd": "too slow"})
    found = tried("collision", grid(20), tmp_path)
    assert found.outcome == "care"
    # A flat mesh has no hull with a volume.
    assert found.why.startswith("coacd: too slow; ")
    assert "80 faces" in found.why
    assert found.says == ""  # the row begins with what happened
    assert found.files == ("collision-mesh.glb", "collision.png")
    ball = tried("collision", round_sheet(), tmp_path)
    assert ball.why.startswith("coacd: too slow; a hull of ")
    assert ball.files == ("collision-hull.glb", "collision-mesh.glb", "collision.png")
    assert ball.numbers["instead"]["manifold3d"]["faces"] <= 252
    assert ball.numbers["instead"]["manifold3d"]["distance_95_of_diagonal"] < 0.02


def round_sheet() -> TrialMesh:
    """Return the sphere of a fine grid, closed but for its seam."""
    sheet = grid(40)
    turn, height = 2 * np.pi * sheet.vertices[:, 0], np.pi * sheet.vertices[:, 1]
    places = [np.cos(turn) * np.sin(height), np.sin(turn) * np.sin(height), np.cos(height)]
    return made_of(np.stack(places, axis=1), sheet.faces)


def test_what_stands_in_for_a_library_has_time_to_start(monkeypatch: pytest.MonkeyPatch) -> None:
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


@pytest.mark.parametrize("by", ["vertex", "corner"])
def test_a_mesh_is_tried_without_its_seams(by: str) -> None:
    mesh = prepare_mesh(asset_from_mesh(textured_cube(by)))
    assert (len(mesh.vertices), len(mesh.faces), mesh.verdict.level) == (8, 12, "ok")
    assert "seams" not in mesh.verdict.sentence
    assert np.ptp(mesh.colors) > 0


def test_every_row_has_the_trials_before_and_after_and_equal_results_are_tried_once(
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


def test_repairs_are_compared_without_a_device_and_without_pictures(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def no_device(*_: object, **__: object) -> None:
        raise DeviceError("DEVICE_NOT_FOUND", "there is none")

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

"""`msb trial`: its JSON, its files and its exit status."""

from pathlib import Path

import pygltflib
import pytest

import msb as api
from tests.cli.conftest import Here, mesh_file
from tests.trial.conftest import box, grid, pages


@pytest.fixture
def flat(tmp_path: Path) -> Path:
    return mesh_file(tmp_path / "grid.ply", grid().vertices, grid().faces)


def test_json_keys(here: Here, flat: Path) -> None:
    data = here("trial", "--task", "intersections", "--json", "-", flat).json
    assert (data["schema"], set(data["limits"])) == ("msb.trial/1", {"seconds", "memory_gib"})
    assert set(data) == {"schema", "tool_version", "path", "trials", "mesh", "limits", "cameras"}
    assert {"vertices", "faces", "weld", "repair", "sha256"} <= set(data["mesh"])
    assert {"count", "from"} <= set(data["cameras"])
    (trial,) = data["trials"]
    texts = {"task", "title", "outcome", "says", "why", "picture"}
    assert set(trial) == texts | {"seconds", "numbers", "libraries", "files"}
    assert (trial["task"], trial["outcome"]) == ("self_intersections", "works")
    assert (data["path"], data["mesh"]["faces"]) == (str(flat), 72)


@pytest.mark.slow
def test_plan_repairs_the_mesh_first(here: Here, tmp_path: Path) -> None:
    path = mesh_file(tmp_path / "pages.ply", pages().vertices, pages().faces)
    line = ("trial", "--task", "intersections", path)
    for plan, vertices in ((None, 5), ("orient,pair", 7), ("drop", 4)):
        mesh = here(*line, "--json", "-", *(["--plan", plan] if plan else [])).json["mesh"]
        assert (mesh["vertices"], mesh["repair"]) == (vertices, plan and plan.split(","))
    empty = here(*line, "--plan", "debris")
    assert (empty.status, empty.err.split(":")[0]) == (3, "TRIASSET_EMPTY")


@pytest.mark.slow
def test_a_failed_task_only_fails_a_gate(here: Here, flat: Path) -> None:
    assert here("trial", "--task", "solid", flat).status == 0
    gated = here("trial", "-q", "--task", "solid", "--fail-on", "solid", flat)
    assert (gated.status, gated.err.split(":")[0], gated.out.count("\n")) == (1, "GATE_FAILED", 1)


@pytest.mark.slow
@pytest.mark.oracle
def test_results_are_saved_with_uvs(here: Here, tmp_path: Path) -> None:
    pytest.importorskip("xatlas")
    path, kept = mesh_file(tmp_path / "box.ply", box().vertices, box().faces), tmp_path / "kept"
    line = ("trial", "--task", "uv", "--save", kept, path)
    assert here(*line).status == 0
    assert {path.name for path in kept.iterdir()} >= {"uv.glb", "uv.png"}
    glb = pygltflib.GLTF2().load(kept / "uv.glb")
    assert glb.accessors[glb.meshes[0].primitives[0].attributes.TEXCOORD_0].type == "VEC2"
    assert api.open(kept / "uv.glb").manifest.face_count == 12
    again = here(*line)
    assert (again.status, again.err.split(":")[0]) == (2, "OUTPUT_EXISTS")


@pytest.mark.parametrize(
    "line",
    [
        "--task uvs data_stubs/checkpoint",
        "--task uv --fail-on solid data_stubs/checkpoint",
        "--seconds 0 data_stubs/checkpoint",
        "--camera 3 data_stubs/checkpoint",
        "--save no_such_folder/out tests/tiny/models",
    ],
)
def test_invalid_arguments_are_rejected_first(here: Here, line: str) -> None:
    here("trial", *line.split()).ends(2, "USAGE: ")

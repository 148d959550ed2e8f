"""`msb trial`: its JSON, its files and its gates."""

from pathlib import Path
from typing import Any

import jsonschema
import pygltflib
import pytest

import msb as api
from tests.cli.conftest import Here, mesh_file
from tests.trial.conftest import box, grid, pages


def closed(properties: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of an object that has these properties, all of them and no others."""
    return {
        "type": "object",
        "required": [*properties],
        "additionalProperties": False,
        "properties": properties,
    }


TEXT, MAYBE_TEXT = {"type": "string"}, {"type": ["string", "null"]}
TRIAL_PROPERTIES = {
    **dict.fromkeys(("task", "title", "says"), TEXT),
    **dict.fromkeys(("why", "picture"), MAYBE_TEXT),
    "outcome": {"enum": ["works", "care", "fails", "not_run"]},
    "seconds": {"type": "number", "minimum": 0},
    "numbers": {"type": "object"},
    "libraries": {"type": "object", "additionalProperties": TEXT},
    "files": {"type": "array", "items": TEXT},
}
PROPERTIES = {
    "schema": {"const": "msb.trial/1"},
    **dict.fromkeys(("tool_version", "path"), TEXT),
    "trials": {"type": "array", "items": closed(TRIAL_PROPERTIES)},
    "mesh": {"type": "object", "required": ["vertices", "faces", "weld", "repair", "sha256"]},
    "limits": {"type": "object", "required": ["seconds", "memory_gib"]},
    "cameras": {"type": "object", "required": ["count", "from"]},
}


@pytest.fixture
def flat(tmp_path: Path) -> Path:
    return mesh_file(tmp_path / "grid.ply", grid().vertices, grid().faces)


def test_json_is_what_the_schema_says(here: Here, flat: Path) -> None:
    data = here("trial", "--task", "intersections", "--json", "-", flat).json
    jsonschema.validate(data, closed(PROPERTIES))
    (one,) = data["trials"]
    assert (one["task"], one["outcome"]) == ("self_intersections", "works")
    assert (data["path"], data["mesh"]["faces"]) == (str(flat), 72)


@pytest.mark.slow
def test_a_mesh_is_repaired_first_on_request(here: Here, tmp_path: Path) -> None:
    path = mesh_file(tmp_path / "pages.ply", pages().vertices, pages().faces)
    line = ("trial", "--task", "intersections", path)
    for plan, vertices in ((None, 5), ("orient,pair", 7), ("drop", 4)):
        mesh = here(*line, "--json", "-", *(["--plan", plan] if plan else [])).json["mesh"]
        assert (mesh["vertices"], mesh["repair"]) == (vertices, plan and plan.split(","))
    empty = here(*line, "--plan", "debris")
    assert (empty.status, empty.err.split(":")[0]) == (3, "TRIASSET_EMPTY")


@pytest.mark.slow
def test_a_failed_task_is_no_failure_except_for_a_gate(here: Here, flat: Path) -> None:
    assert here("trial", "--task", "solid", flat).status == 0
    gated = here("trial", "-q", "--task", "solid", "--fail-on", "solid", flat)
    assert (gated.status, gated.err.split(":")[0], gated.out.count("\n")) == (1, "GATE_FAILED", 1)


@pytest.mark.slow
@pytest.mark.oracle
def test_results_are_kept_with_their_uvs(here: Here, tmp_path: Path) -> None:
    pytest.importorskip("xatlas")
    path, kept = mesh_file(tmp_path / "box.ply", box().vertices, box().faces), tmp_path / "kept"
    line = ("trial", "--task", "uv", "--save", kept, path)
    assert here(*line).status == 0
    assert {one.name for one in kept.iterdir()} >= {"uv.glb", "uv.png"}
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
def test_invalid_arguments_are_rejected_before_anything_is_tried(here: Here, line: str) -> None:
    here("trial", *line.split()).ends(2, "USAGE: ")

"""`msb trial`: the table, the JSON, the files and the gates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jsonschema
import pygltflib
import pytest

import msb as api
from tests.cli.conftest import Msb, Refused, mesh_file
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


def test_json_is_what_the_schema_says(msb: Msb, flat: Path) -> None:
    result = msb("trial", "--task", "intersections", "--json", "-", flat, status=0)
    jsonschema.validate(result.json, closed(PROPERTIES))
    assert result.json["path"] == str(flat)
    (one,) = result.json["trials"]
    assert (one["task"], one["outcome"]) == ("self_intersections", "works")
    assert result.json["mesh"]["faces"] == 72


@pytest.mark.slow
def test_what_is_tried_is_repaired_first_on_request(msb: Msb, tmp_path: Path) -> None:
    path = mesh_file(tmp_path / "pages.ply", pages().vertices, pages().faces)
    for options, vertices, plan in (
        ((), 5, None),
        (("--plan", "orient,pair"), 7, ["orient", "pair"]),
        (("--plan", "drop"), 4, ["drop"]),
    ):
        result = msb("trial", "--task", "intersections", *options, "--json", "-", path, status=0)
        assert (result.json["mesh"]["vertices"], result.json["mesh"]["repair"]) == (vertices, plan)
    empty = msb("trial", "--task", "intersections", "--plan", "debris", path)
    assert (empty.status, empty.err.split(":")[0]) == (3, "TRIASSET_EMPTY")


@pytest.mark.slow
def test_a_task_that_fails_leaves_the_status_0_and_a_gate_makes_it_1(msb: Msb, flat: Path) -> None:
    plain = msb("trial", "--task", "solid", flat, status=0)
    assert "FAILS" in plain.out
    gated = msb("trial", "-q", "--task", "solid", "--fail-on", "solid", flat, status=1)
    assert gated.err.startswith("GATE_FAILED: ")
    assert gated.out.splitlines() == [f"{flat}: 1 fail: solid"]


@pytest.mark.slow
@pytest.mark.oracle
def test_what_is_made_is_kept_with_its_uvs(msb: Msb, tmp_path: Path) -> None:
    pytest.importorskip("xatlas")
    path = mesh_file(tmp_path / "box.ply", box().vertices, box().faces)
    msb("trial", "--task", "uv", "--save", tmp_path / "kept", path, status=0)
    assert sorted(one.name for one in (tmp_path / "kept").iterdir()) == ["uv.glb", "uv.png"]
    kept = pygltflib.GLTF2().load(tmp_path / "kept" / "uv.glb")
    attributes = kept.meshes[0].primitives[0].attributes
    assert kept.accessors[attributes.TEXCOORD_0].type == "VEC2"
    assert api.open(tmp_path / "kept" / "uv.glb").manifest.face_count == 12
    again = msb("trial", "--task", "uv", "--save", tmp_path / "kept", path)
    assert (again.status, again.err.split(":")[0]) == (2, "OUTPUT_EXISTS")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("trial --task uvs data_stubs/checkpoint", "there is no task"),
        ("trial --task uv --fail-on solid data_stubs/checkpoint", "--fail-on names solid"),
        ("trial --seconds 0 data_stubs/checkpoint", "the limit of seconds is 0"),
        ("trial --camera 3 data_stubs/checkpoint", "--camera needs --cameras PATH"),
        ("trial --save no_such_folder/out tests/tiny/models", "--save takes one mesh"),
    ],
)
def test_wrong_usage_is_said_before_anything_is_tried(refused: Refused, line: str, said: str) -> None:
    assert said in refused(line)


def test_a_coordinate_that_is_not_finite_is_refused_with_its_vertex(msb: Msb, tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n")
    result = msb("trial", "--task", "solid", tmp_path / "a.obj", status=3)
    assert "vertex 1 is [nan, 0.0, 0.0]" in result.err

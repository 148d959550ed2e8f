"""`msb trial`: the table, the JSON, the files and the gates."""

from __future__ import annotations

from pathlib import Path

import jsonschema
import pygltflib
import pytest

import msb as api
from msb.meshes import write_mesh
from msb.meshes.mesh import Mesh
from tests.cli.conftest import Msb, Refused
from tests.trial.conftest import box, grid, pages

TRIAL = {
    "type": "object",
    "required": [
        "task",
        "outcome",
        "why",
        "seconds",
        "numbers",
        "title",
        "says",
        "libraries",
        "files",
        "picture",
    ],
    "additionalProperties": False,
    "properties": {
        "task": {"type": "string"},
        "title": {"type": "string"},
        "outcome": {"enum": ["works", "care", "fails", "not_run"]},
        "why": {"type": ["string", "null"]},
        "says": {"type": "string"},
        "seconds": {"type": "number", "minimum": 0},
        "numbers": {"type": "object"},
        "libraries": {"type": "object", "additionalProperties": {"type": "string"}},
        "files": {"type": "array", "items": {"type": "string"}},
        "picture": {"type": ["string", "null"]},
    },
}
SCHEMA = {
    "type": "object",
    "required": ["schema", "tool_version", "path", "trials", "mesh", "limits", "cameras"],
    "additionalProperties": False,
    "properties": {
        "schema": {"const": "msb.trial/1"},
        "tool_version": {"type": "string"},
        "path": {"type": "string"},
        "trials": {"type": "array", "items": TRIAL},
        "mesh": {"type": "object", "required": ["vertices", "faces", "weld", "repair", "sha256"]},
        "limits": {"type": "object", "required": ["seconds", "memory_gib"]},
        "cameras": {"type": "object", "required": ["count", "from"]},
    },
}


@pytest.fixture
def flat(tmp_path: Path) -> Path:
    path = tmp_path / "grid.ply"
    write_mesh(Mesh(grid().vertices, grid().faces), path, suffix=".ply")
    return path


def test_json_is_what_the_schema_says(msb: Msb, flat: Path) -> None:
    result = msb("trial", "--task", "intersections", "--json", "-", flat)
    assert result.status == 0, result.err
    jsonschema.validate(result.json, SCHEMA)
    assert result.json["path"] == str(flat)
    (one,) = result.json["trials"]
    assert (one["task"], one["outcome"]) == ("self_intersections", "works")
    assert result.json["mesh"]["faces"] == 72


def test_what_is_tried_is_repaired_first_on_request(msb: Msb, tmp_path: Path) -> None:
    path = tmp_path / "pages.ply"
    write_mesh(Mesh(pages().vertices, pages().faces), path, suffix=".ply")
    for options, vertices, plan in (
        ((), 5, None),
        (("--plan", "orient,pair"), 7, ["orient", "pair"]),
        (("--plan", "drop"), 4, ["drop"]),
    ):
        result = msb("trial", "--task", "intersections", *options, "--json", "-", path)
        assert result.status == 0, result.err
        assert (result.json["mesh"]["vertices"], result.json["mesh"]["repair"]) == (vertices, plan)
    empty = msb("trial", "--task", "intersections", "--plan", "debris", path)
    assert (empty.status, empty.err.split(":")[0]) == (3, "TRIASSET_EMPTY")


@pytest.mark.slow
def test_a_task_that_fails_leaves_the_status_0_and_a_gate_makes_it_1(msb: Msb, flat: Path) -> None:
    plain = msb("trial", "--task", "solid", flat)
    assert plain.status == 0
    assert "FAILS" in plain.out
    gated = msb("trial", "-q", "--task", "solid", "--fail-on", "solid", flat)
    assert gated.status == 1
    assert gated.err.startswith("GATE_FAILED: ")
    assert gated.out.splitlines() == [f"{flat}: 1 fail: solid"]


@pytest.mark.slow
@pytest.mark.oracle
def test_what_is_made_is_kept_with_its_uvs(msb: Msb, tmp_path: Path) -> None:
    pytest.importorskip("xatlas")
    path = tmp_path / "box.ply"
    write_mesh(Mesh(box().vertices, box().faces), path, suffix=".ply")
    result = msb("trial", "--task", "uv", "--save", tmp_path / "kept", path)
    assert result.status == 0, result.err
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
    result = msb("trial", "--task", "solid", tmp_path / "a.obj")
    assert result.status == 3
    assert "vertex 1 is [nan, 0.0, 0.0]" in result.err

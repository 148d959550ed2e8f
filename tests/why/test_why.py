"""Why an export looks worse: each cause is measured by itself, and those that cannot be say why."""

from pathlib import Path

import numpy as np
import pytest

import msb
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh
from msb.scenes.around import around
from msb.why import CAUSES, why
from tests.cli.conftest import Here
from tests.conftest import ROOT, TETRAHEDRON

MODELS = ROOT / "data_stubs" / "models" / "pebble"


def measured(method: str) -> dict[str, tuple[bool, float | None]]:
    asset = msb.open(MODELS / method)
    found = why(asset, around(asset, 2, 64, 48))
    assert [cause.name for cause in found] == [known.name for known in CAUSES]
    assert all((cause.db is None) == (not cause.applies) == (cause.reason is not None) for cause in found)
    return {cause.name: (cause.applies, cause.db) for cause in found}


@pytest.mark.slow
def test_a_blended_soup_loses_by_every_mistake() -> None:
    found = measured("two_dts")
    assert not found["supersampling"][0]
    for name in ("view_dependence", "shading", "linear_colors", "opacity", "engine_order"):
        db = found[name][1]
        assert 5 < db < 60, name


@pytest.mark.slow
def test_a_supersampled_method_loses_by_one_sample_and_a_decoder_has_no_static_colour() -> None:
    db = measured("mesh_splatting")["supersampling"][1]
    assert 10 < db < 60
    neural = measured("diffsoup")
    assert neural["engine_order"] == (True, float("inf"))
    assert not any(applies for name, (applies, _) in neural.items() if name != "engine_order")


def test_a_plain_closed_mesh_has_no_causes_of_training_and_keeps_its_back_faces() -> None:
    vertices, faces = TETRAHEDRON
    colors = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9]], np.uint8)
    asset = asset_from_mesh(Mesh(vertices, faces.astype(np.int64), colors))
    found = {cause.name: cause for cause in why(asset, around(asset, 2, 48, 48))}
    causes = {name for name, cause in found.items() if cause.applies}
    assert causes == {"supersampling", "shading", "linear_colors", "back_faces"}
    assert found["back_faces"].db == float("inf")
    assert found["back_faces"].to_dict()["db"] is None
    assert found["back_faces"].to_dict()["equal"] is True
    turned = asset_from_mesh(Mesh(vertices, faces[:, ::-1].astype(np.int64), colors))
    (culled,) = [cause for cause in why(turned, around(turned, 2, 48, 48)) if cause.name == "back_faces"]
    assert culled.db < 30


def test_causes_of_a_textured_mesh_are_those_of_the_same_colours_at_vertices() -> None:
    vertices, faces = TETRAHEDRON
    faces = faces[:, ::-1].astype(np.int64)
    paint, white = np.uint8([[200, 130, 60]]), np.full((2, 2, 3), 255, np.uint8)
    painted = np.tile(paint, (4, 4, 1))
    uvs = np.linspace(0, 3, 24, dtype=np.float32).reshape(12, 2)
    shown = np.array([0, 1, 1, 0], np.uint32)
    skin = {"corner_uvs": uvs, "face_textures": shown}
    meshes = {
        "vertices": Mesh(vertices, faces, np.repeat(paint, 4, axis=0)),
        "tint": Mesh(vertices, faces, None, np.repeat(paint, 4, axis=0), **skin, textures=(white, white)),
        "texture": Mesh(vertices, faces, **skin, textures=(painted, painted)),
    }
    cameras = around(asset_from_mesh(meshes["vertices"]), 2, 48, 48)
    found = {
        name: {cause.name: cause for cause in why(asset_from_mesh(mesh), cameras)}
        for name, mesh in meshes.items()
    }
    for name, cause in found["vertices"].items():
        assert found["tint"][name].db == (cause.db and pytest.approx(cause.db, abs=0.1))
    assert found["texture"]["linear_colors"].reason
    for name in ("shading", "back_faces", "supersampling"):
        assert found["texture"][name].db == pytest.approx(found["vertices"][name].db, abs=0.3)


@pytest.mark.slow
def test_the_command_writes_json_and_pictures(here: Here, tmp_path: Path) -> None:
    line = ("why", "--size", "48x36", "--save", tmp_path / "why", "--json", "-", MODELS / "two_dts")
    data = here(*line).json
    assert data["schema"] == "msb.why/1"
    assert {"name", "db", "applies", "how_to_see"} <= data["causes"][0].keys()
    assert len(list((tmp_path / "why").glob("*.png"))) > 1
    here("why", "--camera", "0", MODELS / "two_dts").ends(2, "USAGE: ")

"""Why an export looks worse: what each cause costs, and that the total is that of the images."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset.look import daylight, stored_threshold, up_axis, visible_faces
from msb.asset.settings import with_settings
from msb.errors import UsageError
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh, mesh_from_asset, with_faces
from msb.render import Frame
from msb.render.standard.renderer import StandardRenderer
from msb.scenes import Camera
from msb.scenes.around import around
from msb.scenes.datasets import read_scene
from msb.views import difference
from msb.why import CAUSES, Cause, Causes, why
from msb.why.causes import taken_for_linear
from msb.why.views import _Culling
from tests.cli.conftest import Here, here
from tests.conftest import ROOT, TETRAHEDRON

__all__ = ["here"]  # fixture
MODELS = ROOT / "data_stubs" / "models"


def measured(method: str) -> dict[str, tuple[bool, float | None]]:
    asset = msb.open(MODELS / "pebble" / method)
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
    line = (
        "why",
        "--size",
        "48x36",
        "--save",
        tmp_path / "why",
        "--json",
        "-",
        MODELS / "pebble" / "two_dts",
    )
    data = here(*line).json
    assert data["schema"] == "msb.why/1"
    assert {"name", "db", "applies", "how_to_see"} <= data["causes"][0].keys()
    assert len(list((tmp_path / "why").glob("*.png"))) > 1
    here("why", "--camera", "0", MODELS / "pebble" / "two_dts").ends(2, "USAGE: ")


SCENE = ROOT / "data_stubs" / "scenes" / "mipnerf360" / "pebble"
VIEWS = [view.scaled(0.5) for view in read_scene(SCENE).test[:2]]
LOOK = {"up": (0.0, 1.0, 0.0), "width": 48, "height": 36, "fov_y": 0.9}
CAMERA = msb.Camera.look_at((0.5, -0.5, 3), (0, 0, 0), **LOOK)


def pixels(asset: msb.Asset, tier: str, **options: int) -> np.ndarray:
    with msb.Renderer(asset, tier, **options) as renderer:
        images = [renderer.render(view).image.clip(0, 1).reshape(-1, 1, 3) for view in VIEWS]
    return np.concatenate(images)


def by_name(causes: Causes) -> dict[str, Cause]:
    return {cause.name: cause for cause in causes}


@pytest.mark.slow
def test_the_total_is_that_of_the_images_of_both_renderers() -> None:
    asset = msb.open(MODELS / "walled" / "triangle_splatting")
    causes = why(asset, (view for view in VIEWS))  # a generator, which is gone after one pass
    total = causes.total
    plain = msb.metrics.psnr(pixels(asset, "standard"), pixels(asset, "dedicated"))
    assert total.db == total.right == pytest.approx(plain, abs=1e-6)
    assert 17.5 < plain < 19
    assert total.wrong < plain - 3
    # The largest cause of a soup with soft edges, and the three that only a bake mends make up the whole.
    assert total.bakes == ("soft_edges", "opacity", "view_dependence")
    assert by_name(causes)["soft_edges"].db == pytest.approx(21.3, abs=0.7)
    assert total.baked == pytest.approx(plain, abs=0.7)
    written = total.to_dict()
    assert (written["db"], written["equal"], written["reason"]) == (total.db, False, None)
    assert written["engine_settings"] == {"wrong_db": total.wrong, "right_db": total.right}
    assert written["bake"] == {"db": total.baked, "causes": list(total.bakes)}


@pytest.mark.slow
def test_an_engine_that_supersamples_as_the_method_does_has_less_left() -> None:
    asset = msb.open(MODELS / "walled" / "mesh_splatting")
    causes = why(asset, VIEWS)
    expected = msb.metrics.psnr(pixels(asset, "standard", supersample=4), pixels(asset, "dedicated"))
    assert causes.total.right == pytest.approx(expected, abs=1e-6)
    assert causes.total.db < expected
    # Its edges are hard already: sigma is 0.0001 after training.
    hard = by_name(causes)["soft_edges"].db
    assert hard > 60
    assert "soft_edges" not in causes.total.bakes


@pytest.mark.slow
def test_where_one_of_the_two_looks_is_not_there_the_total_says_so() -> None:
    neural = why(MODELS / "walled" / "diffsoup", [CAMERA])
    assert by_name(neural)["soft_edges"].reason
    vertices, faces = TETRAHEDRON
    mesh = why(asset_from_mesh(Mesh(vertices, faces.astype(np.int64))), [CAMERA])
    for total in (neural.total, mesh.total):
        assert total.db is None
        assert total.reason
        assert total.to_dict()["db"] is None


@pytest.mark.parametrize("value", [0.5, None])
def test_settings_that_are_given_measure_what_the_same_settings_stored_would(value: float | None) -> None:
    asset = msb.open(MODELS / "walled" / "two_dts")
    other = with_settings(asset, {"ste_threshold": None if value else 0.5})
    asked = by_name(why(other, [CAMERA], settings={"ste_threshold": value}))
    stored = by_name(why(with_settings(asset, {"ste_threshold": value}), [CAMERA]))
    before = by_name(why(other, [CAMERA]))
    assert {name: cause.db for name, cause in asked.items()} == {n: cause.db for n, cause in stored.items()}
    for name in ("shading", "linear_colors", "back_faces", "opacity", "engine_order"):
        assert asked[name].db != before[name].db, name
    # Faces that a threshold hides stay hidden when the others are made opaque.
    assert (asked["opacity"].db == float("inf")) == (value is not None)


def test_light_is_that_of_the_faces_that_are_shown() -> None:
    """A threshold hides 278 faces of this one; it is held to a mesh that is lit before it is drawn."""
    asset = msb.open(ROOT / "tests/golden/two_dts/ring_solid/checkpoint")
    camera = msb.Camera.look_at((1.0, -2.0, 2.5), (0, 0, 0), **LOOK)
    causes = why(asset, [camera], background="black")
    mesh = mesh_from_asset(asset)
    positions, indices = asset.buffers["positions"], asset.buffers["indices"]
    assert len(indices) == len(mesh.faces) + 278
    light = daylight(positions, indices, up_axis(asset))[visible_faces(asset, stored_threshold(asset))]
    dimmed = mesh.vertex_colors.astype(np.float64)
    dimmed[mesh.faces.reshape(-1)] *= np.repeat(light, 3)[:, None]
    lit = replace(mesh, vertex_colors=dimmed.astype(np.float32))
    shading = by_name(causes)["shading"]
    np.testing.assert_allclose(shading.with_it, drawn(lit, camera).image.clip(0, 1), atol=1e-5)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    front = ((camera.center - corners[:, 0]) * normal).sum(axis=1) > 0
    wrong = taken_for_linear([drawn(with_faces(lit, front), camera)])
    own = msb.render(asset, camera, tier="dedicated", background="black").image
    assert causes.total.wrong == pytest.approx(difference(wrong, [own]), abs=1e-6)


def drawn(mesh: Mesh, camera: msb.Camera) -> Frame:
    with msb.Renderer(asset_from_mesh(mesh), "standard") as renderer:
        return renderer.render(camera)


@pytest.mark.parametrize(
    ("cameras", "options"), [([], {}), (CAMERA, {}), (["a"], {}), ([CAMERA], {"settings": 3})]
)
def test_wrong_arguments_are_our_errors(cameras: Any, options: dict[str, Any]) -> None:
    vertices, faces = TETRAHEDRON
    with pytest.raises(UsageError) as caught:
        why(asset_from_mesh(Mesh(vertices, faces.astype(np.int64))), cameras, **options)
    assert caught.value.code == "USAGE"


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_faces_that_are_left_out_are_as_if_they_were_not_there(dtype: type) -> None:
    random = np.random.default_rng(4)
    count = 50  # neither a whole block nor a whole cluster
    vertices = random.uniform(-1, 1, (3 * count, 3)).astype(np.float32)
    colors = (random.random((3 * count, 3)) * (255 if dtype is np.uint8 else 1)).astype(dtype)
    faces = np.arange(3 * count).reshape(-1, 3)
    camera = Camera.look_at((0, 0, -4), (0, 0, 0), width=64, height=48, fov_y=0.8)
    with closing(_Culling(asset_from_mesh(Mesh(vertices, faces, colors)), None)) as renderer:
        for share in (0.5, 0.2):
            shown = random.random(count) < share
            renderer.show(shown)
            rest = asset_from_mesh(Mesh(vertices, faces[shown], colors))
            with closing(StandardRenderer(rest)) as alone:
                np.testing.assert_array_equal(renderer.render_image(camera), alone.render_image(camera))
                assert alone.render_image(camera).any()

"""Why an export looks worse: the loss of each cause, and the total.

Both are compared with images of the renderers.
"""

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
from msb.scenes.around import make_turntable
from msb.scenes.datasets import read_scene
from msb.views import psnr_over_views
from msb.why import CAUSES, Cause, Causes, why
from msb.why.causes import interpret_as_linear
from msb.why.views import _CullingRenderer
from tests.cli.conftest import Here, here
from tests.conftest import ROOT, TETRAHEDRON

__all__ = ["here"]  # fixture
MODELS = ROOT / "data_stubs" / "models"


def measure(method: str) -> dict[str, tuple[bool, float | None]]:
    asset = msb.open(MODELS / "pebble" / method)
    causes = why(asset, make_turntable(asset, 2, 64, 48))
    assert [cause.name for cause in causes] == [definition.name for definition in CAUSES]
    assert all((cause.db is None) == (not cause.applies) == (cause.reason is not None) for cause in causes)
    return {cause.name: (cause.applies, cause.db) for cause in causes}


@pytest.mark.slow
def test_causes_that_apply_to_each_method() -> None:
    blended = measure("two_dts")
    assert not blended["supersampling"][0]
    for name in ("view_dependence", "shading", "linear_colors", "opacity", "engine_order"):
        assert 5 < blended[name][1] < 60, name
    assert 10 < measure("mesh_splatting")["supersampling"][1] < 60
    neural = measure("diffsoup")
    assert neural["engine_order"] == (True, float("inf"))
    assert [name for name, (applies, _) in neural.items() if applies] == ["engine_order"]


def test_causes_that_apply_to_a_closed_mesh() -> None:
    vertices, faces = TETRAHEDRON
    colors = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [9, 9, 9]], np.uint8)
    asset = asset_from_mesh(Mesh(vertices, faces.astype(np.int64), colors))
    causes = by_name(why(asset, make_turntable(asset, 2, 48, 48)))
    applying = {name for name, cause in causes.items() if cause.applies}
    assert applying == {"supersampling", "shading", "linear_colors", "back_faces"}
    assert causes["back_faces"].db == float("inf")
    assert causes["back_faces"].to_dict()["db"] is None
    assert causes["back_faces"].to_dict()["equal"] is True
    inverted = asset_from_mesh(Mesh(vertices, faces[:, ::-1].astype(np.int64), colors))
    assert by_name(why(inverted, make_turntable(inverted, 2, 48, 48)))["back_faces"].db < 30


def test_textures_and_vertex_colours_have_the_same_losses() -> None:
    vertices, faces = TETRAHEDRON
    faces = faces[:, ::-1].astype(np.int64)
    paint, white = np.uint8([[200, 130, 60]]), np.full((2, 2, 3), 255, np.uint8)
    painted = np.tile(paint, (4, 4, 1))
    uvs = np.linspace(0, 3, 24, dtype=np.float32).reshape(12, 2)
    skin = {"corner_uvs": uvs, "face_textures": np.array([0, 1, 1, 0], np.uint32)}
    meshes = {
        "vertices": Mesh(vertices, faces, np.repeat(paint, 4, axis=0)),
        "tint": Mesh(vertices, faces, None, np.repeat(paint, 4, axis=0), **skin, textures=(white, white)),
        "texture": Mesh(vertices, faces, **skin, textures=(painted, painted)),
    }
    cameras = make_turntable(asset_from_mesh(meshes["vertices"]), 2, 48, 48)
    causes = {name: by_name(why(asset_from_mesh(mesh), cameras)) for name, mesh in meshes.items()}
    for name, cause in causes["vertices"].items():
        assert causes["tint"][name].db == (cause.db and pytest.approx(cause.db, abs=0.1))
    assert causes["texture"]["linear_colors"].reason
    for name in ("shading", "back_faces", "supersampling"):
        assert causes["texture"][name].db == pytest.approx(causes["vertices"][name].db, abs=0.3)


@pytest.mark.slow
def test_the_command_writes_json_and_images(here: Here, tmp_path: Path) -> None:
    options = ("--size", "48x36", "--save", tmp_path / "why", "--json", "-")
    data = here("why", *options, MODELS / "pebble" / "two_dts").json
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
def test_the_total_compares_the_images_of_both_renderers() -> None:
    asset = msb.open(MODELS / "walled" / "triangle_splatting")
    causes = why(asset, (view for view in VIEWS))  # a generator can be read only once
    total = causes.total
    plain = msb.metrics.psnr(pixels(asset, "standard"), pixels(asset, "dedicated"))
    assert total.db == total.right == pytest.approx(plain, abs=1e-6)
    assert 17.5 < plain < 19
    assert total.wrong < plain - 3
    # Soft edges are the largest cause here. The three causes that only a bake avoids make up the total.
    assert total.bakes == ("soft_edges", "opacity", "view_dependence")
    assert by_name(causes)["soft_edges"].db == pytest.approx(21.3, abs=0.7)
    assert total.baked == pytest.approx(plain, abs=0.7)
    record = total.to_dict()
    assert (record["db"], record["equal"], record["reason"]) == (total.db, False, None)
    assert record["engine_settings"] == {"wrong_db": total.wrong, "right_db": total.right}
    assert record["bake"] == {"db": total.baked, "causes": list(total.bakes)}


@pytest.mark.slow
def test_supersampling_reduces_the_total_of_a_supersampled_method() -> None:
    asset = msb.open(MODELS / "walled" / "mesh_splatting")
    causes = why(asset, VIEWS)
    expected = msb.metrics.psnr(pixels(asset, "standard", supersample=4), pixels(asset, "dedicated"))
    assert causes.total.right == pytest.approx(expected, abs=1e-6)
    assert causes.total.db < expected
    # Its edges are almost hard: sigma is 0.0001 after training.
    assert by_name(causes)["soft_edges"].db > 60
    assert "soft_edges" not in causes.total.bakes


@pytest.mark.slow
def test_without_static_colours_or_native_rendering_there_is_no_total() -> None:
    neural = why(MODELS / "walled" / "diffsoup", [CAMERA])
    assert by_name(neural)["soft_edges"].reason
    vertices, faces = TETRAHEDRON
    mesh = why(asset_from_mesh(Mesh(vertices, faces.astype(np.int64))), [CAMERA])
    for total in (neural.total, mesh.total):
        assert total.db is None
        assert total.reason
        assert total.to_dict()["db"] is None


@pytest.mark.parametrize("value", [0.5, None])
def test_given_settings_act_like_stored_settings(value: float | None) -> None:
    asset = msb.open(MODELS / "walled" / "two_dts")
    other = with_settings(asset, {"ste_threshold": None if value else 0.5})
    given = by_name(why(other, [CAMERA], settings={"ste_threshold": value}))
    stored = by_name(why(with_settings(asset, {"ste_threshold": value}), [CAMERA]))
    before = by_name(why(other, [CAMERA]))
    assert {name: cause.db for name, cause in given.items()} == {n: cause.db for n, cause in stored.items()}
    for name in ("shading", "linear_colors", "back_faces", "opacity", "engine_order"):
        assert given[name].db != before[name].db, name
    # Faces below the threshold stay hidden if the others become opaque.
    assert (given["opacity"].db == float("inf")) == (value is not None)


def test_light_is_applied_to_the_selected_faces() -> None:
    """The threshold of this model hides 278 faces. Compare with a mesh that is lit before rendering."""
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
    np.testing.assert_allclose(shading.with_it, draw(lit, camera).image.clip(0, 1), atol=1e-5)
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    front = ((camera.center - corners[:, 0]) * normal).sum(axis=1) > 0
    wrong = interpret_as_linear([draw(with_faces(lit, front), camera)])
    native = msb.render(asset, camera, tier="dedicated", background="black").image
    assert causes.total.wrong == pytest.approx(psnr_over_views(wrong, [native]), abs=1e-6)


def draw(mesh: Mesh, camera: msb.Camera) -> Frame:
    with msb.Renderer(asset_from_mesh(mesh), "standard") as renderer:
        return renderer.render(camera)


@pytest.mark.parametrize(
    ("cameras", "options"), [([], {}), (CAMERA, {}), (["a"], {}), ([CAMERA], {"settings": 3})]
)
def test_invalid_arguments_are_usage_errors(cameras: Any, options: dict[str, Any]) -> None:
    vertices, faces = TETRAHEDRON
    with pytest.raises(UsageError) as caught:
        why(asset_from_mesh(Mesh(vertices, faces.astype(np.int64))), cameras, **options)
    assert caught.value.code == "USAGE"


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_unselected_faces_are_not_drawn(dtype: type) -> None:
    random = np.random.default_rng(4)
    count = 50  # not a multiple of the renderer's block sizes
    vertices = random.uniform(-1, 1, (3 * count, 3)).astype(np.float32)
    colors = (random.random((3 * count, 3)) * (255 if dtype is np.uint8 else 1)).astype(dtype)
    faces = np.arange(3 * count).reshape(-1, 3)
    camera = Camera.look_at((0, 0, -4), (0, 0, 0), width=64, height=48, fov_y=0.8)
    with closing(_CullingRenderer(asset_from_mesh(Mesh(vertices, faces, colors)), None)) as renderer:
        for share in (0.5, 0.2):
            selected = random.random(count) < share
            renderer.select(selected)
            rest = asset_from_mesh(Mesh(vertices, faces[selected], colors))
            with closing(StandardRenderer(rest)) as alone:
                np.testing.assert_array_equal(renderer.render_image(camera), alone.render_image(camera))
                assert alone.render_image(camera).any()

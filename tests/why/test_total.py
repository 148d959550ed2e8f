"""`why` adds up: its total is what the two renderers' images say, and settings reach every row."""

from dataclasses import replace
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
from msb.scenes.datasets import read_scene
from msb.views import difference
from msb.why import Cause, Causes, why
from msb.why.causes import taken_for_linear
from tests.conftest import ROOT, TETRAHEDRON

MODELS = ROOT / "data_stubs" / "models"
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


def test_views_that_see_nothing_do_not_count() -> None:
    asset = msb.open(ROOT / "tests/tiny/models/pebble/mesh_splatting")
    away = msb.Camera.look_at((0.5, -0.5, 3), (1, -1, 6), **LOOK)
    both, one = why(asset, [away, CAMERA]), why(asset, [CAMERA])
    assert both.views.cameras == [CAMERA]
    assert both.total == one.total
    assert {name: cause.db for name, cause in by_name(both).items()} == {c.name: c.db for c in one}


def test_the_plain_mesh_is_the_standard_tier_with_the_settings() -> None:
    asset = msb.open(MODELS / "walled" / "two_dts")
    shading = by_name(why(asset, [CAMERA], settings={"ste_threshold": 0.5}))["shading"]
    drawn = msb.render(asset, CAMERA, tier="standard", settings={"ste_threshold": 0.5}).image.clip(0, 1)
    assert np.array_equal(shading.without, drawn)


def test_light_is_that_of_the_faces_that_are_shown() -> None:
    """A threshold hides 278 faces of this one; it is held to a mesh that is lit before it is drawn."""
    asset = msb.open(ROOT / "tests/golden/two_dts/ring_solid/checkpoint")
    camera = msb.Camera.look_at((1.0, -2.0, 2.5), (0, 0, 0), **LOOK)
    causes = why(asset, [camera], background="black")
    mesh = mesh_from_asset(asset)
    positions, indices = asset.buffers["positions"], asset.buffers["indices"]
    assert len(indices) == len(mesh.faces) + 278
    light = daylight(positions, indices, up_axis(asset))[visible_faces(asset, stored_threshold(asset))]
    assert mesh.vertex_colors is not None
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

"""Every engine that is installed draws what our z-buffer draws, by statistics that hold for rasterizers."""

import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import msb
from benchmarks.opened_in.__main__ import BLACK, compare
from benchmarks.opened_in.engines import ENTRIES
from benchmarks.opened_in.scenes import SCENES
from msb.asset import Asset
from msb.engines.agreement import agreement
from msb.engines.engine import DRAW, WALL_CLOCK
from msb.errors import MsbError
from msb.meshes import write_mesh
from msb.meshes.assets import mesh_from_asset
from msb.render import Frame
from msb.render.backend import ENGINES, find_renderer
from msb.scenes import Camera
from tests.engines.conftest import need
from tests.reference.golden import exported, golden_views
from tests.render.standard_scenes import BACKGROUND, camera, mesh_asset, random_colors, scene
from tests.render.textured_scenes import CASES, textured_asset

pytestmark = [pytest.mark.slow, pytest.mark.oracle]

OFF_CENTRE = replace(camera(160, 120, 150.0, (71.0, 66.5)), fx=170.0)
TALL = replace(camera(90, 130, 140.0, (50.0, 60.0)), fy=120.0)

WITHIN = {"wgpu": 0.999, "threejs": 0.96, "blender_cycles": 0.999, "blender_workbench": 0.999}
"""Share of pixels within a level where faces of some pixels cross and every corner has another colour.

SwiftShader, which draws three.js where there is no GPU, snaps corners to 1/16 pixel, hardware and lavapipe to
1/256.
"""
INTERIOR = {"wgpu": 1, "threejs": 4, "blender_cycles": 1, "blender_workbench": 1}
"""99.9th percentile of differences inside of faces, in levels."""


def frames(name: str, asset: Asset, views: list[Camera], **options: Any) -> tuple[list[Frame], list[Frame]]:
    with msb.Renderer(asset, name=need(name), **options) as renderer:
        theirs = [renderer.render(view, BACKGROUND) for view in views]
    options = {key: value for key, value in options.items() if key == "settings"}
    with msb.Renderer(asset, **options) as renderer:
        return theirs, [renderer.render(view, BACKGROUND) for view in views]


def colored(kind: str, dtype: Any = np.uint8) -> Asset:
    mesh = scene(kind, 3)
    return mesh_asset(mesh, random_colors(3, len(mesh[0]), dtype))


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("kind", ["small", "large", "through the camera", "everything"])
def test_agrees_with_our_z_buffer(name: str, kind: str) -> None:
    theirs, ours = frames(name, colored(kind), [OFF_CENTRE, TALL])
    found = agreement(theirs, ours)
    # "everything" has pairs of faces in the same place, whose order is no engine's business.
    assert found.within_a_level >= (WITHIN[name] if kind != "everything" else 0.95)
    assert found.covered_alike >= (0.999 if name != "threejs" else 0.99)
    if kind == "large":
        assert found.interior > 10_000
        assert found.interior_p999 <= INTERIOR[name]
    for frame, own in zip(theirs, ours, strict=True):
        nothing = frame.alpha == 0
        np.testing.assert_allclose(frame.image[nothing], np.tile(BACKGROUND, (nothing.sum(), 1)), atol=1e-6)
        assert not frame.depth[nothing].any()
        both = ~nothing & (own.alpha > 0)
        relative = np.abs(frame.depth - own.depth)[both] / own.depth[both]
        assert np.median(relative) < (1e-4 if name != "threejs" else 3e-3)


@pytest.mark.parametrize("name", ENGINES)
def test_float_colours_are_neither_rounded_nor_left_unclamped(name: str) -> None:
    theirs, ours = frames(name, colored("large", np.float32), [OFF_CENTRE])
    found = agreement(theirs, ours)
    assert found.interior_p999 <= INTERIOR[name]
    inside = np.abs(theirs[0].image - ours[0].image)[ours[0].alpha > 0]
    # Half a level is what bytes would leave; Workbench draws into half floats.
    assert np.median(inside) < 0.1 / 255
    beyond = 1e-6 if name != "threejs" else 1e-3  # SwiftShader goes a little beyond the corners
    assert theirs[0].image.min() >= -beyond
    assert theirs[0].image.max() <= 1 + beyond


@pytest.mark.parametrize("name", ENGINES)
def test_goldens(name: str) -> None:
    """One view of a golden scene of each method; benchmarks/engines.py has them all."""
    theirs, ours = [], []
    for method in ("two_dts", "triangle_splatting", "mesh_splatting"):
        view = golden_views(method)[0]
        pair = frames(name, exported(view.folder / "checkpoint"), [view.camera])
        theirs += pair[0]
        ours += pair[1]
    found = agreement(theirs, ours)
    assert found.within_a_level > (0.999 if name != "threejs" else 0.98)
    assert found.interior_within_a_level > (0.9999 if name != "threejs" else 0.99)


@pytest.mark.parametrize("name", ENGINES)
def test_a_renderer_like_ours(name: str) -> None:
    asset, made = colored("large"), find_renderer(need(name))
    assert any(sign.isdigit() for sign in made.installed())  # known before it draws
    with msb.Renderer(asset, name=name, supersample=2) as renderer:
        assert renderer.name.startswith(f"{name} ")
        assert set(renderer.device_info) == {"platform", "name", "kind"}
        frame = renderer.render(TALL, BACKGROUND)
        assert frame.image.shape == (130, 90, 3)
        assert frame.image.dtype == frame.depth.dtype == frame.alpha.dtype == np.float32
        assert set(np.unique(frame.alpha)) == {0.0, 0.25, 0.5, 0.75, 1.0}
        drawn = renderer.draw(OFF_CENTRE, BACKGROUND)
        assert set(drawn.stages) <= {DRAW, WALL_CLOCK}
        assert drawn.span == pytest.approx(sum(drawn.stages.values()))
        assert drawn.span > 0
        assert sum(renderer.memory().values()) > 0
        ours = msb.render(asset, TALL, background=BACKGROUND, supersample=2)
        assert np.abs(frame.image - ours.image).mean() < 2 / 255
    renderer.close()


@pytest.mark.parametrize("name", ENGINES)
def test_faces_a_threshold_hides_are_not_drawn(name: str) -> None:
    view = golden_views("two_dts")[0]
    asset = exported(view.folder / "checkpoint")
    for threshold in (0.3, 0.999999):
        theirs, ours = frames(name, asset, [view.camera], settings={"ste_threshold": threshold})
        assert agreement(theirs, ours).covered_alike > 0.998
        if theirs[0].face_id is not None:
            assert (theirs[0].face_id == ours[0].face_id).mean() > 0.998


@pytest.mark.parametrize("name", ["wgpu", "threejs"])
def test_no_gpu_and_too_large_an_image_are_told(name: str) -> None:
    factory = find_renderer(need(name))
    with factory(colored("small")) as renderer:
        with pytest.raises(MsbError) as info:
            renderer.render(camera(65_000, 8), BACKGROUND)
        assert info.value.code == "DEVICE_MEMORY"
        if renderer.device_info["kind"] == "gpu":
            return
    with pytest.raises(MsbError) as info:
        factory(colored("small"), device="gpu")
    assert info.value.code == "DEVICE_NOT_FOUND"


def draws_on_a_card() -> bool:
    with msb.Renderer(colored("small"), name=need("wgpu")) as renderer:
        return renderer.device_info is not None and renderer.device_info["kind"] == "gpu"


@pytest.mark.parametrize("kind", ["large", "through the camera", "far and wide"])
@pytest.mark.parametrize("case", CASES)
def test_wgpu_agrees_to_a_level(case: str, kind: str) -> None:
    """On a graphics card to a few: its samplers weigh two texels by 8 bits, Vulkan asks for 4 of them."""
    alike, covered = (0.9, 0.995) if draws_on_a_card() else (0.999, 0.999)
    for seed in (5, 6):
        asset = textured_asset(scene(kind, seed), seed, **CASES[case])
        theirs, ours = frames("wgpu", asset, [OFF_CENTRE, TALL])
        found = agreement(theirs, ours)
        assert found.interior_within_a_level >= alike
        assert found.interior_p999 <= 16
        assert found.covered_alike >= covered
        for one, own in zip(theirs, ours, strict=True):
            assert (one.face_id == own.face_id).mean() >= 0.999


def test_cycles_filters_linear_light() -> None:
    asset = textured_asset(scene("large", 5), 5, **CASES["level 0"] | {"tint": "vertex"})
    found = agreement(*frames("blender_cycles", asset, [OFF_CENTRE]))
    assert found.interior_within_a_level >= 0.999
    assert found.covered_alike >= 0.999


def test_wgpu_counts_textures_and_keeps_the_first_of_equal_faces() -> None:
    asset = textured_asset(scene("large", 7), 7, **CASES["several"])
    twice = [np.concatenate([asset.buffers[name]] * 2) for name in ("indices", "uv")]
    shown = np.concatenate([asset.buffers["face_texture"], (asset.buffers["face_texture"] + 1) % 3])
    parts = {"indices": twice[0], "uv": twice[1], "face_texture": shown.astype(np.uint32)}
    manifest = replace(asset.manifest, face_count=len(shown))
    with msb.Renderer(Asset(manifest, {**asset.buffers, **parts}), name=need("wgpu")) as renderer:
        seen = renderer.render(OFF_CENTRE).face_id
        groups = renderer.memory_groups()
        assert renderer.memory()["texture 1"] == 4 * (7 + 3 + 1)
    assert seen is not None
    assert 0 <= seen.max() < len(shown) // 2
    assert groups["texture 2"] == groups["texture coordinates"] == "appearance"


TAKE_SRGB_EXACTLY = {"three.js": 1, "<model-viewer>": 1, "Galacean": 1, "pygfx": 2}
"""Engine -> the levels by which 99.9 % of the pixels inside of faces differ at most."""


@pytest.mark.slow
@pytest.mark.parametrize("name", TAKE_SRGB_EXACTLY)
def test_a_textured_glb_is_shown_as_it_should_with_no_setting_touched(name: str) -> None:
    engine = ENTRIES[name].engine
    if missing := engine.missing():
        pytest.skip(f"{name}: {missing}")
    scene = SCENES["texture"][1]()
    ours = msb.render(scene.asset, scene.camera, tier="standard", background=BLACK)
    file = io.BytesIO()
    write_mesh(mesh_from_asset(scene.asset), file, suffix=".glb")
    shown = engine.draw(file.getvalue(), scene, mended=False)
    assert compare(shown.image, ours)["p999"] <= TAKE_SRGB_EXACTLY[name]

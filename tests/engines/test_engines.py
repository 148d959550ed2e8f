"""Every installed engine draws the same images as our standard-tier renderer, within tolerances."""

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

# Minimum share of pixels that differ by at most one level of 255. The scenes have crossing faces of a few
# pixels with random corner colours. SwiftShader, which draws three.js without a GPU, snaps corners to 1/16
# pixel. Hardware and lavapipe snap them to 1/256 pixel.
WITHIN = {"wgpu": 0.999, "threejs": 0.96, "blender_cycles": 0.999, "blender_workbench": 0.999}
# Maximum of the 99.9th percentile of differences in the interior of faces, in levels.
INTERIOR = {"wgpu": 1, "threejs": 4, "blender_cycles": 1, "blender_workbench": 1}

every_engine = pytest.mark.parametrize("name", ENGINES)


def draw_both(
    name: str, asset: Asset, views: list[Camera], **options: Any
) -> tuple[list[Frame], list[Frame]]:
    """Return the frames of renderer `name`, and those of our standard-tier renderer."""
    with msb.Renderer(asset, name=need(name), **options) as renderer:
        theirs = [renderer.render(view, BACKGROUND) for view in views]
    with msb.Renderer(asset, **options) as renderer:
        return theirs, [renderer.render(view, BACKGROUND) for view in views]


def colored_asset(kind: str, dtype: Any = np.uint8) -> Asset:
    mesh = scene(kind, 3)
    return mesh_asset(mesh, random_colors(3, len(mesh[0]), dtype))


@every_engine
@pytest.mark.parametrize("kind", ["small", "large", "through the camera", "everything"])
def test_agrees_with_our_z_buffer(name: str, kind: str) -> None:
    theirs, ours = draw_both(name, colored_asset(kind), [OFF_CENTRE, TALL])
    result = agreement(theirs, ours)
    # "everything" has coincident faces, and an engine may show any of these faces.
    assert result.within_a_level >= (WITHIN[name] if kind != "everything" else 0.95)
    assert result.covered_alike >= (0.999 if name != "threejs" else 0.99)
    if kind == "large":
        assert result.interior > 10_000
        assert result.interior_p999 <= INTERIOR[name]
    for frame, expected in zip(theirs, ours, strict=True):
        empty = frame.alpha == 0
        np.testing.assert_allclose(frame.image[empty], np.tile(BACKGROUND, (empty.sum(), 1)), atol=1e-6)
        assert not frame.depth[empty].any()
        both = ~empty & (expected.alpha > 0)
        relative = np.abs(frame.depth - expected.depth)[both] / expected.depth[both]
        assert np.median(relative) < (1e-4 if name != "threejs" else 3e-3)


@every_engine
def test_float_colours_are_clamped_but_not_rounded(name: str) -> None:
    theirs, ours = draw_both(name, colored_asset("large", np.float32), [OFF_CENTRE])
    assert agreement(theirs, ours).interior_p999 <= INTERIOR[name]
    difference = np.abs(theirs[0].image - ours[0].image)[ours[0].alpha > 0]
    # Rounding to bytes would give about 0.25 levels. Workbench draws into half floats.
    assert np.median(difference) < 0.1 / 255
    beyond = 1e-6 if name != "threejs" else 1e-3  # SwiftShader extrapolates a little beyond the corners
    assert theirs[0].image.min() >= -beyond
    assert theirs[0].image.max() <= 1 + beyond


@every_engine
def test_golden_models(name: str) -> None:
    """Compare one golden view of each method; benchmarks/engines.py draws all views."""
    theirs, ours = [], []
    for method in ("two_dts", "triangle_splatting", "mesh_splatting"):
        view = golden_views(method)[0]
        pair = draw_both(name, exported(view.folder / "checkpoint"), [view.camera])
        theirs += pair[0]
        ours += pair[1]
    result = agreement(theirs, ours)
    assert result.within_a_level > (0.999 if name != "threejs" else 0.98)
    assert result.interior_within_a_level > (0.9999 if name != "threejs" else 0.99)


@every_engine
def test_the_renderer_has_the_common_interface(name: str) -> None:
    asset, renderer_class = colored_asset("large"), find_renderer(need(name))
    assert any(sign.isdigit() for sign in renderer_class.installed())  # known before it draws
    with msb.Renderer(asset, name=name, supersample=2) as renderer:
        assert renderer.name.startswith(f"{name} ")
        assert set(renderer.device_info) == {"platform", "name", "kind"}
        frame = renderer.render(TALL, BACKGROUND)
        assert frame.image.shape == (130, 90, 3)
        assert frame.image.dtype == frame.depth.dtype == frame.alpha.dtype == np.float32
        assert set(np.unique(frame.alpha)) == {0.0, 0.25, 0.5, 0.75, 1.0}
        timing = renderer.draw(OFF_CENTRE, BACKGROUND)
        assert set(timing.stages) <= {DRAW, WALL_CLOCK}
        assert timing.span == pytest.approx(sum(timing.stages.values()))
        assert timing.span > 0
        assert sum(renderer.memory().values()) > 0
        ours = msb.render(asset, TALL, background=BACKGROUND, supersample=2)
        assert np.abs(frame.image - ours.image).mean() < 2 / 255
    renderer.close()


@every_engine
@pytest.mark.parametrize("threshold", [0.3, 0.999999])
def test_faces_below_a_threshold_are_not_drawn(name: str, threshold: float) -> None:
    view = golden_views("two_dts")[0]
    asset = exported(view.folder / "checkpoint")
    theirs, ours = draw_both(name, asset, [view.camera], settings={"ste_threshold": threshold})
    assert agreement(theirs, ours).covered_alike > 0.998
    if theirs[0].face_id is not None:
        assert (theirs[0].face_id == ours[0].face_id).mean() > 0.998


@pytest.mark.parametrize("name", ["wgpu", "threejs"])
def test_a_missing_gpu_and_a_too_large_image_are_errors(name: str) -> None:
    renderer_class = find_renderer(need(name))
    with renderer_class(colored_asset("small")) as renderer:
        with pytest.raises(MsbError) as info:
            renderer.render(camera(65_000, 8), BACKGROUND)
        assert info.value.code == "DEVICE_MEMORY"
        if renderer.device_info["kind"] == "gpu":
            return
    with pytest.raises(MsbError) as info:
        renderer_class(colored_asset("small"), device="gpu")
    assert info.value.code == "DEVICE_NOT_FOUND"


def has_graphics_card() -> bool:
    with msb.Renderer(colored_asset("small"), name=need("wgpu")) as renderer:
        return renderer.device_info is not None and renderer.device_info["kind"] == "gpu"


@pytest.mark.parametrize("kind", ["large", "through the camera", "far and wide"])
@pytest.mark.parametrize("case", CASES)
def test_wgpu_agrees_on_textures(case: str, kind: str) -> None:
    """Graphics cards may differ by a few levels, because samplers may weigh texels with only 4 bits."""
    alike, covered = (0.9, 0.995) if has_graphics_card() else (0.999, 0.999)
    for seed in (5, 6):
        asset = textured_asset(scene(kind, seed), seed, **CASES[case])
        theirs, ours = draw_both("wgpu", asset, [OFF_CENTRE, TALL])
        result = agreement(theirs, ours)
        assert result.interior_within_a_level >= alike
        assert result.interior_p999 <= 16
        assert result.covered_alike >= covered
        for frame, expected in zip(theirs, ours, strict=True):
            assert (frame.face_id == expected.face_id).mean() >= 0.999


def test_cycles_filters_linear_light() -> None:
    asset = textured_asset(scene("large", 5), 5, **CASES["level 0"] | {"tint": "vertex"})
    result = agreement(*draw_both("blender_cycles", asset, [OFF_CENTRE]))
    assert result.interior_within_a_level >= 0.999
    assert result.covered_alike >= 0.999


def test_wgpu_counts_textures_and_draws_the_first_of_coincident_faces() -> None:
    asset = textured_asset(scene("large", 7), 7, **CASES["several"])
    twice = {name: np.concatenate([asset.buffers[name]] * 2) for name in ("indices", "uv")}
    numbers = asset.buffers["face_texture"]
    twice["face_texture"] = np.concatenate([numbers, (numbers + 1) % 3]).astype(np.uint32)
    manifest = replace(asset.manifest, face_count=2 * len(numbers))
    with msb.Renderer(Asset(manifest, {**asset.buffers, **twice}), name=need("wgpu")) as renderer:
        face_id = renderer.render(OFF_CENTRE).face_id
        groups = renderer.memory_groups()
        assert renderer.memory()["texture 1"] == 4 * (7 + 3 + 1)
    assert face_id is not None
    assert 0 <= face_id.max() < len(numbers)
    assert groups["texture 2"] == groups["texture coordinates"] == "appearance"


# Engine -> maximum of the 99.9th percentile of differences in the interior of faces, in levels.
DEFAULT_TOLERANCE = {"three.js": 1, "<model-viewer>": 1, "Galacean": 1, "pygfx": 2}


@pytest.mark.parametrize("name", DEFAULT_TOLERANCE)
def test_a_textured_glb_is_correct_with_the_engines_default_settings(name: str) -> None:
    engine = ENTRIES[name].engine
    if missing := engine.missing():
        pytest.skip(f"{name}: {missing}")
    textured = SCENES["texture"][1]()
    ours = msb.render(textured.asset, textured.camera, tier="standard", background=BLACK)
    file = io.BytesIO()
    write_mesh(mesh_from_asset(textured.asset), file, suffix=".glb")
    image = engine.draw(file.getvalue(), textured, mended=False).image
    assert compare(image, ours)["p999"] <= DEFAULT_TOLERANCE[name]

"""Random scenes with textures: what hardware's samplers show is what ours shows."""

from dataclasses import replace

import numpy as np
import pytest

import msb
from msb.asset import Asset
from msb.engines.agreement import agreement
from msb.engines.webgpu_texture import runs_of
from tests.engines.conftest import need
from tests.engines.test_engines import OFF_CENTRE, TALL, colored, frames
from tests.render.standard_scenes import scene
from tests.render.textured_scenes import CASES, textured_asset


def draws_on_a_card() -> bool:
    with msb.Renderer(colored("small"), name=need("wgpu")) as renderer:
        return renderer.device_info is not None and renderer.device_info["kind"] == "gpu"


@pytest.mark.slow
@pytest.mark.oracle
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


@pytest.mark.slow
@pytest.mark.oracle
def test_cycles_filters_linear_light() -> None:
    asset = textured_asset(scene("large", 5), 5, **CASES["level 0"] | {"tint": "vertex"})
    found = agreement(*frames("blender_cycles", asset, [OFF_CENTRE]))
    assert found.interior_within_a_level >= 0.999
    assert found.covered_alike >= 0.999


@pytest.mark.slow
@pytest.mark.oracle
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


def test_faces_are_drawn_in_runs_of_one_texture() -> None:
    assert runs_of(np.array([4, 4, 2, 4], np.uint32)) == [(4, 0, 2), (2, 2, 1), (4, 3, 1)]

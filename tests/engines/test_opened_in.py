"""Engines of other people show a GLB as it comes; what each gets wrong is a table of benchmarks/opened_in."""

import io

import pytest

import msb
from benchmarks.opened_in.__main__ import BLACK, compare
from benchmarks.opened_in.engines import ENTRIES
from benchmarks.opened_in.scenes import SCENES
from msb.meshes import write_mesh
from msb.meshes.assets import mesh_from_asset

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

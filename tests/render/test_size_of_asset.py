"""A turntable shows the same image of an object at every scale."""

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import msb
from data_stubs.surface import icosphere
from msb.asset import build_asset
from msb.errors import SceneError
from msb.metrics import psnr
from msb.reference import render_reference
from msb.scenes import interpolate_cameras, read_cameras, write_cameras
from msb.scenes.around import make_turntable
from tests.conftest import ROOT

SIZES = [10.0**power for power in range(-6, 7)]


def ball(radius: float) -> msb.Asset:
    directions, faces = icosphere(6)
    colors = (np.abs(directions) * 255).astype(np.uint8)
    positions = (radius * directions).astype(np.float32)
    return build_asset(
        {"positions": positions, "indices": faces.astype(np.uint32), "color": colors}, {"color": "vertex"}
    )


@pytest.mark.parametrize("radius", SIZES)
def test_a_ball_looks_alike_at_every_size(radius: float) -> None:
    frames = []
    for asset in (ball(1.0), ball(radius)):
        (camera, _) = make_turntable(asset, 2, 96, 72)
        frames.append(msb.render(asset, camera))
    unit, scaled = frames
    assert unit.alpha.mean() > 0.4
    assert psnr(unit.image.clip(0, 1), scaled.image.clip(0, 1)) > 60
    np.testing.assert_allclose(scaled.depth / radius, unit.depth, atol=1e-3)


@pytest.mark.parametrize("radius", [1e30, 9e17])
def test_a_ball_too_large_for_cameras_is_an_error_with_its_file(radius: float) -> None:
    with pytest.raises(SceneError, match=r"^CAMERA_PATH: huge\.ply: ") as caught:
        make_turntable(replace(ball(radius), opened_from=Path("huge.ply")), 2, 96, 72)
    assert f"{radius:g}" in caught.value.message


@pytest.mark.parametrize("method", ["two_dts", "mesh_splatting", "diffsoup"])
def test_a_small_model_is_rendered_like_a_large_one(method: str) -> None:
    asset = msb.open(ROOT / "data_stubs" / "models" / "pebble" / method)
    sphere = asset.manifest.bounding_sphere
    smaller = replace(sphere, radius=sphere.radius / 128, center=tuple(x / 128 for x in sphere.center))
    positions = asset.buffers["positions"] / np.float32(128)
    manifest = replace(asset.manifest, bounding_sphere=smaller)
    half = replace(asset, buffers={**asset.buffers, "positions": positions}, manifest=manifest)
    (large, small) = (make_turntable(item, 1, 64, 48)[0] for item in (asset, half))
    assert (large.unit, small.unit < 1) == (1.0, True)
    whole = msb.render(asset, large, tier="dedicated")
    for frame in (msb.render(half, small, tier="dedicated"), render_reference(half, small)):
        assert psnr(whole.image.clip(0, 1), np.asarray(frame.image).clip(0, 1)) > 60
        np.testing.assert_allclose(128 * frame.depth, whole.depth, atol=1e-3)


def test_the_unit_of_a_camera_is_preserved(tmp_path: Path) -> None:
    cameras = make_turntable(ball(1e-3), 3, 64, 48)
    assert cameras[0].unit < 0.01
    write_cameras(cameras, tmp_path / "views.json")
    assert read_cameras(tmp_path / "views.json") == cameras
    assert copy.deepcopy(cameras[0]) == cameras[0]
    assert {camera.unit for camera in interpolate_cameras(cameras, 5)} == {cameras[0].unit}
    assert cameras[0].resized(32, 24).unit == cameras[0].in_units().resized(32, 24).unit * cameras[0].unit
    with pytest.raises(SceneError, match="unit is 0"):
        replace(cameras[0], unit=0)

"""The standard tier with textures, against its NumPy twin."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from msb.asset import Asset
from msb.asset.texture import Sampler, mip_levels, texture_images
from msb.cl import Device
from msb.errors import AssetError, DeviceError
from msb.render.frame import interior
from msb.render.standard.renderer import StandardRenderer
from msb.render.standard.supersampling import box_filter, enlarge
from tests.cl.conftest import WITHOUT_ATOMICS, open_styled
from tests.conftest import ROOT
from tests.render.standard_scenes import (
    camera,
    check_agreement,
    check_equal,
    draw,
    scattered,
    scene,
    unshared,
)
from tests.render.textured_scenes import CASES, golden_scene, textured_asset, textured_twin

NEAR = 2e-4
"""Tolerance of colours; one level of 255 is 4e-3."""


FEW = scattered(11, 40, 1.2, 1, 4), scattered(12, 60, 0.08, 1, 3), scattered(13, 30, 0.7, 1.2, 0)


@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("case", CASES)
def test_textured_meshes_match_the_twin(styled: Device, case: str, every: bool) -> None:
    mesh = scene("everything", 15) if every else unshared(np.concatenate(FEW))
    asset = textured_asset(mesh, 14, **CASES[case])
    frame, expected = draw(styled, asset, camera()), textured_twin(asset, camera())
    check_agreement(frame, expected, median=3e-5)  # texels have 16 bits
    same = frame.face_id == expected.face_id
    assert same.any()
    assert (np.abs(frame.image - expected.image).max(axis=2)[same] > NEAR).mean() <= 1e-3


@pytest.mark.parametrize("case", CASES)
def test_agrees_with_another_renderer(styled: Device, case: str) -> None:
    """Away from silhouettes, the image is within one level of an image that Mesa's lavapipe rendered."""
    asset, view = golden_scene(case)
    with np.load(ROOT / "tests/golden/textures" / f"{case.replace(' ', '_')}.npz") as kept:
        image, faces = kept["image"], kept["face_id"]
    frame = draw(styled, asset, view)
    inner = interior(frame.face_id)
    assert inner.sum() > 400
    assert (frame.face_id == faces).mean() >= 0.999
    levels = np.abs(np.rint(255 * frame.image) - image)[inner]
    assert (levels.max(axis=1) <= 1).mean() >= 0.999


@pytest.mark.slow
@pytest.mark.parametrize("case", ["minified", "cut out"])
def test_without_atomics(gpu: Device, case: str) -> None:
    asset = textured_asset(scene("everything", 17), 18, **CASES[case])
    with open_styled(WITHOUT_ATOMICS) as device:
        check_equal(draw(device, asset, camera()), draw(gpu, asset, camera()))


def layers(alphas: list[int], **sampler: Any) -> Asset:
    """Return coincident squares, each with a separate white texture of one alpha."""
    square = np.array([[[-1, -1, 3], [1, -1, 3], [1, 1, 3]], [[-1, -1, 3], [1, 1, 3], [-1, 1, 3]]], float)
    mesh = unshared(np.concatenate([square] * len(alphas)))
    case = {"sampler": Sampler(**sampler), "sizes": ((1, 1, 4),) * max(2, len(alphas))}
    asset = textured_asset(mesh, 1, **case)
    textures = {
        f"texture.{i}": np.full((1, 1, 4), (255, 255, 255, a), np.uint8) for i, a in enumerate(alphas)
    }
    numbers = np.repeat(np.arange(len(alphas), dtype=np.uint32), 2)
    buffers = {**asset.buffers, **textures, "face_texture": numbers}
    return Asset(asset.manifest, buffers)


@pytest.mark.parametrize(("cutoff", "first"), [(None, 0), (0.0, 0), (0.25, 1), (0.75, 2), (1.0, 2)])
def test_cut_out_layers_hide_nothing(styled: Device, cutoff: float | None, first: int) -> None:
    """Among coincident layers, the first whose alpha reaches the cutoff is visible."""
    frame = draw(styled, layers([20, 128, 255], alpha_cutoff=cutoff), camera())
    middle = frame.face_id[20:40, 30:50]
    assert set(np.unique(middle)) <= {2 * first, 2 * first + 1}
    assert np.array_equal(frame.alpha > 0, frame.face_id >= 0)


def test_the_mip_level_is_chosen_per_sample(cpu: Device) -> None:
    asset = textured_asset(unshared(scattered(19, 30, 1.2, 1, 4)), 20, **CASES["several"])
    fine = box_filter(draw(cpu, asset, enlarge(camera(), 3)), 3)
    assert np.array_equal(draw(cpu, asset, camera(), supersample=3).image, fine.image)


def test_any_finite_texture_coordinate_is_drawn(styled: Device) -> None:
    random = np.random.default_rng(21)
    for case in ("minified", "several", "nearest"):
        asset = textured_asset(unshared(scattered(22, 60, 1.2, 1, 4)), 23, **CASES[case])
        size = 10.0 ** random.uniform(-40, 38, asset.buffers["uv"].shape)
        uvs = (size * random.choice([-1, 0, 1], size.shape)).astype(np.float32)
        frame = draw(styled, Asset(asset.manifest, {**asset.buffers, "uv": uvs}), camera())
        assert (np.isfinite(frame.image) & (frame.image >= 0) & (frame.image <= 1)).all()


def test_textures_are_counted_and_rejected_if_they_do_not_fit(fresh: Device) -> None:
    asset = textured_asset(scene("large", 24), 25, **CASES["several"])
    renderer = StandardRenderer(asset, device=fresh)
    texels = sum(
        (image.shape[0] + 1) * (image.shape[1] + 1)
        for texture in texture_images(asset.buffers)
        for image in mip_levels(texture)
    )
    assert renderer.memory()["standard textures"] == 8 * texels
    groups = renderer.memory_groups()
    assert {groups[use] for use in ("standard textures", "standard colors")} == {"appearance"}
    renderer.close()
    fresh._queue.record = replace(fresh.record, max_allocation=40_000)
    with pytest.raises(DeviceError, match="standard textures") as raised:
        StandardRenderer(asset, device=fresh)
    assert raised.value.code == "DEVICE_MEMORY"


def test_invalid_texture_coordinates_and_numbers_are_rejected(cpu: Device) -> None:
    asset = textured_asset(scene("large", 26), 27, **CASES["several"])
    uvs, numbers = asset.buffers["uv"].copy(), asset.buffers["face_texture"].copy()
    uvs[5, 1], numbers[7] = np.nan, 3
    for name, wrong, where in (("uv", uvs, "row 5"), ("face_texture", numbers, "face 7 uses texture 3")):
        with pytest.raises(AssetError, match=where):
            StandardRenderer(Asset(asset.manifest, {**asset.buffers, name: wrong}), device=cpu)

"""The opaque z-buffer against its NumPy twin, in both kernel styles, and limit cases."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from msb.asset import Asset
from msb.asset.sh import SH_C0
from msb.cl import Device, open_device
from msb.errors import Unsupported
from msb.render.standard.renderer import StandardRenderer
from tests.cl.conftest import SELECTOR, STYLES, open_styled
from tests.reference.soups import random_triangles, soup
from tests.render.standard_scenes import (
    BACKGROUND,
    KINDS,
    camera,
    check_agreement,
    check_equal,
    draw,
    mesh_asset,
    random_colors,
    scattered,
    scene,
    twin,
    unshared,
)


@pytest.fixture(scope="module")
def devices() -> Iterator[dict[str, Device]]:
    """Return a device per style; CPU-style tests use the GPU style on devices without the CPU style."""
    opened = {"cpu": open_device(SELECTOR), **{style: open_styled(style) for style in STYLES[1:]}}
    yield opened
    for device in opened.values():
        device.close()


@pytest.fixture(params=[STYLES[0], pytest.param(STYLES[1], marks=pytest.mark.slow)])
def device(request: pytest.FixtureRequest, devices: dict[str, Device]) -> Device:
    """Return a device of each style; `tests.machines` runs these tests on other devices."""
    return devices[request.param]


@pytest.mark.parametrize("seed", [1, pytest.param(0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", KINDS)
def test_both_styles_agree_with_the_twin(devices: dict[str, Device], kind: str, seed: int) -> None:
    mesh = scene(kind, seed)
    colors = random_colors(seed, len(mesh[0]))
    pose = np.eye(4)
    if seed:  # not in line with any axis
        pose[:3, :3] = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
        pose[:3, :3] *= np.linalg.det(pose[:3, :3])
        mesh = (mesh[0] @ pose[:3, :3].astype(np.float32), mesh[1])
    view = camera(pose=pose)
    expected = twin(mesh, colors, view)
    for style in STYLES[:2]:
        frame = draw(devices[style], mesh_asset(mesh, colors), view)
        assert (frame.face_id >= 0).sum() > 30
        check_agreement(frame, expected)


def test_hidden_layers(devices: dict[str, Device]) -> None:
    """With many hidden triangles the CPU culls whole clusters; the GPU draws all of them."""
    u, v = np.meshgrid(np.linspace(-3, 3, 90), np.linspace(-3, 3, 90))
    layers = [np.stack([u, v, 3 + 0.4 * k + 0.3 * np.sin(5 * u + k)], axis=-1) for k in range(4)]
    at = (np.arange(89)[:, None] * 90 + np.arange(89)).reshape(-1, 1)
    faces = np.concatenate([at + np.array(corners) for corners in ((0, 1, 90), (1, 91, 90))])
    positions = np.concatenate(layers[::-1]).reshape(-1, 3).astype(np.float32)
    indices = np.concatenate([faces + 8100 * k for k in range(4)]).astype(np.uint32)
    mesh = positions, np.random.default_rng(0).permutation(indices)
    asset = mesh_asset(mesh, random_colors(0, len(positions)))
    first, second = (draw(devices[style], asset, camera(200, 150, 150.0)) for style in STYLES[:2])
    assert first.alpha.all()
    check_equal(first, second)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("domain", ["vertex", "face", "corner"])
def test_colors_of_every_domain(device: Device, domain: str, dtype: type) -> None:
    positions = scene("small", 3)[0][:900]
    where = np.random.default_rng(3).integers(0, 900, (400, 3))
    near = np.abs(positions[where] - positions[where[:, :1]]).max(axis=(1, 2)) < 3
    mesh = positions, where[near].astype(np.uint32)
    rows = {"vertex": 900, "face": len(mesh[1]), "corner": 3 * len(mesh[1])}[domain]
    colors = random_colors(4, rows, dtype)
    frame = draw(device, mesh_asset(mesh, colors, domain), camera())
    check_agreement(frame, twin(mesh, colors, camera(), domain))
    assert frame.image.min() >= 0
    assert frame.image.max() <= 1


BIG: NDArray[np.float64] = np.array([[[-9.0, -9, 2], [9, -9, 2], [0, 12, 2]]])


@pytest.mark.parametrize("corners", [[0, 1, 2], [2, 0, 1], [1, 0, 2]])
def test_equal_depths_go_to_the_lowest_face(device: Device, corners: list[int]) -> None:
    for size in (0.06, 0.5, 4.0):  # these sizes are drawn by blocks, by rows and by spans
        triangles = scattered(5, 40, size, 0.5, 4)
        doubled = np.concatenate([triangles[::-1][:, corners], triangles, triangles])
        frame = draw(device, mesh_asset(unshared(doubled)), camera())
        single = draw(device, mesh_asset(unshared(triangles[::-1])), camera())
        assert (single.face_id >= 0).any()
        np.testing.assert_array_equal(frame.face_id, single.face_id)


def test_nothing_nearer_than_the_near_plane(device: Device) -> None:
    for depth, seen in ((0.00999, False), (0.0101, True)):
        triangle = np.array([[[-1, -1, depth], [1, -1, depth], [0, 2, depth]]])
        assert draw(device, mesh_asset(unshared(triangle)), camera()).alpha.any() == seen


def test_behind_and_beside_the_camera(device: Device) -> None:
    view = camera()
    for triangles in (
        scattered(1, 50, 0.5, 1, -9),
        scattered(1, 50, 0.5, 1, 4) + np.array([90, 0, 0]),
        BIG[:, [0, 0, 1]],
    ):
        frame = draw(device, mesh_asset(unshared(triangles)), view)
        np.testing.assert_array_equal(frame.image, np.broadcast_to(np.float32(BACKGROUND), frame.image.shape))
        assert not frame.alpha.any()
        assert not frame.depth.any()
        assert (frame.face_id == -1).all()


def test_far_from_the_origin(device: Device) -> None:
    """Positions that are exact in float32 must have exact differences to the camera."""
    mesh = scene("small", 19)
    positions = np.round(mesh[0] * 1024) / 1024
    offset = np.array([4096.0, -2048, 1024])
    pose = np.eye(4)
    pose[:3, 3] = -offset
    colors = random_colors(19, len(positions))
    here = draw(device, mesh_asset((positions.astype(np.float32), mesh[1]), colors), camera())
    there = (positions + offset).astype(np.float32)
    np.testing.assert_array_equal(there, positions + offset)
    frame = draw(device, mesh_asset((there, mesh[1]), colors), camera(pose=pose))
    np.testing.assert_array_equal(frame.face_id, here.face_id)


def test_supersampling(device: Device) -> None:
    mesh = scene("everything", 23)
    asset = mesh_asset(mesh, random_colors(23, len(mesh[0])))
    view = camera(40, 30, 35.0)
    frame = draw(device, asset, view, supersample=3)
    fine = draw(device, asset, view.resized(120, 90))
    np.testing.assert_allclose(frame.image, fine.image.reshape(30, 3, 40, 3, 3).mean(axis=(1, 3)), atol=1e-6)
    np.testing.assert_allclose(frame.alpha, fine.alpha.reshape(30, 3, 40, 3).mean(axis=(1, 3)), atol=1e-6)
    depth = np.where(fine.depth > 0, fine.depth, np.inf).reshape(30, 3, 40, 3).min(axis=(1, 3))
    np.testing.assert_array_equal(frame.depth, np.where(np.isfinite(depth), depth, 0))
    samples = fine.face_id.reshape(30, 3, 40, 3).transpose(0, 2, 1, 3).reshape(30, 40, 9)
    assert (samples == frame.face_id[..., None]).any(axis=-1).all()


def test_a_mesh_without_colors_is_grey_and_lit(device: Device) -> None:
    image = draw(device, mesh_asset(unshared(BIG)), camera()).image
    red, green, blue = image[30, 40].tolist()
    assert red == green == blue
    assert 0.2 < red < 0.9
    turned = BIG.copy()
    turned[..., 2] += 0.7 * turned[..., 0]
    assert draw(device, mesh_asset(unshared(turned)), camera()).image[30, 40, 0] != red


def two_dts(count: int, **settings: Any) -> Asset:
    triangles = random_triangles(1, count, 1.0)
    opacity = np.linspace(-3, 3, count).astype(np.float32)
    return soup("two_dts", triangles, seed=1, opacity=opacity, **settings)


def test_zeroth_coefficient_is_baked(styled: Device) -> None:
    asset = two_dts(60)
    colors = np.clip(SH_C0 * asset.buffers["f_dc"].reshape(60, 3) + 0.5, 0, 1)
    view = camera()
    frame = draw(styled, asset, view, ste_threshold=None)
    mesh = asset.buffers["positions"], asset.buffers["indices"]
    expected = twin(mesh, colors, view, "face")
    same = frame.face_id == expected.face_id
    assert same.mean() > 0.999
    np.testing.assert_allclose(frame.image[same], expected.image[same], atol=1e-6)


def test_hidden_faces_keep_numbers(styled: Device) -> None:
    asset = two_dts(60)
    view = camera()
    everything = draw(styled, asset, view, ste_threshold=None)
    half = draw(styled, asset, view, ste_threshold=0.5)  # sigmoid(x) > 0.5 where x > 0: faces 30 to 59
    assert {*np.unique(half.face_id)} <= {-1, *range(30, 60)}
    kept = everything.face_id >= 30
    assert kept.any()
    np.testing.assert_array_equal(half.face_id[kept], everything.face_id[kept])
    none = draw(styled, asset, view, ste_threshold=1.0)
    assert not none.alpha.any()
    np.testing.assert_array_equal(none.image, np.broadcast_to(np.float32(BACKGROUND), none.image.shape))


def test_coordinates_with_an_overflowing_sum_are_drawn(styled: Device) -> None:
    positions, indices = scene("small", 0)
    positions[:3] = np.finfo(np.float32).max
    frame = draw(styled, mesh_asset((positions, indices)), camera())
    assert np.isfinite(frame.image).all()
    assert frame.alpha.any()


def test_supersample_is_an_option_of_the_standard_tier_only(cpu: Device) -> None:
    """MeshSplatting has a setting of the same name.

    The setting belongs to native rendering and has no effect here.
    """
    asset = soup("mesh_splatting", random_triangles(1, 20), welded=True)
    plain = draw(cpu, asset, camera())
    with_setting = msb.render(asset, camera(), "standard", BACKGROUND, {"supersample": 2}, cpu)
    np.testing.assert_array_equal(plain.image, with_setting.image)
    with pytest.raises(Unsupported, match="UNSUPPORTED_OPTION"):
        msb.render(asset, camera(), "dedicated", device=cpu, supersample=2)


@pytest.mark.slow
def test_render_image_equals_the_image_of_the_frame(styled: Device) -> None:
    mesh = scene("everything", 5)
    renderer = StandardRenderer(mesh_asset(mesh, random_colors(5, len(mesh[0]))), device=styled)
    frame = renderer.render(camera(), BACKGROUND)
    out = np.zeros_like(frame.image)
    assert renderer.render_image(camera(), BACKGROUND, out) is out
    np.testing.assert_array_equal(out, frame.image)
    np.testing.assert_array_equal(renderer.render_image(camera(), BACKGROUND), frame.image)
    frame.image[:] = frame.depth[:] = 7
    again = renderer.render(camera(), BACKGROUND, out=frame)
    assert again.image is frame.image
    np.testing.assert_array_equal(again.image, out)
    assert not (again.depth == 7).any()
    renderer.close()


def test_the_asset_may_be_deleted_after_construction(styled: Device) -> None:
    """The upload may share memory with the asset's arrays."""
    asset = mesh_asset(scene("small", 9))
    renderer = StandardRenderer(asset, device=styled)
    before = renderer.render(camera(), BACKGROUND)
    del asset
    np.testing.assert_array_equal(renderer.render(camera(), BACKGROUND).image, before.image)
    renderer.close()

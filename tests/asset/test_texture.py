"""Textures: mip levels, sampling, colours at corners, and conversion from and to a mesh."""

from itertools import pairwise

import numpy as np
import pytest

from msb.asset.look import colors_of
from msb.asset.texture import (
    LINEAR,
    Sampler,
    decode_texels,
    linear_to_srgb,
    mip_levels,
    sample,
    srgb_to_linear,
)
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from tests.corpus.good import textured


def noise(height: int, width: int, channels: int = 3) -> np.ndarray:
    shape = (height, width, channels)
    return np.random.default_rng(height).integers(0, 256, shape, dtype=np.uint8)


def test_srgb_and_linear_light_are_inverse() -> None:
    values = np.linspace(0, 1, 1001)
    assert np.abs(linear_to_srgb(srgb_to_linear(values)) - values).max() < 1e-6
    assert np.array_equal(np.rint(linear_to_srgb(LINEAR) * 255), np.arange(256))


@pytest.mark.parametrize(("height", "width"), [(8, 8), (1, 5), (7, 12), (9, 3)])
def test_each_level_keeps_the_light_of_the_one_before(height: int, width: int) -> None:
    levels = mip_levels(noise(height, width, 4))
    assert levels[-1].shape == (1, 1, 4)
    for before, level in pairwise(levels):
        assert level.shape[:2] == tuple(max(1, side // 2) for side in before.shape[:2])
        # Rounding to bytes changes a texel by at most half an sRGB level, 0.0045 in linear light.
        assert np.abs(decode_texels(before).mean((0, 1)) - decode_texels(level).mean((0, 1))).max() < 0.0045


def test_texels_are_read_at_their_centres_and_blended_between_in_linear_light() -> None:
    image = noise(4, 3)
    centre = np.array([[1.5 / 3, 2.5 / 4]])
    between = np.array([[1.0 / 3, 2.5 / 4]])
    for kind in ("linear", "nearest"):
        assert np.array_equal(sample([image], centre, Sampler(filter=kind))[0, :3], LINEAR[image[2, 1]])
    blend = sample([image], between, Sampler())[0, :3]
    assert np.allclose(blend, (LINEAR[image[2, 0]] + LINEAR[image[2, 1]]) / 2, atol=1e-6)


@pytest.mark.parametrize(
    ("wrap", "expected"), [("repeat", [3, 0, 3]), ("clamp", [0, 3, 0]), ("mirror", [0, 3, 0])]
)
def test_wrap_modes_continue_the_texture(wrap: str, expected: list[int]) -> None:
    image = noise(1, 4)
    uvs = np.array([[-0.1, 0.5], [1.1, 0.5], [-1.1 if wrap == "repeat" else -0.2, 0.5]])
    colors = sample([image], uvs, Sampler(filter="nearest", wrap_u=wrap, wrap_v=wrap))
    assert np.array_equal(colors[:2, :3], LINEAR[image[0, expected[:2]]])


def test_levels_are_blended_by_the_fraction() -> None:
    levels = mip_levels(noise(8, 8))
    uv = np.full((4, 2), 0.3)
    at = sample(levels, uv, Sampler(), np.array([-3, 1, 1.25, 99], np.float32))
    whole = [sample([level], uv[:1], Sampler())[0] for level in levels]
    assert np.allclose(at, [whole[0], whole[1], 0.75 * whole[1] + 0.25 * whole[2], whole[-1]], atol=1e-6)
    assert np.array_equal(
        sample(levels, uv, Sampler(filter="nearest"), np.full(4, 1.4, np.float32))[0],
        sample([levels[1]], uv, Sampler(filter="nearest"))[0],
    )


def test_textures_are_sampled_at_corners() -> None:
    asset = textured()
    colors = colors_of(asset)
    assert colors is not None
    assert colors.domain == "corner"
    bottom_left = sample([asset.buffers["texture.0"]], np.array([[0.0, 1.0]]), Sampler())[0, :3]
    assert np.allclose(colors.values[0], linear_to_srgb(bottom_left))


def test_textures_survive_the_conversion_to_a_mesh() -> None:
    asset = textured()
    again = asset_from_mesh(mesh_from_asset(asset))
    assert again.manifest == asset.manifest
    assert all(np.array_equal(again.buffers[name], array) for name, array in asset.buffers.items())


def test_vertex_colours_and_uvs_survive_the_conversion() -> None:
    square = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
    mesh = Mesh(
        square,
        np.array([[0, 1, 2], [2, 1, 3]]),
        vertex_colors=noise(4, 1).reshape(4, 3),
        vertex_uvs=square[:, :2].copy(),
        textures=(noise(2, 2),),
    )
    again = mesh_from_asset(asset_from_mesh(mesh))
    assert np.array_equal(again.vertex_uvs, mesh.vertex_uvs)
    assert np.array_equal(again.vertex_colors, mesh.vertex_colors)
    tinted = colors_of(asset_from_mesh(mesh)).values
    plain = colors_of(
        asset_from_mesh(Mesh(square, mesh.faces, vertex_uvs=mesh.vertex_uvs, textures=mesh.textures))
    )
    corner = mesh.faces.reshape(-1)
    expected = srgb_to_linear(plain.values) * LINEAR[mesh.vertex_colors[corner]]
    assert np.allclose(srgb_to_linear(tinted), expected, atol=1e-5)

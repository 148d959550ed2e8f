"""Engines draw the textures of an asset as our standard tier does."""

from __future__ import annotations

import numpy as np
import pytest

from msb.asset import Asset
from msb.asset.texture import Sampler
from msb.engines.agreement import agreement
from tests.engines.test_engines import OFF_CENTRE, TALL, frames
from tests.render.standard_scenes import scene
from tests.render.textured_scenes import textured_asset

pytestmark = [pytest.mark.slow, pytest.mark.oracle]


def smooth(mesh: str, **more: object) -> Asset:
    """Return a mesh whose textures change slowly from texel to texel: corners may be moved by the engine."""
    asset = textured_asset(scene(mesh, 3), 3, sizes=((64, 64, 4), (32, 64, 4)), spread=0.3, **more)
    for name in ("texture.0", "texture.1"):
        height, width, _ = asset.buffers[name].shape
        y, x = np.mgrid[0:height, 0:width] * 2 * np.pi / np.array([height, width])[:, None, None]
        waves = [np.sin(x), np.cos(y), np.sin(x + y), np.cos(x) * np.cos(y)]
        asset.buffers[name].flags.writeable = True
        asset.buffers[name][:] = np.rint(np.stack(waves, axis=-1) * 60 + 128).astype(np.uint8)
    return asset


@pytest.mark.parametrize("name", ["threejs", "blender_cycles", "blender_workbench"])
def test_textures_and_colours_are_multiplied_in_linear_light(name: str) -> None:
    tint = None if name == "blender_workbench" else "vertex"
    sampler = Sampler(mipmaps=name == "threejs")  # Blender reads no smaller copies
    found = agreement(*frames(name, smooth("large", sampler=sampler, tint=tint), [OFF_CENTRE, TALL]))
    assert found.interior > 10_000
    assert found.interior_p999 <= 4
    assert found.covered_alike > 0.99


@pytest.mark.parametrize("name", ["threejs", "blender_cycles"])
def test_what_is_cut_out_is_not_there(name: str) -> None:
    asset = smooth("large", sampler=Sampler(mipmaps=False, alpha_cutoff=0.65))
    theirs, ours = frames(name, asset, [OFF_CENTRE])
    whole = frames(name, smooth("large", sampler=Sampler(mipmaps=False)), [OFF_CENTRE])[1]
    assert ours[0].alpha.mean() < 0.97 * whole[0].alpha.mean()
    assert agreement(theirs, ours).covered_alike > 0.98
    both = (theirs[0].depth > 0) & (ours[0].depth > 0)
    assert np.median(np.abs(theirs[0].depth - ours[0].depth)[both] / ours[0].depth[both]) < 3e-3

"""The add-on for Godot 4 (integrations/godot): a model drawn by Godot itself, and malformed files."""

import struct
from pathlib import Path

import numpy as np
import pytest

import msb
from msb import metrics
from tests.reference.golden import exported, golden_views

in_godot4 = pytest.importorskip("benchmarks.opened_in.in_godot4", reason="benchmarks was removed")

# Blending in bytes gives 58 to 61 dB on these views.
LEAST = 50.0


def test_a_pack_lists_its_files_with_their_places() -> None:
    pack = in_godot4.make_pack({"a.gd": b"12345", "b/c.tscn": b"x" * 40})
    assert struct.unpack_from("<4s5I", pack) == (b"GDPC", 3, 4, 0, 0, 2)
    data, at = struct.unpack_from("<QQ", pack, 24)
    assert struct.unpack_from("<I", pack, at) == (2,)
    at += 4
    for content in (b"12345", b"x" * 40):
        (length,) = struct.unpack_from("<I", pack, at)
        offset, size = struct.unpack_from("<QQ", pack, at + 4 + length)
        assert pack[data + offset : data + offset + size] == content
        at += 4 + length + 16 + 16 + 4
    assert at == len(pack)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["sphere_sh3_black", "torus_sh0_white"])
def test_godot_draws_the_dedicated_tier(scene: str, tmp_path: Path) -> None:
    if reason := in_godot4.missing():
        pytest.skip(reason)
    # Godot's cameras have square pixels.
    views = [view for view in golden_views("triangle_splatting") if view.folder.name == scene]
    views = [view for view in views if view.camera.fx == pytest.approx(view.camera.fy)]
    asset = exported(views[0].folder / "checkpoint")
    msb.save(asset, tmp_path / "model.triasset")
    godot = in_godot4.Godot4((tmp_path / "model.triasset").read_bytes())
    try:
        for view in views:
            ours = msb.render(asset, view.camera, tier="dedicated", background=view.background).image
            image = godot.draw(view.camera, view.background) / 255.0
            assert metrics.psnr(image, np.clip(ours, 0, 1)) > LEAST, view.name
    finally:
        godot.close()


@pytest.mark.slow
def test_godot_rejects_other_files(tmp_path: Path) -> None:
    if reason := in_godot4.missing():
        pytest.skip(reason)
    soup = exported(golden_views("two_dts")[0].folder / "checkpoint")
    msb.save(soup, tmp_path / "model.triasset")
    for content in ((tmp_path / "model.triasset").read_bytes(), b"no zip"):
        godot = in_godot4.Godot4(content)
        assert godot.about["opened"] is False
        godot.close()

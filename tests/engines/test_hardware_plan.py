"""The plan of a frame for graphics hardware. Plans are plain data, so these tests need no adapter."""

import json

import numpy as np
import pytest

from msb.engines.hardware.device import split_into_bands
from msb.engines.hardware.packing import pack
from msb.engines.hardware.plan import Limits
from msb.engines.hardware.program import make_plan
from msb.engines.hardware.wgsl import assemble, find_face_members
from tests.reference.golden import exported, golden_views

METHODS = ("two_dts", "triangle_splatting", "mesh_splatting", "diffsoup")


@pytest.mark.parametrize("method", METHODS)
def test_a_plan_is_plain_data(method: str) -> None:
    view = golden_views(method)[0]
    packed = pack(exported(view.folder / "checkpoint"), view.settings)
    plan = make_plan(packed, Limits(1 << 27, 1 << 31, 8192), "none", depth=method == "diffsoup")
    record = json.loads(json.dumps(plan.record()))
    if method == "diffsoup":  # drawn with a z-buffer
        assert record["format"] == "r32uint"
        assert [step["stage"] for step in record["band_passes"]] == ["raster", "decode"]
    else:
        assert record["blend"] == [["one-minus-dst-alpha", "one"]] * 2
    bound = {binding["name"] for step in record["passes"] for binding in step["bindings"]}
    assert bound | set(plan.data) <= set(record["buffers"])
    for text in record["modules"].values():
        assert "#if" not in text
        assert "OWN_MEMBERS" not in text
    assert sum(size for size, _ in plan.buffers.values()) < 1200 * packed.faces
    assert len(packed.view_bytes(view.camera, (0, 0, 0))) % 16 == 0


def test_conditions_and_includes_are_resolved() -> None:
    package, files = "msb.methods.two_dts", ["two_dts.wgsl"]
    assert find_face_members(assemble(files, package, {})) == ["quad", "x", "y", "z", "color"]
    assert "dual2" in find_face_members(assemble(files, package, {"PLANAR": True}))
    assert find_face_members(assemble(files, package, {"PLANAR": True, "ENGINE": True}))[1] == "along_x"
    text = assemble(files, package, {"SCALE": 4, "OWN_MEMBERS": "    power: f32,"})
    assert "const SCALE = 4u;" in text
    assert "    power: f32,\n}" in text
    assert text.count("struct View") == 1


@pytest.mark.parametrize(
    ("width", "height", "scale", "side", "room"),
    [(220, 166, 1, 100, 1 << 20), (30, 50, 4, 64, 100), (1, 1, 4, 8192, 1)],
)
def test_bands_cover_the_frame_once(width: int, height: int, scale: int, side: int, room: int) -> None:
    count = np.zeros((height, width), int)
    bands = split_into_bands(width, height, scale, side, room)
    for band in bands:
        count[band.y : band.y + band.height, band.x : band.x + band.width] += 1
        assert scale * max(band.width, band.height) <= side
        assert band.width * band.height <= room
        assert band.offset % 256 == 0
    assert (count == 1).all()
    ends = [band.offset + 20 * band.width * band.height for band in bands]
    assert all(end <= band.offset for end, band in zip(ends, bands[1:], strict=False))

"""Devices that only allow small work-groups: clear errors for kernels that need larger ones."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from msb.asset import Asset
from msb.cl import Device
from msb.errors import DeviceError
from msb.render import Frame
from msb.render.dedicated import dedicated_renderer
from msb.render.standard.renderer import StandardRenderer
from tests.cl.conftest import open_styled
from tests.reference.soups import SPLATTING, front_camera, random_triangles, soup
from tests.render.frames import frame_of


@pytest.fixture(params=[64, 128])
def limited(request: pytest.FixtureRequest) -> Iterator[Device]:
    with open_styled("gpu") as device:
        device.record = device._queue.record = replace(device.record, max_work_group=request.param)
        yield device


def model(method: str) -> Asset:
    return soup(method, random_triangles(1, 200, 0.5), degree=0)


def draw(tier: type, method: str, device: Device) -> Frame:
    return frame_of(tier, model(method), device, front_camera(90, 60), (0.0, 0.5, 1.0))


@pytest.mark.slow
@pytest.mark.parametrize("method", SPLATTING)
def test_blending_is_rejected_if_a_group_cannot_be_a_tile(method: str, limited: Device) -> None:
    allowed = limited.record.max_work_group
    with pytest.raises(DeviceError) as caught:
        draw(dedicated_renderer, method, limited)
    assert (caught.value.code, caught.value.exit_status) == ("DEVICE_COMMAND", 5)
    assert f"allows {allowed};" in caught.value.message


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tier", "method"), [(dedicated_renderer, "diffsoup"), (StandardRenderer, "two_dts")]
)
def test_z_buffers_draw_with_small_groups(tier: type, method: str, limited: Device, gpu: Device) -> None:
    frame, expected = draw(tier, method, limited), draw(tier, method, gpu)
    assert (expected.face_id >= 0).sum() > 500
    for name in ("image", "depth", "face_id"):
        np.testing.assert_array_equal(getattr(frame, name), getattr(expected, name))

"""Renderers share one device: threads take turns, memory is a renderer's own, and nothing stays behind."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

import msb
from msb.asset import Asset
from msb.cl import shared_device
from msb.errors import DeviceError
from tests.cl.conftest import SELECTOR
from tests.reference.soups import front_camera, random_triangles, soup

THREADS, FRAMES = 8, 48
SMALL, LARGE = front_camera(40, 30), front_camera(160, 120)
TIERS = ("standard", "dedicated")


@pytest.fixture(scope="module")
def asset() -> Asset:
    return soup("two_dts", random_triangles(1, 400, 0.5), degree=1)


def picture(renderer: msb.Renderer, number: int) -> bytes:
    camera = (SMALL, LARGE)[number % 2]
    return renderer.render(camera, background=(1, 1, 1)).image.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("tier", TIERS)
def test_eight_threads_may_draw_with_one_renderer(asset: Asset, tier: Any) -> None:
    with msb.Renderer(asset, tier=tier, device=SELECTOR) as renderer:
        wanted = [picture(renderer, number) for number in range(2)]
        with ThreadPoolExecutor(THREADS) as pool:
            found = list(pool.map(lambda number: picture(renderer, number), range(FRAMES)))
    assert found == wanted * (FRAMES // 2)


@pytest.mark.parametrize("tier", TIERS)
def test_memory_is_a_renderers_own(asset: Asset, tier: Any) -> None:
    """What another one has drawn on the device, and draws, is no part of it."""

    def memory_after_small(renderer: msb.Renderer) -> dict[str, int]:
        picture(renderer, 0)
        return dict(renderer.memory())

    with msb.Renderer(asset, tier=tier, device=SELECTOR) as alone:
        wanted = memory_after_small(alone)
    with msb.Renderer(asset, tier=tier, device=SELECTOR) as large:
        picture(large, 1)
        with msb.Renderer(asset, tier=tier, device=SELECTOR) as small:
            assert memory_after_small(small) == wanted
            picture(large, 1)
            assert dict(small.memory()) == wanted


@pytest.mark.slow
@pytest.mark.parametrize("tier", TIERS)
def test_renderers_leave_nothing_on_the_device(asset: Asset, tier: Any) -> None:
    """Neither buffers nor programs, of which PoCL keeps a megabyte each for every context."""
    device = shared_device(SELECTOR)
    msb.render(asset, SMALL, tier=tier, device=SELECTOR)
    held, programs = device.memory(), len(device._programs)
    for _ in range(20):
        msb.render(asset, SMALL, tier=tier, device=SELECTOR)
        with msb.Renderer(asset, tier=tier, device=SELECTOR) as renderer:
            picture(renderer, 0)
    assert shared_device(SELECTOR) is device
    assert (device.memory(), len(device._programs)) == (held, programs)


@pytest.mark.parametrize("tier", TIERS)
def test_a_closed_renderer_says_so(asset: Asset, tier: Any) -> None:
    renderer = msb.Renderer(asset, tier=tier, device=SELECTOR)
    renderer.close()
    renderer.close()
    for call in (renderer.render, renderer.draw):
        with pytest.raises(DeviceError, match="the renderer was closed") as error:
            call(SMALL)
        assert error.value.code == "DEVICE_CLOSED"
    assert sum(renderer.memory().values()) == 0

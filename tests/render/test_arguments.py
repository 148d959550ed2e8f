"""Arguments of the public rendering functions: valid and invalid values, on all tiers."""

import re
import warnings
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import Asset
from msb.cl import Device
from msb.errors import InputError, UsageError
from msb.scenes.colors import check_background
from tests.reference.soups import front_camera, random_triangles, soup

TIERS = ("reference", "dedicated", "standard")


@pytest.fixture(scope="module")
def asset() -> Asset:
    return soup("two_dts", random_triangles(1, count=4))


@pytest.fixture(scope="module")
def renderers(asset: Asset, cpu: Device) -> list[msb.Renderer]:
    return [msb.Renderer(asset, tier=tier, device=cpu) for tier in TIERS]


@pytest.mark.parametrize(("stated", "color"), [("#204060", (32, 64, 96)), (None, (255, 255, 255))])
def test_the_default_background_is_the_recorded_one_on_every_tier(
    asset: Asset, stated: str | None, color: tuple[int, int, int], cpu: Device
) -> None:
    # If the asset records none, its method's official background is used: white for 2DTS, black for meshes.
    look = {**asset.manifest.appearance, **({} if stated is None else {"background": stated})}
    variant = replace(asset, manifest=replace(asset.manifest, appearance=look))
    for tier in TIERS:
        with msb.Renderer(variant, tier=tier, device=cpu) as renderer:
            frame = renderer.render(front_camera())
        nothing = frame.image[frame.alpha == 0]
        assert len(nothing)
        assert np.array_equal(nothing[0], np.array(color, np.float32) / np.float32(255))


NO_NUMBERS: list[Any] = [(np.nan, 0, 0), (0, 0, 1e300), (0, None, 0), ("0", "0", "0"), 1j * np.ones(3)]
NO_THREE: list[Any] = [(0, 0), 1.0, [[0, 0, 0]], (0, [0, 1], 0), {0, 1, 2}, np.zeros((3, 1))]
NO_NAMES = ["transparent", "", "0.1,0.2", "0,0,2", "#12345", b"white"]
MASKED = np.ma.masked_equal([0, 0.5, 1], 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("background", [*NO_NUMBERS, *NO_THREE, *NO_NAMES, MASKED], ids=repr)
def test_invalid_backgrounds_are_rejected_on_every_tier(
    background: Any, renderers: list[msb.Renderer]
) -> None:
    for renderer in renderers:
        for draw in (renderer.render, renderer.draw):
            with pytest.raises(UsageError, match=r"^USAGE: background is "):
                draw(front_camera(), background)


@pytest.mark.parametrize(
    ("background", "color"),
    [
        ("white", (1, 1, 1)),
        (" Black ", (0, 0, 0)),
        ("#ff0033", (1, 0, 0.2)),
        ("0.5,0,1", (0.5, 0, 1)),
        ("official", (1, 1, 1)),
        ((-1, 2, 0.25), (-1, 2, 0.25)),
        (np.array([0.25, 0.5, 1], np.float16), (0.25, 0.5, 1)),
        ([0, 1, np.int8(0)], (0, 1, 0)),
    ],
    ids=repr,
)
def test_a_background_is_three_numbers_or_a_name(background: Any, color: Any) -> None:
    assert check_background(background, "white") == pytest.approx(color)


@pytest.mark.slow
@pytest.mark.parametrize("tier", TIERS)
def test_a_path_is_rendered_like_the_asset_exported_from_it(tier: Any, cpu: Device) -> None:
    path = "tests/tiny/models/walled/mesh_splatting"
    with msb.Renderer(path, tier, cpu) as renderer:
        frame = renderer.render(front_camera())
    assert np.array_equal(frame.image, msb.render(msb.export(path), front_camera(), tier, device=cpu).image)
    assert np.array_equal(frame.image, msb.render(path, front_camera(), tier, device=cpu).image)
    with pytest.raises(InputError, match="FILE_NOT_FOUND"):
        msb.render("absent.triasset", front_camera(), tier, device=cpu)


NO_RANGES = [(1e-30, 100.0), (1e-300, 100.0), (0.5, 1e30), (0.5, 1e299), (0.1, 1e8), (2.0, 2.0), (3.0, 2.0)]


@pytest.mark.parametrize("layout", ["colmap", "synthetic"])
@pytest.mark.parametrize(("near", "far"), [*NO_RANGES, (0.01, 1e4), (2e-4, 400.0)])
def test_planes_must_be_a_range_that_float32_can_represent(
    near: float, far: float, layout: str, cpu: Device
) -> None:
    asset = soup("diffsoup", random_triangles(1, count=20))
    settings = {"layout": layout, "z_near": near, "z_far": far}
    for tier in ("reference", "dedicated"):
        if (near, far) in NO_RANGES:
            with pytest.raises(UsageError, match="SETTING_VALUE"):
                msb.render(asset, front_camera(), tier, settings=settings, device=cpu)
        else:
            frame = msb.render(asset, front_camera(), tier, settings=settings, device=cpu)
            assert frame.alpha.any()
            assert np.isfinite(frame.image).all()


@pytest.mark.slow
def test_a_sigma_that_is_zero_in_float32_causes_no_warning(cpu: Device) -> None:
    asset = soup("mesh_splatting", random_triangles(1, count=20), welded=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        images = [
            msb.render(asset, front_camera(), tier, settings={"sigma": 1e-300}, device=cpu).image
            for tier in ("reference", "dedicated")
        ]
    assert np.abs(images[0] - images[1]).max() < 1e-4


def test_a_printed_renderer_names_tier_and_method_also_after_it_is_closed(asset: Asset) -> None:
    renderer = msb.Renderer(asset, tier="reference")
    assert {"reference", "two_dts"} <= set(re.findall(r"\w+", repr(renderer)))
    renderer.close()
    assert "closed" in repr(renderer)

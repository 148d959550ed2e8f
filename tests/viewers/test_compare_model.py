"""The data of a comparison: views, tiers, layouts and differences."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from msb import metrics
from msb.asset import Description, build_asset
from msb.errors import SceneError, Unsupported, UsageError
from msb.scenes.around import make_turntable
from msb_viewers.deployment.arrange import arrange
from msb_viewers.deployment.difference import decibel_text, scale_colors, squared_error
from msb_viewers.deployment.shots import Comparison, TierRenderers, choose_tiers
from msb_viewers.deployment.state import LAYOUTS, CompareState
from msb_viewers.deployment.views import View, dataset_views, read_photograph
from tests.conftest import TETRAHEDRON
from tests.viewers.compare import (
    HEIGHT,
    WIDTH,
    checkpoint_asset,
    comparison,
    photographs,
    small_cameras,
)


def test_the_average_of_the_map_gives_the_psnr() -> None:
    random = np.random.default_rng(0)
    a, b = random.integers(0, 256, (2, 20, 30, 3), np.uint8)
    mean = float(squared_error(a, b).astype(np.float64).mean())
    assert -10 * math.log10(mean) == pytest.approx(metrics.psnr(a, b), abs=1e-4)
    assert decibel_text(metrics.psnr(a, a)) == "identical"


def test_the_scale_is_magma() -> None:
    matplotlib = pytest.importorskip("matplotlib", reason="extra view is not installed")
    wanted = matplotlib.colormaps["magma"](np.arange(256))[:, :3] * 255
    assert np.abs(scale_colors() - wanted).max() < 3.2


def test_views_take_the_size_of_their_photographs(tmp_path: Path) -> None:
    cameras = [camera.resized(2 * WIDTH, 2 * HEIGHT) for camera in small_cameras(3)]
    Image.new("RGB", (WIDTH, HEIGHT), (9, 8, 7)).save(tmp_path / f"{cameras[0].name}.png")
    Image.new("RGB", (WIDTH, HEIGHT)).save(tmp_path / f"{cameras[2].name}.JPG")
    views = dataset_views(cameras, tmp_path)
    assert [view.photograph is not None for view in views] == [True, False, True]
    assert (views[0].camera.width, views[0].camera.fx) == (WIDTH, cameras[0].fx / 2)
    assert views[1].camera.width == 2 * WIDTH
    assert tmp_path.name in views[1].why
    assert dataset_views(cameras, beside=tmp_path)[0].photograph == views[0].photograph
    # A factor is relative to the cameras, with and without photographs, as in `msb render`.
    for view in dataset_views(cameras, tmp_path, 0.25):
        assert (view.camera.width, view.camera.height) == (WIDTH // 2, HEIGHT // 2)
    quarter = dataset_views(cameras, tmp_path, 0.25)[0]
    assert read_photograph(quarter, (0, 0, 0)).shape == (HEIGHT // 2, WIDTH // 2, 3)


def test_transparent_photographs_lie_over_the_background(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.new("RGBA", (WIDTH, HEIGHT), (255, 0, 0, 51)).save(path)
    image = read_photograph(View("a", small_cameras(1)[0], path), (0.0, 1.0, 1.0))
    assert image[0, 0].tolist() == [51, 204, 204]


def test_default_tiers_depend_on_photographs(tmp_path: Path) -> None:
    asset = checkpoint_asset()
    assert choose_tiers(asset, [], None) == (("reference", "dedicated", "standard"), {})
    views = photographs(tmp_path, [(0, 0, 0)])
    assert choose_tiers(asset, views, None)[0][0] == "truth"
    assert choose_tiers(asset, views, ["standard, truth"])[0] == ("truth", "standard")
    for wanted in (["truth"], ["fast"], [""], [","], ["standard,"]):
        with pytest.raises(UsageError, match="NAME_UNKNOWN"):
            choose_tiers(asset, [], wanted)


def test_an_unsupported_tier_has_a_reason() -> None:
    buffers = {"positions": TETRAHEDRON[0], "indices": TETRAHEDRON[1].astype(np.uint32)}
    asset = build_asset(buffers, {}, Description(method="mesh"))
    tiers, missing = choose_tiers(asset, [], None)
    assert tiers == ("reference", "dedicated", "standard")
    assert set(missing) == {"reference", "dedicated"}
    with pytest.raises(Unsupported):
        choose_tiers(asset, [], ["dedicated"])


def test_a_baked_mesh_is_drawn_on_the_standard_tier() -> None:
    points, faces = TETRAHEDRON[0], TETRAHEDRON[1].astype(np.uint32)
    plain, baked = (
        build_asset(
            {"positions": points, "indices": faces, "color": np.full((4, 3), value, np.float32)},
            {"color": "vertex"},
            Description(method="mesh", appearance={"kind": "static_color"}),
        )
        for value in (0.2, 0.6)
    )
    tiers, missing = choose_tiers(plain, [], ["standard,baked"], baked=baked)
    assert (tiers, missing) == (("standard", "baked"), {})
    with pytest.raises(UsageError, match="NAME_UNKNOWN"):
        choose_tiers(plain, [], ["baked"])
    view = View("around", make_turntable(plain, 1, 40, 30)[0])
    scene = Comparison("plain", plain, tiers, missing, (view,), background=(0.0, 0.0, 0.0), baked=baked)
    assert CompareState.first(scene).pair == ("standard", "baked")
    with TierRenderers(scene) as renderers:
        shots = [renderers.shoot(tier, view).image for tier in tiers]
    assert [int(shot.max()) for shot in shots] == [51, 153]


def test_a_slow_reference_tier_needs_a_request(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("msb_viewers.deployment.shots.MOST_REFERENCE_FACES", 10)
    asset = checkpoint_asset()
    assert "reference" not in choose_tiers(asset, [], None)[0]
    assert "reference" in choose_tiers(asset, [], ["reference"])[0]


def test_the_default_pair_is_truth_and_the_last_tier(tmp_path: Path) -> None:
    assert CompareState.first(comparison()).pair == ("dedicated", "standard")
    views = photographs(tmp_path, [(1, 1, 1)])
    scene = comparison(views, ("truth", "reference", "dedicated", "standard"))
    assert CompareState.first(scene).pair == ("truth", "standard")
    assert CompareState.first(scene, pair="standard, reference").pair == ("standard", "reference")
    for pair in ("standard", "standard,standard", "standard,fast", "a,b,c"):
        with pytest.raises(UsageError, match="NAME_UNKNOWN"):
            CompareState.first(scene, pair=pair)
    with pytest.raises(UsageError, match="NAME_UNKNOWN"):
        CompareState.first(comparison(tiers=("standard",)), layout="difference")


@pytest.mark.parametrize("size", [(1280, 800), (390, 844), (2560, 1440)])
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("count", [1, 3, 4])
def test_nothing_overlaps_and_all_is_inside(size: tuple[int, int], layout: Any, count: int) -> None:
    tiers = ("truth", "reference", "dedicated", "standard")[:count]
    pair = (tiers[0], tiers[-1])
    cells = arrange(layout, tiers, pair, size, 0.62, aspect=4 / 3)
    if layout != "side" and count == 1:
        return
    assert len({cell.kind for cell in cells}) == len(cells)
    for number, cell in enumerate(cells):
        assert cell.box.left >= 0
        assert cell.box.right <= size[0]
        assert cell.caption.bottom <= size[1]
        for other in cells[number + 1 :]:
            apart = cell.box.right <= other.box.left or other.box.right <= cell.box.left
            assert apart or cell.caption.bottom <= other.box.top or other.caption.bottom <= cell.box.top


def test_bad_photographs_are_rejected(tmp_path: Path) -> None:
    camera = small_cameras(1)[0]
    with pytest.raises(UsageError, match="USAGE"):
        dataset_views([camera], tmp_path / "none")
    with pytest.raises(UsageError, match="USAGE"):
        dataset_views([camera], tmp_path)
    (tmp_path / f"{camera.name}.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(SceneError, match="CAMERA_IMAGE"):
        dataset_views([camera], tmp_path)

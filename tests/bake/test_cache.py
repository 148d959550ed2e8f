"""Pictures of a former bake are taken if they are of the same model, camera and background, and whole."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import msb
from msb.asset import build_asset
from msb.bake.cache import SUFFIX
from msb.bake.teacher import Teacher
from msb.bake.views import BakeViews, bake_views
from tests.bake.test_teacher import mesh_asset
from tests.bake.test_views import ring


@pytest.fixture
def views() -> BakeViews:
    return replace(bake_views(mesh_asset(), cameras=ring(3)), between=())


def taught(folder: Path, views: BakeViews, asset: msb.Asset | None = None) -> tuple[np.ndarray, list[str]]:
    with Teacher(asset or mesh_asset(), views, cache=folder) as teacher, teacher.looks(views.taught) as looks:
        images = np.stack([looks.stored(number) for number in range(len(looks))])
        assert teacher.pictures is not None
        return images, teacher.pictures.notes()


def test_a_second_bake_draws_nothing(
    views: BakeViews, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, notes = taught(tmp_path / "cache", views)
    assert notes == []
    monkeypatch.setattr(Teacher, "_look", None)
    again, notes = taught(tmp_path / "cache", views)
    np.testing.assert_array_equal(again, first)
    assert "2 of 2" in notes[0]


def test_what_is_seen_otherwise_is_drawn(views: BakeViews, tmp_path: Path) -> None:
    taught(tmp_path, views)
    asset = mesh_asset()
    colors = {**asset.buffers, "color": asset.buffers["color"][::-1].copy()}
    larger = {**asset.buffers, "positions": 2 * asset.buffers["positions"]}
    moved = tuple(camera.scaled(2) for camera in views.taught)
    for other, shown in (
        (views, replace(asset, buffers=colors)),  # whose manifest has the hashes of what it was
        (
            views,
            build_asset(larger, {"color": "vertex"}),
        ),
        (replace(views, background=(0.0, 0.5, 1.0)), asset),
        (replace(views, teaching=moved, aside=()), asset),
    ):
        _, notes = taught(tmp_path, other, shown)
        assert notes == []


@pytest.mark.parametrize("damage", ["cut", "longer", "another", "empty"])
def test_a_damaged_picture_is_drawn_again(views: BakeViews, tmp_path: Path, damage: str) -> None:
    first, _ = taught(tmp_path, views)
    place, _ = sorted(tmp_path.glob(f"*{SUFFIX}"))
    data = place.read_bytes()
    broken = {"cut": data[:-1], "longer": data + b"1", "another": data[:-1] + b"\xfe", "empty": b""}
    place.write_bytes(broken[damage])
    again, notes = taught(tmp_path, views)
    np.testing.assert_array_equal(again, first)
    assert "1 of 2" in notes[0]
    assert place.read_bytes() == data

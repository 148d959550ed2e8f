"""Order and split of the 3DGS family."""

from __future__ import annotations

import numpy as np

from msb.scenes import Camera, sorted_by_stem, split_every_8th, stem


def named(*names: str | None) -> list[Camera]:
    return [Camera(1, 1, 1, 1, 0, 0, np.eye(4), name) for name in names]


def test_the_stem_ends_at_the_first_dot_and_has_no_folder() -> None:
    cameras = named("a.b/img.c.png", "plain", None, ".hidden.png")
    assert [stem(camera) for camera in cameras] == ["img", "plain", "", ""]


def test_the_order_is_by_code_point_and_stable() -> None:
    cameras = named("z/DSC_2.png", "img.b.png", "b.png", "img.a.png", "DSC_10.png", "a/DSC_02.png", "Z.png")
    assert [camera.name for camera in sorted_by_stem(cameras)] == [
        "a/DSC_02.png", "DSC_10.png", "z/DSC_2.png", "Z.png", "b.png", "img.b.png", "img.a.png"
    ]  # fmt: skip


def test_every_eighth_is_for_testing() -> None:
    cameras = named(*(f"{index:02d}.png" for index in reversed(range(18))))
    train, test = split_every_8th(cameras)
    assert [camera.name for camera in test] == ["00.png", "08.png", "16.png"]
    assert {camera.split for camera in test} == {"test"}
    assert {camera.split for camera in train} == {"train"}
    assert len(train) == 15
    assert split_every_8th([]) == ([], [])
    assert split_every_8th(test)[1][0].name == "00.png"

"""What a training did otherwise than a scene is evaluated: its split, its background, its size."""

from __future__ import annotations

from typing import Any

import pytest

from msb.scenes.datasets import read_scene, trained_otherwise

from .conftest import STUBS

CAPTURE = STUBS / "mipnerf360/pebble"
"""Photographs of 64 x 48 in images_4, 128 x 96 in images_2, 256 x 192 in images; the first count."""
ALIKE: list[dict[str, Any]] = [
    {},
    {"eval": True, "images": "images_4", "resolution": -1},
    {"images": "images_2", "resolution": 2},
    {"images": "images", "resolution": 4},
    {"images": "images", "resolution": 64},
    {"width": 64, "height": 48},
    {"images": "somewhere", "resolution": 1},  # which size that folder has is not known
    {"images": "..", "resolution": 1},
]


@pytest.mark.parametrize("training", ALIKE, ids=str)
def test_a_training_as_the_scene_is_evaluated_gives_no_warning(training: dict[str, Any]) -> None:
    scene = read_scene(CAPTURE)
    for own in (None, (0.0, 0.0, 0.0)):
        assert list(trained_otherwise(training, own, scene)) == []


@pytest.mark.parametrize(
    ("training", "size"),
    [
        ({"images": "images_2", "resolution": -1}, "128 x 96"),
        ({"images": "images"}, "256 x 192"),
        ({"images": "images_4", "resolution": 2}, "32 x 24"),
        ({"images": "images_8", "resolution": 1}, "32 x 24"),  # which is not there any more
        ({"images": "images", "resolution": 100}, "100 x 75"),
        ({"width": 640, "height": 480}, "640 x 480"),
    ],
    ids=str,
)
def test_another_size_is_said_with_both(training: dict[str, Any], size: str) -> None:
    (found,) = trained_otherwise(training, None, read_scene(CAPTURE))
    assert f"{size} pixels" in found.message
    assert "64 x 48" in found.message


def test_the_split_and_the_background_are_said_with_what_follows() -> None:
    first, second = trained_otherwise({"eval": False}, (1.0, 1.0, 1.0), read_scene(CAPTURE))
    assert "eval=False" in first.message
    assert "over white" in second.message

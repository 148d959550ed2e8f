"""Tables of datasets and loaders, and the evaluated sizes."""

import json
from typing import Any

import pytest

from msb.registry import METHODS
from msb.scenes.colors import BLACK, WHITE
from msb.scenes.datasets import DATASETS, RULES, evaluation_background
from msb.scenes.datasets.catalog import is_published, name_datasets
from msb.scenes.datasets.rules import floor, half_even, half_up
from tests.conftest import ROOT

SIZES: list[dict[str, Any]] = json.loads((ROOT / "tests/golden/metrics/resolution_rules.json").read_text())[
    "cases"
]


@pytest.mark.parametrize(
    ("loader", "rule"), [("gs_family", half_even), ("two_dts", floor), ("nerfbaselines", half_up)]
)
def test_sizes_are_those_of_the_loaders(loader: str, rule: Any) -> None:
    cases = [case for case in SIZES if loader in case]
    assert len(cases) > 50
    for case in cases:
        assert list(rule((case["width"], case["height"]), case["r"])) == case[loader], case


def test_datasets_have_the_scenes_of_the_benchmark() -> None:
    counts = {key: len(dataset.scenes) for key, dataset in DATASETS.items()}
    assert counts == {"mipnerf360": 9, "tanksandtemples": 2, "nerf_synthetic": 8, "dtu": 15}
    groups = list(DATASETS["mipnerf360"].scenes.values())
    assert (groups.count("outdoor"), groups.count("indoor")) == (5, 4)


@pytest.mark.parametrize(
    ("layout", "name", "above", "dataset"),
    [
        ("colmap", "garden", "data", "mipnerf360"),
        ("colmap", "anything", "360_v2", "mipnerf360"),
        ("colmap", "truck", "tandt", "tanksandtemples"),
        ("blender", "lego", "data", "nerf_synthetic"),
        ("colmap", "lego", "data", "custom"),
        ("neus", "scan24", "data", "dtu"),
        ("colmap", "scan1", "DTU", "dtu"),
    ],
)
def test_names_suggest_a_dataset(layout: Any, name: str, above: str, dataset: str) -> None:
    assert next(iter(name_datasets(layout, name, above)), ("custom", False))[0] == dataset


@pytest.mark.parametrize(
    ("key", "scene", "photograph", "size", "below", "published"),
    [
        ("mipnerf360", "garden", "DSC07956.JPG", (5187, 3361), False, True),
        ("mipnerf360", "garden", "DSC07956.JPG", (5186, 3361), False, True),
        ("mipnerf360", "garden", "DSC07956.JPG", (1297, 840), False, False),
        ("mipnerf360", "garden", "DSC07956.JPG", (1297, 840), True, True),
        ("mipnerf360", "garden", "IMG_0001.JPG", (5187, 3361), True, False),
        ("nerf_synthetic", "chair", "test/r_0.png", (400, 400), False, True),
        ("nerf_synthetic", "chair", "test/r_0.png", (640, 480), False, False),
        ("dtu", "teapot", "0000.png", (1600, 1200), True, False),
        ("dtu", "scan1", "0000.png", (72, 54), True, True),
    ],
)
def test_photographs_confirm_a_dataset(
    key: str, scene: str, photograph: str, size: Any, below: bool, published: bool
) -> None:
    assert is_published(key, scene, [photograph], [size], below=below) is published


def test_rules_are_named_like_methods_and_cover_their_datasets() -> None:
    assert set(RULES) <= set(METHODS) | {"ours"}
    ours = RULES["ours"]
    for key, dataset in DATASETS.items():
        for group in dataset.scenes.values():
            assert ours.photographs_of(key, group) is not None
    assert ours.photographs_of("my capture") == ours.photographs_of("custom")
    indoor = {name: rules.photographs_of("mipnerf360", "indoor") for name, rules in RULES.items()}
    folders = {name: (rule.folder, rule.resolution) for name, rule in indoor.items() if rule is not None}
    assert folders == {
        "ours": ("images_2", -1),
        "two_dts": ("images", 2),
        "diffsoup": ("images_4", -1),
        **dict.fromkeys(("milo", "gaussian_wrapping"), ("images", -1)),
        **dict.fromkeys(("sugar", "frosting"), ("images", 1920)),
        **dict.fromkeys(
            ("triangle_splatting", "mesh_splatting", "triangle_splatting_plus", "two_dgs", "three_dgs"),
            ("images_2", -1),
        ),
    }
    assert RULES["two_dts"].photographs_of("dtu") is None


def test_background_is_the_datasets_or_else_the_methods() -> None:
    for masked in ("nerf_synthetic", "dtu"):
        assert {evaluation_background(masked, name) for name in RULES} == {WHITE}
    assert evaluation_background("mipnerf360", "two_dts") == WHITE
    assert evaluation_background("tanksandtemples", "two_dts") == BLACK
    assert evaluation_background("mipnerf360", "mesh_splatting") == BLACK
    assert evaluation_background("office") == BLACK
    assert evaluation_background("office", "mesh_splatting", WHITE) == WHITE
    assert evaluation_background("dtu", "mesh_splatting", BLACK) == WHITE
    assert {evaluation_background("mipnerf360", name) for name in ("two_dgs", "mesh")} == {BLACK}

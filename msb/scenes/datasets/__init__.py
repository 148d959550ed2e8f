"""Datasets: scenes in their official layouts, split, sized and composited by one set of rules.

This package reads only headers of photographs; `msb.metrics.ground_truth` decodes them. docs/datasets.md
describes layouts and rules.
"""

from msb.scenes.datasets.catalog import DATASETS
from msb.scenes.datasets.describe import SceneReport, color_name, describe_scene
from msb.scenes.datasets.layout import find_scenes
from msb.scenes.datasets.neus import read_matrices
from msb.scenes.datasets.notes import (
    over_another,
    photographs_beside,
    recorded_note,
    scaled_note,
    trained_otherwise,
)
from msb.scenes.datasets.read import SceneAt, dataset_of, read_scene, scene_at, scene_of
from msb.scenes.datasets.rulebook import (
    RULES,
    evaluation_background,
    own_background,
    stated_background,
)
from msb.scenes.datasets.rules import Photographs, Rules
from msb.scenes.datasets.scene import Scene

__all__ = [
    "DATASETS",
    "RULES",
    "Photographs",
    "Rules",
    "Scene",
    "SceneAt",
    "SceneReport",
    "color_name",
    "dataset_of",
    "describe_scene",
    "evaluation_background",
    "find_scenes",
    "over_another",
    "own_background",
    "photographs_beside",
    "read_matrices",
    "read_scene",
    "recorded_note",
    "scaled_note",
    "scene_at",
    "scene_of",
    "stated_background",
    "trained_otherwise",
]

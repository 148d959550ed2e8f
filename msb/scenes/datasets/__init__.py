"""Datasets: scenes in their official layouts, and one set of rules for their splits, sizes and backgrounds.

This package reads only the headers of photographs. The pixels are decoded by `msb.metrics.ground_truth`.
Layouts and rules are described in docs/datasets.md.
"""

from msb.scenes.datasets.catalog import DATASETS
from msb.scenes.datasets.describe import SceneReport, color_name, describe_scene
from msb.scenes.datasets.layout import find_scenes
from msb.scenes.datasets.neus import read_matrices
from msb.scenes.datasets.notes import (
    compare_training,
    find_photographs,
    note_recorded_size,
    note_scaled_cameras,
    warn_background,
    warn_unknown_split,
)
from msb.scenes.datasets.read import SceneAt, dataset_of, read_scene, scene_at, scene_of
from msb.scenes.datasets.rulebook import (
    RULES,
    default_background,
    evaluation_background,
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
    "compare_training",
    "dataset_of",
    "default_background",
    "describe_scene",
    "evaluation_background",
    "find_photographs",
    "find_scenes",
    "note_recorded_size",
    "note_scaled_cameras",
    "read_matrices",
    "read_scene",
    "scene_at",
    "scene_of",
    "stated_background",
    "warn_background",
    "warn_unknown_split",
]

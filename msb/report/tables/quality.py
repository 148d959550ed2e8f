"""Tables of image quality: with the research renderers, and with tiers and engines."""

from __future__ import annotations

from msb.report.layout import Line, make_table, metric_columns
from msb.report.metric_format import title
from msb.report.numbers import (
    MEAN,
    QUALITY,
    Numbers,
    condition_title,
    dataset_title,
    method_title,
    scene_title,
)
from msb.report.safe_names import slug
from msb.report.table import Column, Table
from msb.report.tables.scenes import scene_lines

_NATIVE = ("fps", "train_memory", "train_seconds", "chamfer")
"""The metrics of a method's own images, besides those of `QUALITY`."""


def native_lines(numbers: Numbers) -> list[Line]:
    """Return a line per dataset and method with images of the method's own renderer."""
    return [
        Line((dataset_title(dataset), method_title(method)), {"dataset": dataset, "method": method})
        for dataset in numbers.datasets()
        for method in numbers.methods(dataset, "non_engine")
    ]


def deployment_lines(numbers: Numbers, dataset: str) -> list[Line]:
    """Return a line per deployed condition and method of a dataset."""
    conditions = [condition for condition in numbers.conditions(dataset) if condition != "non_engine"]
    return [
        Line((condition_title(condition), method_title(method)), {"condition": condition, "method": method})
        for condition in conditions
        for method in numbers.methods(dataset, *conditions)
    ]


def native_summary(numbers: Numbers, paper: Numbers | None = None) -> Table:
    """Return what the methods reach with their own renderers; the best method of a dataset is bold."""
    return make_table(
        numbers,
        paper,
        "native_summary",
        "Non-Engine results: each method with its own renderer, means over the scenes of a dataset.",
        ("Dataset", "Method"),
        metric_columns((*QUALITY, *_NATIVE)),
        native_lines(numbers),
        {"scene": MEAN, "condition": "non_engine"},
        best_of=("dataset",),
    )


def renderer_comparison(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return a row per condition and metric, a column per method; each method's best condition is bold."""
    conditions = numbers.conditions(dataset)
    return make_table(
        numbers,
        paper,
        f"renderer_comparison-{slug(dataset)}",
        f"{dataset_title(dataset)}: the same models in their own renderer and deployed, means over "
        "scenes. Bold: a method's best condition.",
        ("Condition", "Metric"),
        [
            Column(method_title(method), (), {"method": method})
            for method in numbers.methods(dataset, *conditions)
        ],
        [
            Line((condition_title(condition), title(metric)), {"condition": condition, "metric": metric})
            for condition in conditions
            for metric in (*QUALITY, "fps")
        ],
        {"dataset": dataset, "scene": MEAN},
        best_of=("method",),
    )


def scene_comparison(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return deployed condition x method of a dataset of few scenes, a block per scene.

    In each scene the best of a method's deployments is bold.
    """
    scenes = [*numbers.scenes(dataset), MEAN]
    return make_table(
        numbers,
        paper,
        f"scene_comparison-{slug(dataset)}",
        f"{dataset_title(dataset)}: Dedicated and Standard deployment per scene. Bold: the better of a "
        "method's deployments.",
        ("Condition", "Method"),
        [
            column
            for scene in scenes
            for column in metric_columns((*QUALITY, "fps"), scene_title(scene), scene=scene)
        ],
        deployment_lines(numbers, dataset),
        {"dataset": dataset},
        best_of=("method", "scene"),
    )


def per_scene(numbers: Numbers, dataset: str, condition: str) -> Table:
    """Return every scene of a dataset in one condition, a block per method; the best method is bold."""
    chamfer = ("chamfer",) if (dataset, condition) == ("dtu", "non_engine") else ()
    return make_table(
        numbers,
        None,
        f"scenes-{slug(dataset)}-{slug(condition)}",
        f"{dataset_title(dataset)}, {condition_title(condition)}: every scene. Bold: the best method.",
        ("Scene",),
        [
            column
            for method in numbers.methods(dataset, condition)
            for column in metric_columns((*QUALITY, "fps", *chamfer), method_title(method), method=method)
        ],
        scene_lines(numbers, dataset),
        {"dataset": dataset, "condition": condition},
        best_of=("scene",),
    )

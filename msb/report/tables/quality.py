"""Tables of image quality: with the research renderers, and with tiers and engines."""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING

from msb.report.layout import Layout, Line, make_table
from msb.report.metric_format import title
from msb.report.numbers import MEAN, QUALITY, Key, condition_title, dataset_title, method_title, scene_title
from msb.report.safe_names import slug
from msb.report.table import Column
from msb.report.tables.scenes import scene_lines

if TYPE_CHECKING:
    from msb.report.numbers import Numbers
    from msb.report.table import Table

_NATIVE = ("fps", "train_memory", "train_seconds", "chamfer")
"""The metrics of a method's own images, besides those of `QUALITY`."""


def native_summary(numbers: Numbers, paper: Numbers | None = None, *, label: str = "native_summary") -> Table:
    """Return what the methods reach with their own renderers; the best method of a dataset is bold."""
    lines = [
        Line(
            (dataset_title(dataset), method_title(method)),
            tuple(Key(dataset, MEAN, method, "non_engine", metric) for metric in (*QUALITY, *_NATIVE)),
        )
        for dataset in numbers.datasets()
        for method in numbers.methods(dataset, "non_engine")
    ]
    caption = "Non-Engine results: each method with its own renderer, means over the scenes of a dataset."
    return make_table(
        Layout(
            label,
            caption,
            ("Dataset", "Method"),
            tuple(Column(title(metric)) for metric in (*QUALITY, *_NATIVE)),
            tuple(lines),
            best_of=lambda key: key.dataset,
        ),
        numbers,
        paper,
    )


def renderer_comparison(
    numbers: Numbers, dataset: str, paper: Numbers | None = None, *, label: str | None = None
) -> Table:
    """Return a row per condition and metric, a column per method; each method's best condition is bold."""
    methods = numbers.methods(dataset, *numbers.conditions(dataset))
    lines = [
        Line(
            (condition_title(condition), title(metric)),
            tuple(Key(dataset, MEAN, method, condition, metric) for method in methods),
        )
        for condition in numbers.conditions(dataset)
        for metric in (*QUALITY, "fps")
    ]
    return make_table(
        Layout(
            label or f"renderer_comparison-{slug(dataset)}",
            f"{dataset_title(dataset)}: the same models in their own renderer and deployed, means over "
            "scenes. Bold: a method's best condition.",
            ("Condition", "Metric"),
            tuple(Column(method_title(method)) for method in methods),
            tuple(lines),
            best_of=lambda key: key.method,
        ),
        numbers,
        paper,
    )


def scene_comparison(
    numbers: Numbers, dataset: str, paper: Numbers | None = None, *, label: str | None = None
) -> Table:
    """Return deployed condition x method of a dataset of few scenes, a block per scene.

    In each scene the best of a method's deployments is bold.
    """
    scenes = [*numbers.scenes(dataset), MEAN]
    conditions = [condition for condition in numbers.conditions(dataset) if condition != "non_engine"]

    def rival(key: Key) -> Hashable:
        return key.method, key.scene

    lines = [
        Line(
            (condition_title(condition), method_title(method)),
            tuple(
                Key(dataset, scene, method, condition, metric)
                for scene in scenes
                for metric in (*QUALITY, "fps")
            ),
        )
        for condition in conditions
        for method in numbers.methods(dataset, *conditions)
    ]
    return make_table(
        Layout(
            label or f"scene_comparison-{slug(dataset)}",
            f"{dataset_title(dataset)}: Dedicated and Standard deployment per scene. Bold: the better of a "
            "method's deployments.",
            ("Condition", "Method"),
            tuple(
                Column(title(metric), (scene_title(scene),))
                for scene in scenes
                for metric in (*QUALITY, "fps")
            ),
            tuple(lines),
            best_of=rival,
        ),
        numbers,
        paper,
    )


def per_scene(numbers: Numbers, dataset: str, condition: str) -> Table:
    """Return every scene of a dataset in one condition, a block per method; the best method is bold."""
    methods = numbers.methods(dataset, condition)
    chamfer = ("chamfer",) if (dataset, condition) == ("dtu", "non_engine") else ()
    metrics = (*QUALITY, "fps", *chamfer)
    return make_table(
        Layout(
            f"scenes-{slug(dataset)}-{slug(condition)}",
            f"{dataset_title(dataset)}, {condition_title(condition)}: every scene. Bold: the best method.",
            ("Scene",),
            tuple(Column(title(metric), (method_title(method),)) for method in methods for metric in metrics),
            scene_lines(
                numbers,
                dataset,
                lambda scene: [
                    Key(dataset, scene, method, condition, metric) for method in methods for metric in metrics
                ],
            ),
            best_of=lambda key: key.scene,
        ),
        numbers,
    )

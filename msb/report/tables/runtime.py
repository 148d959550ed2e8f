"""Tables of what drawing costs: device time and memory, per scene."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.report.layout import Layout, Line, make_table
from msb.report.metric_format import SHOWN, title_with_unit
from msb.report.numbers import MEAN, Key, condition_title, dataset_title, method_title, scene_title
from msb.report.safe_names import slug
from msb.report.table import NOT_SUPPORTED, Column
from msb.report.tables.scenes import scene_lines

if TYPE_CHECKING:
    from msb.report.numbers import Numbers
    from msb.report.table import Table

TIME_NOTE = (
    "P50 and P95 of the device time of a frame, from the start of its first command to the end of its last, "
    "per scene; a mean is the mean of the scenes' percentiles"
)
MEMORY_NOTE = (
    "bytes of all buffers and images held after every test view was drawn, each as large as the most "
    "demanding view needs; without the driver's own"
)
DRIVER_NOTE = (
    "By the driver: all that the process held on NVIDIA's GPUs then, as NVML tells it, with what the driver "
    "itself takes and what earlier cells of the same process left"
)
PARTS_NOTES = (
    "Busy P50: the sum of the times of a frame's commands; P50 less it is time between commands",
    "Host: 1000 / FPS - P50, the part of a frame's wall-clock time outside of the device's work on it",
    "Rounds apart: the fastest less the slowest of five rounds of frames, as a share of the frame rate",
)
_TIMES = ("p50_ms", "p95_ms")


def latency(
    numbers: Numbers, dataset: str, paper: Numbers | None = None, *, label: str | None = None
) -> Table:
    """Return P50 and P95 per scene of every deployment."""
    pairs, omitted = _deployments(numbers, dataset, "p50_ms")
    caption = f"{dataset_title(dataset)}: device time of a frame per scene, ms; lower is better."
    return make_table(
        Layout(
            label or f"latency-{slug(dataset)}",
            caption,
            ("Scene",),
            tuple(
                Column(SHOWN[metric].title, (f"{condition_title(condition)} (ms ↓)", method_title(method)))
                for condition, method in pairs
                for metric in _TIMES
            ),
            scene_lines(
                numbers,
                dataset,
                lambda scene: [
                    Key(dataset, scene, method, condition, metric)
                    for condition, method in pairs
                    for metric in _TIMES
                ],
            ),
            definitions=(TIME_NOTE,),
            notes=omitted,
        ),
        numbers,
        paper,
    )


def frame_time(numbers: Numbers, dataset: str) -> Table:
    """Return where the time of a frame goes: on the device, between its commands, on the host."""
    metrics = ("fps", "p50_ms", "spread_ms", "busy_p50_ms", "host_ms", "unsteady")
    pairs, omitted = _deployments(numbers, dataset, "p50_ms")
    return make_table(
        Layout(
            f"frame_time-{slug(dataset)}",
            f"{dataset_title(dataset)}: where the time of a frame goes, means over scenes.",
            ("Condition", "Method"),
            tuple(Column(title_with_unit(metric)) for metric in metrics),
            tuple(
                Line(
                    (condition_title(condition), method_title(method)),
                    tuple(Key(dataset, MEAN, method, condition, metric) for metric in metrics),
                )
                for condition, method in pairs
            ),
            definitions=(TIME_NOTE, *PARTS_NOTES),
            notes=omitted,
        ),
        numbers,
    )


def memory(
    numbers: Numbers, dataset: str, paper: Numbers | None = None, *, label: str | None = None
) -> Table:
    """Return device memory per scene of every deployment."""
    pairs, omitted = _deployments(numbers, dataset, "memory")
    told = [
        pair
        for pair in pairs
        if numbers.value(Key(dataset, MEAN, pair[1], pair[0], "driver_memory")) is not None
    ]
    columns = [
        (condition, method, metric)
        for condition, method in pairs
        for metric in (("memory", "driver_memory") if (condition, method) in told else ("memory",))
    ]
    return make_table(
        Layout(
            label or f"memory-{slug(dataset)}",
            f"{dataset_title(dataset)}: device memory per scene, MiB; lower is better.",
            ("Scene",),
            tuple(
                Column(
                    method_title(method) + (", by the driver" if metric == "driver_memory" else ""),
                    (f"{condition_title(condition)} (MiB ↓)",),
                )
                for condition, method, metric in columns
            ),
            scene_lines(
                numbers,
                dataset,
                lambda scene: [
                    Key(dataset, scene, method, condition, metric) for condition, method, metric in columns
                ],
            ),
            definitions=(MEMORY_NOTE, DRIVER_NOTE) if told else (MEMORY_NOTE,),
            notes=omitted,
        ),
        numbers,
        paper,
    )


def runtime_resources(
    numbers: Numbers, dataset: str, paper: Numbers | None = None, *, label: str | None = None
) -> Table:
    """Return device time, memory and asset size of a dataset of few scenes, side by side."""
    scenes = [*numbers.scenes(dataset), MEAN]
    conditions = [condition for condition in numbers.conditions(dataset) if condition != "non_engine"]
    blocks: tuple[tuple[str, tuple[str, ...], dict[str, str]], ...] = (
        ("Device time of a frame (ms ↓)", _TIMES, {}),
        ("Memory (MiB ↓)", ("memory", "asset_size"), {"memory": "Render"}),
    )
    places = [(scene, metric) for _, metrics, _ in blocks for scene in scenes for metric in metrics]
    lines = [
        Line(
            (condition_title(condition), method_title(method)),
            tuple(Key(dataset, scene, method, condition, metric) for scene, metric in places),
        )
        for condition in conditions
        for method in numbers.methods(dataset, *conditions)
    ]
    return make_table(
        Layout(
            label or f"runtime_resources-{slug(dataset)}",
            f"{dataset_title(dataset)}: device time (ms), memory while drawing and size of the asset (MiB).",
            ("Condition", "Method"),
            tuple(
                Column(names.get(metric, SHOWN[metric].title), (heading, scene_title(scene)))
                for heading, metrics, names in blocks
                for scene in scenes
                for metric in metrics
            ),
            tuple(lines),
            definitions=(
                TIME_NOTE,
                f"Render: {MEMORY_NOTE}; Asset: the files of the asset, the same on both tiers",
            ),
        ),
        numbers,
        paper,
    )


def _deployments(
    numbers: Numbers, dataset: str, metric: str
) -> tuple[list[tuple[str, str]], tuple[str, ...]]:
    """Return the (condition, method) pairs shown, and a note on each that nothing can be shown of."""
    pairs, omitted = [], []
    for condition in numbers.conditions(dataset):
        if condition == "non_engine":
            continue
        for method in numbers.methods(dataset, condition):
            number = numbers.number(Key(dataset, MEAN, method, condition, metric))
            if number.value is None and number.absent == NOT_SUPPORTED:
                why = f": {number.reason}" if number.reason else ""
                omitted.append(f"{method_title(method)} is N/A under {condition_title(condition)}{why}")
            else:
                pairs.append((condition, method))
    return pairs, tuple(omitted)

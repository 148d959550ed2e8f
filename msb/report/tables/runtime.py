"""Tables of what drawing costs: device time and memory, per scene."""

from __future__ import annotations

from msb.report.layout import Line, make_table
from msb.report.metric_format import SHOWN, title_with_unit
from msb.report.numbers import MEAN, Key, Numbers, condition_title, dataset_title, method_title, scene_title
from msb.report.safe_names import slug
from msb.report.table import NOT_SUPPORTED, Column, Table
from msb.report.tables.quality import deployment_lines
from msb.report.tables.scenes import scene_lines

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
_PARTS = ("fps", "p50_ms", "spread_ms", "busy_p50_ms", "host_ms", "unsteady")


def latency(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return P50 and P95 per scene of every deployment."""
    pairs, omitted = _deployments(numbers, dataset, "p50_ms")
    columns = [
        Column(
            SHOWN[metric].title,
            (f"{condition_title(condition)} (ms ↓)", method_title(method)),
            {"condition": condition, "method": method, "metric": metric},
        )
        for condition, method in pairs
        for metric in _TIMES
    ]
    return make_table(
        numbers,
        paper,
        f"latency-{slug(dataset)}",
        f"{dataset_title(dataset)}: device time of a frame per scene, ms; lower is better.",
        ("Scene",),
        columns,
        scene_lines(numbers, dataset),
        {"dataset": dataset},
        definitions=(TIME_NOTE,),
        notes=omitted,
    )


def frame_time(numbers: Numbers, dataset: str) -> Table:
    """Return where the time of a frame goes: on the device, between its commands, on the host."""
    pairs, omitted = _deployments(numbers, dataset, "p50_ms")
    return make_table(
        numbers,
        None,
        f"frame_time-{slug(dataset)}",
        f"{dataset_title(dataset)}: where the time of a frame goes, means over scenes.",
        ("Condition", "Method"),
        [Column(title_with_unit(metric), (), {"metric": metric}) for metric in _PARTS],
        [
            Line(
                (condition_title(condition), method_title(method)), {"condition": condition, "method": method}
            )
            for condition, method in pairs
        ],
        {"dataset": dataset, "scene": MEAN},
        definitions=(TIME_NOTE, *PARTS_NOTES),
        notes=omitted,
    )


def memory(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return device memory per scene of every deployment."""
    pairs, omitted = _deployments(numbers, dataset, "memory")
    columns = []
    by_driver = False
    for condition, method in pairs:
        of = {"condition": condition, "method": method}
        group, name = (f"{condition_title(condition)} (MiB ↓)",), method_title(method)
        columns.append(Column(name, group, {**of, "metric": "memory"}))
        if numbers.value(Key(dataset, MEAN, method, condition, "driver_memory")) is not None:
            columns.append(Column(f"{name}, by the driver", group, {**of, "metric": "driver_memory"}))
            by_driver = True
    return make_table(
        numbers,
        paper,
        f"memory-{slug(dataset)}",
        f"{dataset_title(dataset)}: device memory per scene, MiB; lower is better.",
        ("Scene",),
        columns,
        scene_lines(numbers, dataset),
        {"dataset": dataset},
        definitions=(MEMORY_NOTE, DRIVER_NOTE) if by_driver else (MEMORY_NOTE,),
        notes=omitted,
    )


def runtime_resources(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return device time, memory and asset size of a dataset of few scenes, side by side."""
    blocks = {
        "Device time of a frame (ms ↓)": {metric: SHOWN[metric].title for metric in _TIMES},
        "Memory (MiB ↓)": {"memory": "Render", "asset_size": SHOWN["asset_size"].title},
    }
    columns = [
        Column(name, (heading, scene_title(scene)), {"scene": scene, "metric": metric})
        for heading, names in blocks.items()
        for scene in (*numbers.scenes(dataset), MEAN)
        for metric, name in names.items()
    ]
    return make_table(
        numbers,
        paper,
        f"runtime_resources-{slug(dataset)}",
        f"{dataset_title(dataset)}: device time (ms), memory while drawing and size of the asset (MiB).",
        ("Condition", "Method"),
        columns,
        deployment_lines(numbers, dataset),
        {"dataset": dataset},
        definitions=(
            TIME_NOTE,
            f"Render: {MEMORY_NOTE}; Asset: the files of the asset, the same on both tiers",
        ),
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

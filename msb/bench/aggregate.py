"""Define the metrics of the tables, and average them over scenes and groups of scenes.

Values are unrounded and in the units of the records (bytes, seconds, milliseconds). Tables round the values.
A missing number is None, never zero. The rules are described in docs/protocol.md.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal, NamedTuple

from msb.base.packages import Lazy
from msb.bench.records import BAKED, Result, Timing
from msb.metrics.registry import IMAGE_METRICS
from msb.scenes.datasets.catalog import DATASETS
from msb.topology.metric_text import DECIMALS

Better = Literal["higher", "lower"]
_MIB = float(1 << 20)
# Maximum difference between the frame rates of two timing rounds, relative to the overall frame rate. On an
# idle machine, the frame rates of timing rounds differ by a few percent. A difference of more than 25 % shows
# that other programs slowed down the renderer.
MAX_RATE_RANGE = 0.25


class Metric(NamedTuple):
    """A number in the tables: title, unit, precision, and a function that reads the value from a record."""

    title: str
    unit: str
    decimals: int
    # Whether higher or lower values are better; None for a metric without a direction.
    better: Better | None
    get: Callable[[Result], float | None]
    # Factor between the printed unit and the unit of the records. The factor is 60 if seconds are printed as
    # minutes.
    scale: float = 1.0

    @property
    def last_digit(self) -> float:
        """The value of one unit of the last printed digit, in the unit of the records."""
        return float(10.0**-self.decimals * self.scale)


def _read_metric(name: str) -> Callable[[Result], float | None]:
    """Return a function that reads an image metric from a benchmark record."""
    return lambda result: None if result.quality is None else result.quality.values[name]


def _read_key(place: str) -> Callable[[Result], float | None]:
    """Return a function that reads a value from a record by its dotted name, such as "walk.flicker"."""

    def get(result: Result) -> float | None:
        value: Any = result
        for name in place.split("."):
            value = None if value is None else getattr(value, name)
        return None if value is None else float(value)

    return get


def _read_timing(get: Callable[[Timing], float | None]) -> Callable[[Result], float | None]:
    """Return a function that computes a number from the timing section of a record."""
    return lambda result: None if result.timing is None else get(result.timing)


def _read_device_time(get: Callable[[Timing], float]) -> Callable[[Result], float | None]:
    """Return a function that computes a number from device times.

    Without device times, the function returns None.
    """
    return _read_timing(lambda times: get(times) if times.has_device_times else None)


def _compute_rate_range(timing: Timing) -> float | None:
    """Return the range of the frame rates of the timing rounds, divided by the overall frame rate."""
    rates = timing.round_fps
    return (max(rates) - min(rates)) / timing.fps if len(rates) > 1 else None


def why_unsteady(result: Result) -> str | None:
    """Return an error text if the frame rates of the rounds differ by more than 25 %.

    The result is None if the frame rate can be used.
    """
    if result.timing is None or (_compute_rate_range(result.timing) or 0.0) <= MAX_RATE_RANGE:
        return None
    slow, fast = min(result.timing.round_fps), max(result.timing.round_fps)
    slowest, fastest = (f"{rate:,.0f}" if rate >= 100 else f"{rate:.3g}" for rate in (slow, fast))
    rates = f"the slowest of {len(result.timing.round_fps)} rounds had {slowest} frames per second"
    return f"{rates}, the fastest {fastest}; run the timing again on an idle machine"


def _get_memory(result: Result) -> float | None:
    """Return the GPU memory of a renderer in bytes."""
    if result.memory is not None:
        return result.memory.total
    return None if result.renderer_timing is None else result.renderer_timing.peak_gpu_memory_bytes


def _get_fps(result: Result) -> float | None:
    return getattr(result.timing or result.renderer_timing, "fps", None)


def _count_faces(result: Result) -> float | None:
    if result.bake is not None:
        return result.bake.faces
    return None if result.audit is None else result.audit.counts.faces


def _count_working_tasks(result: Result) -> float | None:
    """Return the number of trial tasks that work, with or without limitations."""
    trials = [] if result.trial is None else result.trial.trials
    return sum(trial.outcome in ("works", "care") for trial in trials) if trials else None


_STRUCTURE: dict[str, tuple[str, Better | None]] = {
    "vf_ratio": ("V/F", None),
    "mean_valence": ("Valence", None),
    "boundary_edge_ratio": ("Boundary edge", None),
    "nonmanifold_edge_ratio": ("Non-manif. edge", "lower"),
    "nonmanifold_vertex_ratio": ("Non-manif. vertex", "lower"),
    "lcc_face_ratio": ("LCC face", "higher"),
    "lcc_area_ratio": ("LCC area", "higher"),
    "components": ("Components", "lower"),
}
# The metrics of an audit.
AUDITED = tuple(_STRUCTURE)
_OTHERS: dict[str, Metric] = {
    "fps": Metric("FPS", "1/s", 0, "higher", _get_fps),
    "p50_ms": Metric("P50", "ms", 1, "lower", _read_device_time(lambda times: times.p50_ms)),
    "p95_ms": Metric("P95", "ms", 1, "lower", _read_device_time(lambda times: times.p95_ms)),
    "spread_ms": Metric(
        "P95 - P50", "ms", 1, "lower", _read_device_time(lambda times: times.p95_ms - times.p50_ms)
    ),
    "busy_p50_ms": Metric("Busy P50", "ms", 1, "lower", _read_device_time(lambda times: times.busy_p50_ms)),
    "host_ms": Metric(
        "Host", "ms", 1, "lower", _read_device_time(lambda times: 1000 / times.fps - times.p50_ms)
    ),
    "unsteady": Metric("Rounds apart (%)", "%", 0, "lower", _read_timing(_compute_rate_range), 0.01),
    "memory": Metric("Memory", "MiB", 0, "lower", _get_memory, _MIB),
    "driver_memory": Metric("By the driver", "MiB", 0, "lower", _read_key("memory.driver_bytes"), _MIB),
    "asset_size": Metric("Asset", "MiB", 0, "lower", _read_key("asset.bytes"), _MIB),
    "flicker": Metric("Flicker (levels)", "levels", 2, "lower", _read_key("walk.flicker")),
    "flicker_worst": Metric("Worst second (levels)", "levels", 2, "lower", _read_key("walk.flicker_worst")),
    "holes": Metric("Holes (%)", "%", 2, "lower", _read_key("walk.holes"), 0.01),
    "train_seconds": Metric("Train time (min)", "min", 1, "lower", _read_key("training.seconds"), 60.0),
    "train_memory": Metric(
        "Peak mem. (MiB)", "MiB", 0, "lower", _read_key("training.peak_memory_bytes"), _MIB
    ),
    "psnr_16": Metric("PSNR, 16 samples", "dB", 2, "higher", _read_key("bake.psnr.photographs.after_16")),
    "faces": Metric("Triangles", "1", 0, None, _count_faces),
    "tasks": Metric("Tasks", "1", 0, "higher", _count_working_tasks),
    "bake_seconds": Metric("Seconds", "s", 0, "lower", _read_key("bake.seconds")),
    "chamfer": Metric("CD", "mm", 2, "lower", _read_key("chamfer.overall")),
    **{
        key: Metric(title, "1", DECIMALS, better, _read_key(f"audit.metrics.{key}"))
        for key, (title, better) in _STRUCTURE.items()
    },
}


@cache
def _list_metrics() -> Mapping[str, Metric]:
    images = {
        key: Metric(metric.title, metric.unit, metric.decimals, metric.better, _read_metric(key))
        for key, metric in IMAGE_METRICS.items()
    }
    return images | _OTHERS


# All numbers of the tables. Memory and sizes are in bytes. `spread_ms` is the 95th percentile minus the
# median. `host_ms` is the wall-clock time of a frame minus its device time. `unsteady` is the difference in
# frame rate between the fastest and the slowest timing round, relative to the overall rate. `flicker` and
# `holes` are measured on the walk, a camera path away from the captured views. `chamfer` is the DTU
# benchmark's "overall" distance.
METRICS: Mapping[str, Metric] = Lazy(_list_metrics)

# The scenes of each dataset over which averages are computed.
SCENES: dict[str, tuple[str, ...]] = {name: tuple(dataset.scenes) for name, dataset in DATASETS.items()}
# The printed name of each dataset, in the order of the tables.
TITLES: dict[str, str] = {name: dataset.title for name, dataset in DATASETS.items()}
# The heading of each condition, in the order of the tables.
CONDITION_TITLES: dict[str, str] = {
    "non_engine": "Non-Engine",
    "dedicated": "Dedicated",
    "standard": "Standard",
    BAKED: "Baked",
    "exported_mesh": "Exported mesh",
}


@dataclass(frozen=True)
class Mean:
    """An unweighted average over the scenes of a dataset.

    `present` is the number of scenes with a value, and `expected` is the number of all scenes.
    """

    value: float | None
    present: int
    expected: int

    @property
    def partial(self) -> bool:
        """Whether the value of at least one scene is missing."""
        return self.present < self.expected


def expected_scenes(dataset: str, present: Iterable[str]) -> tuple[str, ...]:
    """Return the scenes of `dataset` over which averages are computed.

    The result is all published scenes if `present` contains a published scene, otherwise the scenes in
    `present`.
    """
    names = tuple(dict.fromkeys(present))
    published = SCENES.get(dataset, ())
    return published if not names or any(scene in published for scene in names) else names


def scene_groups(dataset: str) -> dict[str, tuple[str, ...]]:
    """Return the scene groups of `dataset`, such as "indoor_mean", with the scenes of each group."""
    groups: dict[str, list[str]] = {}
    for scene, group in DATASETS[dataset].scenes.items() if dataset in DATASETS else ():
        if group:
            groups.setdefault(f"{group}_mean", []).append(scene)
    return {name: tuple(scenes) for name, scenes in groups.items()}


def mean_over(values: Mapping[str, float | None], scenes: Iterable[str]) -> Mean:
    """Return the average over `scenes` with equal weights.

    The average of P95 is the average of the scenes' percentiles, not a percentile of all frames. The average
    of Mip-NeRF 360 is over nine scenes, not over its indoor and outdoor averages.
    """
    expected = tuple(scenes)
    known = [value for scene in expected if (value := values.get(scene)) is not None]
    return Mean(math.fsum(known) / len(known) if known else None, len(known), len(expected))

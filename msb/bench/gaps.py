"""Deployment gaps and slowdowns between the conditions of a method (paper: section "Multi-Modal Audit").

Let Q_ne, Q_ded and Q_std be the values of a metric in Non-Engine, Dedicated and Standard. Let s be +1 if
higher values are better, otherwise -1. The signed losses are a = s (Q_ne - Q_ded) for adaptation, p = s
(Q_ded - Q_std) for portability and d = s (Q_ne - Q_std) for deployment. A positive loss means a worse result.
The paper's gaps of adaptation, portability and deployment are the absolute values of a, p and d. The paper's
equation deploy = adapt + port holds only if Dedicated lies between Non-Engine and Standard (`Gaps.monotone`).
`Gaps.triangle_excess` is adapt + port - deploy.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from msb.bench.aggregate import METRICS, mean_over, why_unsteady
from msb.bench.intervals import Interval, interval, view_values
from msb.metrics.identity import defined
from msb.metrics.registry import IMAGE_METRICS
from msb.render.machine import OF_THE_MOMENT

if TYPE_CHECKING:
    from msb.bench.records import Result

    Conditions = Mapping[str, Result]

GapName = Literal["adapt", "port", "deploy"]
# The two renderer conditions that each gap compares.
PAIRS: dict[GapName, tuple[str, str]] = {
    "adapt": ("non_engine", "dedicated"),
    "port": ("dedicated", "standard"),
    "deploy": ("non_engine", "standard"),
}

# Keys of a device record that do not identify the device.
_NOT_IDENTIFYING = OF_THE_MOMENT | {"blends"}
# Metrics that are compared only between equal devices.
_DEVICE_METRICS = frozenset({"fps", "p50_ms", "p95_ms", "memory", "driver_memory"})


@dataclass(frozen=True)
class Gap:
    """A difference between two renderer conditions, in the unit of the metric.

    The gap is an average over `scenes`. `expected` is the number of scenes in the dataset.
    """

    # The absolute gap; None if there is a `reason`.
    value: float | None
    # The signed loss; positive if the second condition is worse.
    signed: float | None = None
    # The reason for a missing gap, as returned by `incomparable`.
    reason: str | None = None
    # The average of the absolute gaps of single scenes. Positive and negative losses of scenes cancel in
    # `value`, but not in this average.
    mean_abs_scene_gap: float | None = None
    scenes: int = 1
    expected: int = 1
    # The average value of each condition over the scenes of the gap. Averages in other tables may cover more
    # scenes.
    ends: tuple[float, float] | None = None
    # The 95 % interval of `signed`, computed from the losses in single views. If only the two averages are
    # known, the interval is None.
    interval: Interval | None = None

    @property
    def partial(self) -> bool:
        """Whether the gap of at least one scene is missing."""
        return self.scenes < self.expected


@dataclass(frozen=True)
class Gaps:
    """The three gaps of a metric."""

    metric: str
    adapt: Gap
    port: Gap
    deploy: Gap
    # Whether the value of Dedicated lies between the values of Non-Engine and Standard. Values are compared
    # after rounding, as in tables. Equal rounded values count as monotone. The result is None if a gap is
    # missing, or if the gaps cover different scenes.
    monotone: bool | None
    # The excess adapt + port - deploy. The excess is 0 for monotone values, otherwise it is 2 min(adapt,
    # port).
    triangle_excess: float | None

    def __getitem__(self, name: GapName) -> Gap:
        gap: Gap = getattr(self, name)
        return gap


@dataclass(frozen=True)
class Ratio:
    """The ratio of the frame rates of two conditions."""

    # The ratio of the averages over the same scenes; None if no ratio can be computed.
    value: float | None
    reason: str | None = None
    per_scene: Mapping[str, float] = field(default_factory=dict)
    expected: int = 1

    @property
    def partial(self) -> bool:
        """Whether the ratio of at least one scene is missing."""
        return len(self.per_scene) < self.expected


def value_gaps(
    metric: str, non_engine: float | None, dedicated: float | None, standard: float | None
) -> Gaps:
    """Return the gaps between three values of `metric`.

    The name must be a key of `msb.bench.aggregate.METRICS`.
    """
    values = {"non_engine": non_engine, "dedicated": dedicated, "standard": standard}
    return _combine(
        metric, {name: _compute_gap(metric, values[a], values[b]) for name, (a, b) in PAIRS.items()}
    )


def scene_gaps(metric: str, results: Conditions) -> Gaps:
    """Return the gaps of one method on one scene. `results` contains the record of each condition."""
    return dataset_gaps(metric, {"": results}, [""])


def dataset_gaps(metric: str, results: Mapping[str, Conditions], scenes: Iterable[str]) -> Gaps:
    """Return the gaps of one method as in the paper: between its averages on a dataset.

    `results` contains the records by scene, then by condition. `scenes` names all scenes that the dataset
    should have. A gap includes the scenes in which both conditions have comparable records.
    """
    expected = tuple(scenes)
    covered: dict[GapName, tuple[str, ...]] = {}
    gaps: dict[GapName, Gap] = {}
    for name, pair in PAIRS.items():
        gaps[name], covered[name] = gap_between(metric, results, expected, *pair)
    return _combine(metric, gaps, same_scenes=len(set(covered.values())) == 1)


def gap_between(
    metric: str,
    results: Mapping[str, Mapping[str, Result]],
    scenes: tuple[str, ...],
    first: str,
    second: str,
    *,
    one_asset: bool = True,
) -> tuple[Gap, tuple[str, ...]]:
    """Return the gap between the records `first` and `second`, with the names of its scenes.

    `first` and `second` are two conditions of a method, or two methods if `one_asset` is false.
    """
    values, reasons = _select_comparable(metric, results, scenes, first, second, one_asset=one_asset)
    if not values:
        return Gap(None, reason=_find_commonest(reasons), scenes=0, expected=len(scenes)), ()
    averages = (math.fsum(pair[side] for pair in values.values()) / len(values) for side in (0, 1))
    absolute = [abs(before - after) for before, after in values.values()]
    losses = [_compute_view_losses(metric, results[scene][first], results[scene][second]) for scene in values]
    gap = replace(
        _compute_gap(metric, *averages),
        mean_abs_scene_gap=math.fsum(absolute) / len(absolute),
        scenes=len(values),
        expected=len(scenes),
        interval=interval(losses),
    )
    return gap, tuple(values)


def slowdown(
    results: Mapping[str, Conditions],
    scenes: Iterable[str],
    numerator: str = "standard",
    denominator: str = "dedicated",
) -> Ratio:
    """Return the ratio of the frame rates of two conditions.

    The default is the paper's slowdown, the frame rate of Standard divided by the frame rate of Dedicated.
    To compare an engine with the method's own renderer, pass "dedicated" and "non_engine".
    """
    expected = tuple(scenes)
    values, reasons = _select_comparable("fps", results, expected, numerator, denominator)
    if not values:
        return Ratio(None, _find_commonest(reasons), {}, len(expected))
    above, below = (
        mean_over({scene: pair[side] for scene, pair in values.items()}, values).value for side in (0, 1)
    )
    per_scene = {scene: fps / other for scene, (fps, other) in values.items() if other}
    return Ratio(above / below if above is not None and below else None, None, per_scene, len(expected))


def incomparable(
    metric: str, first: Result | None, second: Result | None, *, one_asset: bool = True
) -> str | None:
    """Return the reason that `metric` cannot be compared between two records, or None.

    The reasons are "unsupported", "failed", "missing" (no record), "not_measured" (no value in the record),
    "camera_mismatch" (different views or image sizes), "setup_mismatch" (different background or ground
    truth), "metric_mismatch", "asset_mismatch", "device_mismatch", "whole_command" (loading is included) and
    "unsteady" (the frame rates of timing rounds differ too much).

    The records must have equal images, sizes, ground truth, background and definition of the metric. If both
    records have an asset, the two assets must be equal. For a baked mesh, the asset before the bake is
    compared. Speed and memory must be measured on the same device. Versions of libraries may differ between
    records. If `one_asset` is false, two methods are compared. The backgrounds and camera conventions of two
    methods may differ.
    """
    for result in (first, second):
        if result is None:
            return "missing"
        if result.status != "done":
            return result.status
        if METRICS[metric].get(result) is None:
            return "not_measured"
    assert first is not None
    assert second is not None
    assets = first.model_asset, second.model_asset
    if one_asset and assets[0] and assets[1] and assets[0].sha256 != assets[1].sha256:
        return "asset_mismatch"
    if metric in _DEVICE_METRICS and (reason := _compare_devices(first, second)):
        return reason
    if metric == "fps" and (why_unsteady(first) or why_unsteady(second)):
        return "unsteady"
    if first.quality is None or second.quality is None:
        return None
    if first.quality.views != second.quality.views:
        return "camera_mismatch"
    if not one_asset:
        if _get_photograph_setup(first) != _get_photograph_setup(second):
            return "setup_mismatch"
    elif first.setup != second.setup:
        other = first.setup and second.setup
        convention = other and first.setup.camera_convention != second.setup.camera_convention  # type: ignore[union-attr]
        return "camera_mismatch" if convention else "setup_mismatch"
    if metric in IMAGE_METRICS and _find_definition(first, metric) != _find_definition(second, metric):
        return "metric_mismatch"
    return None


def _select_comparable(
    metric: str,
    results: Mapping[str, Conditions],
    scenes: tuple[str, ...],
    first: str,
    second: str,
    *,
    one_asset: bool = True,
) -> tuple[dict[str, tuple[float, float]], list[str]]:
    """For each comparable scene, return the values of both conditions.

    For all other scenes, return the reasons.
    """
    get = METRICS[metric].get
    values: dict[str, tuple[float, float]] = {}
    reasons = []
    for scene in scenes:
        pair = [results.get(scene, {}).get(condition) for condition in (first, second)]
        why = incomparable(metric, *pair, one_asset=one_asset)
        if why is not None:
            reasons.append(why)
            continue
        a, b = (get(result) for result in pair if result is not None)
        if a is not None and b is not None:
            values[scene] = (a, b)
    return values, reasons


def _compute_view_losses(metric: str, first: Result, second: Result) -> list[float]:
    """Return the signed loss in each view that both records contain."""
    sign = 1 if METRICS[metric].better == "higher" else -1
    before, after = (view_values(record, metric) for record in (first, second))
    return [sign * (before[view] - after[view]) for view in before if view in after]


def _compute_gap(metric: str, first: float | None, second: float | None) -> Gap:
    """Return the gap between two values of a metric."""
    better = METRICS[metric].better
    if better is None:
        raise ValueError(f"no gap is defined for {metric}, because neither direction is better")
    if first is None or second is None:
        return Gap(None, reason="not_measured", scenes=0)
    loss = first - second if better == "higher" else second - first
    return Gap(abs(first - second), loss, None, abs(first - second), ends=(first, second))


def _combine(metric: str, gaps: Mapping[GapName, Gap], *, same_scenes: bool = True) -> Gaps:
    """Return the three gaps of a metric, with their excess and whether the values are monotone."""
    adapt, port, deploy = gaps["adapt"], gaps["port"], gaps["deploy"]
    monotone: bool | None = None
    excess: float | None = None
    if same_scenes and adapt.signed is not None and port.signed is not None and deploy.value is not None:
        digits = IMAGE_METRICS[metric].decimals if metric in IMAGE_METRICS else None
        rounded = [loss if digits is None else round(loss, digits) for loss in (adapt.signed, port.signed)]
        monotone = rounded[0] * rounded[1] >= 0
        # For monotone values, set the excess to 0 to avoid rounding errors.
        excess = 0.0 if monotone else abs(adapt.signed) + abs(port.signed) - deploy.value
    return Gaps(metric, adapt, port, deploy, monotone, excess)


def _find_commonest(reasons: list[str]) -> str:
    """Return the most frequent reason, except "missing". If no scene has another reason, return "missing".

    The reason "missing" alone would not explain why measured scenes have no gap.
    """
    others = [reason for reason in reasons if reason != "missing"]
    return max(dict.fromkeys(others), key=others.count) if others else "missing"


def _get_photograph_setup(result: Result) -> tuple[str, bool] | None:
    """Return the image folder of a record, and whether its photographs were resized."""
    return None if result.setup is None else (result.setup.image_folder, result.setup.gt_resized)


def _find_definition(result: Result, metric: str) -> dict[str, object] | None:
    assert result.quality is not None
    name = IMAGE_METRICS[metric].name
    identities = (identity for identity in result.quality.metrics if identity.get("name") == name)
    return next((defined(identity) for identity in identities), None)


def _compare_devices(first: Result, second: Result) -> str | None:
    """Return the reason why times and memory of two records are not comparable.

    If they are comparable, return None.
    """
    native = [record.renderer_timing for record in (first, second) if record.renderer_timing is not None]
    if any(timing.whole_command for timing in native):
        return "whole_command"
    # If the user measured a timing, the record contains only the name of the device. Therefore only device
    # names are compared.
    if native:
        return None if _get_device_name(first) == _get_device_name(second) else "device_mismatch"
    devices = [
        {key: value for key, value in record.drawn_on.items() if key not in _NOT_IDENTIFYING}
        for record in (first, second)
    ]
    return None if devices[0] == devices[1] else "device_mismatch"


def _get_device_name(result: Result) -> str:
    if result.renderer_timing is not None:
        return result.renderer_timing.device.casefold()
    return str(result.drawn_on.get("name")).casefold()

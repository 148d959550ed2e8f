"""Deployment gaps and slowdowns, from records: what is lost between conditions (paper: "Multi-Modal Audit").

With a metric's orientation s (+1 where higher is better) the signed losses are a = s (Q_ne - Q_ded),
p = s (Q_ded - Q_std) and d = s (Q_ne - Q_std), positive where something is lost. The paper's gaps are their
absolute values, each from its own definition. The paper also states deploy = adapt + port; that holds only
where Dedicated lies between the other two (`Gaps.monotone`); `Gaps.triangle_excess` is adapt + port - deploy.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

from msb.bench.aggregate import METRICS, mean_over
from msb.bench.intervals import Interval, interval, view_values
from msb.metrics.identity import defined
from msb.metrics.registry import IMAGE_METRICS
from msb.render.machine import OF_THE_MOMENT

if TYPE_CHECKING:
    from msb.bench.records import Result

    Conditions = Mapping[str, Result]

GapName = Literal["adapt", "port", "deploy"]
# Gap -> the condition it starts from, and the condition it leads to.
PAIRS: dict[GapName, tuple[str, str]] = {
    "adapt": ("non_engine", "dedicated"),
    "port": ("dedicated", "standard"),
    "deploy": ("non_engine", "standard"),
}

# Keys of a device's record that do not tell which it is: `blends` says in what numbers it blends.
_NO_DEVICE = OF_THE_MOMENT | {"blends"}
_OF_A_DEVICE = frozenset({"fps", "p50_ms", "p95_ms", "memory", "driver_memory"})


@dataclass(frozen=True)
class Gap:
    """One gap, in the metric's unit, over `scenes` of the `expected` ones."""

    # The absolute gap; None if there is a `reason`.
    value: float | None
    # Positive where the second condition is worse.
    signed: float | None = None
    # What `incomparable` says.
    reason: str | None = None
    # For a dataset, the mean of the scenes' absolute gaps, which is never less than `value`.
    mean_abs_scene_gap: float | None = None
    scenes: int = 1
    expected: int = 1
    # The two means that the gap is between, over exactly those scenes. A mean over all scenes that a
    # condition has is over other scenes where some are missing.
    ends: tuple[float, float] | None = None
    # That of `signed`, from the losses view by view; None between bare values.
    interval: Interval | None = None

    @property
    def partial(self) -> bool:
        """Whether a scene is missing."""
        return self.scenes < self.expected


@dataclass(frozen=True)
class Gaps:
    """The three gaps of a metric."""

    metric: str
    adapt: Gap
    port: Gap
    deploy: Gap
    # Whether Dedicated lies between the other two, or equals one of them to the digits that are printed;
    # None where a gap is missing, or where the gaps are not over the same scenes.
    monotone: bool | None
    # adapt + port - deploy, which counts as 0 where monotone, else 2 min(adapt, port).
    triangle_excess: float | None

    def __getitem__(self, name: GapName) -> Gap:
        gap: Gap = getattr(self, name)
        return gap


@dataclass(frozen=True)
class Ratio:
    """The ratio of two rates: that of the means over the same scenes, and that in each scene."""

    # None if there is a `reason`, as in `Gap`.
    value: float | None
    reason: str | None = None
    per_scene: Mapping[str, float] = field(default_factory=dict)
    expected: int = 1

    @property
    def partial(self) -> bool:
        """Whether a scene is missing."""
        return len(self.per_scene) < self.expected


def value_gaps(
    metric: str, non_engine: float | None, dedicated: float | None, standard: float | None
) -> Gaps:
    """Return the gaps between three values of `metric`, a key of `msb.bench.aggregate.METRICS`."""
    values = {"non_engine": non_engine, "dedicated": dedicated, "standard": standard}
    return _together(metric, {name: _gap(metric, values[a], values[b]) for name, (a, b) in PAIRS.items()})


def scene_gaps(metric: str, results: Conditions) -> Gaps:
    """Return the gaps of one method on one scene, of the records by condition."""
    return dataset_gaps(metric, {"": results}, [""])


def dataset_gaps(metric: str, results: Mapping[str, Conditions], scenes: Iterable[str]) -> Gaps:
    """Return the gaps of one method on a dataset: the gaps between the means, as in the paper.

    `results` are the records by scene and condition, `scenes` those that there should be. Each gap is over
    the scenes in which both its conditions can be compared.
    """
    wanted = tuple(scenes)
    covered: dict[GapName, tuple[str, ...]] = {}
    gaps: dict[GapName, Gap] = {}
    for name, pair in PAIRS.items():
        gaps[name], covered[name] = gap_between(metric, results, wanted, *pair)
    return _together(metric, gaps, same_scenes=len(set(covered.values())) == 1)


def gap_between(
    metric: str,
    results: Mapping[str, Mapping[str, Result]],
    scenes: tuple[str, ...],
    first: str,
    second: str,
    *,
    one_asset: bool = True,
) -> tuple[Gap, tuple[str, ...]]:
    """Return the gap from the records named `first` to those named `second`, and the scenes it is over.

    The names are of two conditions, or of two methods if the records are not of `one_asset`.
    """
    values, reasons = _comparable(metric, results, scenes, first, second, one_asset=one_asset)
    if not values:
        return Gap(None, reason=_commonest(reasons), scenes=0, expected=len(scenes)), ()
    means = (math.fsum(both[side] for both in values.values()) / len(values) for side in (0, 1))
    each = [abs(before - after) for before, after in values.values()]
    gap = replace(
        _gap(metric, *means),
        mean_abs_scene_gap=math.fsum(each) / len(each),
        scenes=len(each),
        expected=len(scenes),
        interval=interval(
            [_losses(metric, results[scene][first], results[scene][second]) for scene in values]
        ),
    )
    return gap, tuple(values)


def slowdown(
    results: Mapping[str, Conditions],
    scenes: Iterable[str],
    numerator: str = "standard",
    denominator: str = "dedicated",
) -> Ratio:
    """Return the ratio of frame rates of two conditions, by default the paper's "slowdown" of Dedicated.

    "dedicated" to "non_engine" says whether an engine beats the research renderer.
    """
    wanted = tuple(scenes)
    values, reasons = _comparable("fps", results, wanted, numerator, denominator)
    if not values:
        return Ratio(None, _commonest(reasons), {}, len(wanted))
    means = [mean_over({s: both[side] for s, both in values.items()}, values).value for side in (0, 1)]
    per_scene = {scene: above / below for scene, (above, below) in values.items() if below}
    above, below = means
    return Ratio(above / below if above is not None and below else None, None, per_scene, len(wanted))


def incomparable(
    metric: str, first: Result | None, second: Result | None, *, one_asset: bool = True
) -> str | None:
    """Return why the values of `metric` in two records must not be compared, or None if they may.

    Why is "unsupported", "failed", "missing" (no record), "not_measured" (no such number in it),
    "camera_mismatch" (other images or sizes), "setup_mismatch" (background, ground truth), "metric_mismatch",
    "asset_mismatch", "device_mismatch" or "whole_command" (a time of more than drawing).

    The records must have the same images and sizes, ground truth, background and definition of the metric,
    the same asset, or bakes of it, if both have one, and for speed and memory the same device. Versions of
    libraries may differ. Of two methods (`one_asset` false) the background and the convention of cameras may
    differ, too: each method has its own.
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
    if metric in _OF_A_DEVICE and (reason := _other_device(first, second)):
        return reason
    if first.quality is None or second.quality is None:
        return None
    if first.quality.views != second.quality.views:
        return "camera_mismatch"
    if not one_asset:
        if _photographs(first) != _photographs(second):
            return "setup_mismatch"
    elif first.setup != second.setup:
        other = first.setup and second.setup
        convention = other and first.setup.camera_convention != second.setup.camera_convention  # type: ignore[union-attr]
        return "camera_mismatch" if convention else "setup_mismatch"
    if metric in IMAGE_METRICS and _definition(first, metric) != _definition(second, metric):
        return "metric_mismatch"
    return None


def _comparable(
    metric: str,
    results: Mapping[str, Conditions],
    scenes: tuple[str, ...],
    first: str,
    second: str,
    *,
    one_asset: bool = True,
) -> tuple[dict[str, tuple[float, float]], list[str]]:
    """Return scene -> the two values, where they may be compared, and why not elsewhere."""
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


def _losses(metric: str, first: Result, second: Result) -> list[float]:
    """Return what is lost from the first record to the second in each view that both have."""
    sign = 1 if METRICS[metric].better == "higher" else -1
    before, after = (view_values(one, metric) for one in (first, second))
    return [sign * (before[view] - after[view]) for view in before if view in after]


def _gap(metric: str, first: float | None, second: float | None) -> Gap:
    better = METRICS[metric].better
    if better is None:
        raise ValueError(f"{metric} has no better and no worse, so there is no gap")
    if first is None or second is None:
        return Gap(None, reason="not_measured", scenes=0)
    loss = first - second if better == "higher" else second - first
    return Gap(abs(first - second), loss, None, abs(first - second), ends=(first, second))


def _together(metric: str, gaps: Mapping[GapName, Gap], *, same_scenes: bool = True) -> Gaps:
    adapt, port, deploy = gaps["adapt"], gaps["port"], gaps["deploy"]
    monotone: bool | None = None
    excess: float | None = None
    if same_scenes and adapt.signed is not None and port.signed is not None and deploy.value is not None:
        digits = IMAGE_METRICS[metric].decimals if metric in IMAGE_METRICS else None
        shown = [loss if digits is None else round(loss, digits) for loss in (adapt.signed, port.signed)]
        monotone = shown[0] * shown[1] >= 0
        # Where it is 0 by definition, rounding must not make it anything else.
        excess = 0.0 if monotone else abs(adapt.signed) + abs(port.signed) - deploy.value
    return Gaps(metric, adapt, port, deploy, monotone, excess)


def _commonest(reasons: list[str]) -> str:
    return max(dict.fromkeys(reasons), key=reasons.count) if reasons else "missing"


def _photographs(result: Result) -> tuple[str, bool] | None:
    return None if result.setup is None else (result.setup.image_folder, result.setup.gt_resized)


def _definition(result: Result, metric: str) -> dict[str, object] | None:
    assert result.quality is not None
    name = IMAGE_METRICS[metric].name
    return next((defined(one) for one in result.quality.metrics if one.get("name") == name), None)


def _other_device(first: Result, second: Result) -> str | None:
    """Return why two records' times and sizes are not of one device, or not of the same thing."""
    elsewhere = [one.renderer_timing for one in (first, second) if one.renderer_timing is not None]
    if any(timing.whole_command for timing in elsewhere):
        return "whole_command"
    if elsewhere:
        return None if _device_name(first) == _device_name(second) else "device_mismatch"
    devices = [
        {key: value for key, value in one.drawn_on.items() if key not in _NO_DEVICE}
        for one in (first, second)
    ]
    return None if devices[0] == devices[1] else "device_mismatch"


def _device_name(result: Result) -> str:
    if result.renderer_timing is not None:
        return result.renderer_timing.device.casefold()
    return str(result.drawn_on.get("name")).casefold()

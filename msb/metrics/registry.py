"""The image metrics: ours, one line each, and those of installed packages (entry-point group `msb.metrics`).

Records, commands, gaps and tables read them here.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from msb.base.packages import Lazy, PackageError, contained, installed, load, whose
from msb.errors import Finding, MetricError, shorten
from msb.metrics.chamfer import CHAMFER
from msb.metrics.identity import Definition, Identity, ImageMetric, Pixels
from msb.metrics.images import PSNR_CAP, image_pair

# Module here and name of every image metric, in the order of the tables.
BUILT_IN = (
    "images.PSNR",
    "images.SSIM",
    "perceptual.LPIPS",
)
# The other keys beside those of image metrics, in records, tables and files; no metric may have one.
RESERVED = frozenset(
    "name width height file sha256 gt images metrics missing psnr_infinite psnr_inf_count lpips_reason "  # noqa: SIM905
    "pred fps p50_ms p95_ms spread_ms busy_p50_ms host_ms unsteady memory driver_memory asset_size "
    "flicker flicker_worst holes train_seconds train_memory chamfer psnr_16 faces bake_seconds tasks "
    "vf_ratio mean_valence "
    "boundary_edge_ratio nonmanifold_edge_ratio nonmanifold_vertex_ratio lcc_face_ratio lcc_area_ratio "
    "components".split()
)
# The types of what a package's metric declares.
_FIELDS: dict[str, Any] = {
    "title": str,
    "unit": str,
    "decimals": int,
    "version": int,
    "equal": (int, float),
    "parameters": Mapping,
    "libraries": (tuple, list),
    "measure": Callable,
}


@cache
def _installed() -> Mapping[str, ImageMetric]:
    """Return key -> metric."""
    places = (place.split(".") for place in BUILT_IN)
    metrics = (getattr(import_module(f"msb.metrics.{module}"), name) for module, name in places)
    ours: dict[str, ImageMetric] = {metric.key: metric for metric in metrics}
    taken = dict.fromkeys([*ours, ours["lpips"].name, CHAMFER.name], "msb.metrics")
    theirs = installed("metric", taken, _accepted)
    return ours | {key: metric for key, (metric, _) in theirs.items()}


def _accepted(key: str, value: str) -> ImageMetric:
    metric = load(value)
    if not isinstance(metric, ImageMetric):
        raise PackageError(f"it is no ImageMetric, but of type {type(metric).__name__}")
    if key in RESERVED:
        raise PackageError("its name is that of something else in records or tables")
    if not metric.key == metric.name == key:
        raise PackageError(f"its name and its key must be that of its entry point, {key}")
    for name, kind in _FIELDS.items():
        if not isinstance(held := getattr(metric, name), kind):
            raise PackageError(f"its {name} is of type {type(held).__name__}, which no metric has")
    if metric.better not in ("higher", "lower"):
        raise PackageError(f'its better is {shorten(repr(metric.better))}; it must be "higher" or "lower"')
    return replace(metric, measure=_Theirs(whose("metric", key, value), metric.measure), modules=())


@dataclass(frozen=True)
class _Theirs:
    """The function of a package's metric; what it does wrong is said to be its own."""

    whose: str
    measure: Any

    def __call__(self, rendering: Pixels, ground_truth: Pixels) -> float:
        try:
            with contained():
                value = self.measure(rendering.copy(), ground_truth.copy())
                number = math.nan if isinstance(value, bool | str | bytes) else float(value)
        except (PackageError, MetricError) as error:
            raise MetricError("METRIC_FAILED", f"{self.whose} fails: {error}") from error
        if not math.isfinite(number):
            text = f"{self.whose} gives {shorten(repr(value), 60)}; it must give a finite number"
            raise MetricError("METRIC_FAILED", text)
        return number


# Key in records, tables and JSON -> metric: ours in the order of the tables, then those of packages.
IMAGE_METRICS: Mapping[str, ImageMetric] = Lazy(_installed)


def _by_name() -> dict[str, Definition]:
    return {each.name: each for each in (*IMAGE_METRICS.values(), CHAMFER)}


# Name of every metric -> whether "higher" or "lower" is better.
METRICS: Mapping[str, str] = Lazy(lambda: {name: each.better for name, each in _by_name().items()})


def identity(
    name: str, *, weights: Mapping[str, Any] | None = None, **parameters: str | float | bool | None
) -> Identity:
    """Return the identity of the metric `name` as it is computed here and now.

    Parameters
    ----------
    name : str
        A key of `METRICS`.
    weights : mapping, optional
        The record `LpipsVgg.weights`, for LPIPS only; the method `LpipsVgg.identity` fills it in.
    **parameters
        Parameters that this computation chose, such as ``quantize=False`` or ``seed=3``.

    Raises
    ------
    MetricError
        METRIC_ARGUMENT: there is no such metric.
    """
    known = _by_name()
    if name not in tuple(known):
        raise MetricError("METRIC_ARGUMENT", f"there is no metric '{name}'; there are {', '.join(known)}")
    return known[name].identity(weights=weights, **parameters)


class Measures:
    """All image metrics of two images at once: ``Measures(vgg_weights)(pred, gt)``.

    Without weights the metrics that need them are None.
    """

    def __init__(self, vgg_weights: Path | None = None) -> None:
        self._functions = {key: metric.measure for key, metric in IMAGE_METRICS.items()}
        identities = []
        warnings: list[Finding] = []
        for key, metric in IMAGE_METRICS.items():
            if metric.load is None:
                identities.append(metric.identity())
            elif vgg_weights is not None:
                network = metric.load(vgg_weights)
                self._functions[key] = network
                identities.append(metric.identity(weights=network.weights))
                warnings += [one for one in network.warnings if one not in warnings]
        self.identities: tuple[Identity, ...] = tuple(identities)
        """Of the metrics that are computed."""
        self.warnings: tuple[Finding, ...] = tuple(warnings)
        """About the weights."""
        self.failed: dict[str, str] = {}
        """Key of a package's metric that has failed -> what was wrong the first time, with its code."""

    def __call__(self, pred: ArrayLike, gt: ArrayLike) -> dict[str, float | None]:
        """Return key -> value of two images as `psnr` takes them.

        It is None where weights are missing, and where a package's metric failed.
        """
        a, b = image_pair(pred, gt)
        results: dict[str, float | None] = dict.fromkeys(self._functions)
        for key, function in self._functions.items():
            try:
                results[key] = None if function is None else function(a, b)
            except MetricError as error:
                if error.code != "METRIC_FAILED":
                    raise
                self.failed.setdefault(key, str(error))
        return results


def modules_needed() -> tuple[str, ...]:
    """Return the modules of the extra `bench` that the image metrics import."""
    return tuple(dict.fromkeys(name for metric in IMAGE_METRICS.values() for name in metric.modules))


def mean_of(values: Iterable[float | None]) -> float | None:
    """Return the mean of the images' values; None if one has no value. Infinite values count `PSNR_CAP`."""
    capped = [PSNR_CAP if value == math.inf else value for value in values]
    known = [value for value in capped if value is not None]
    return math.fsum(known) / len(known) if known and len(known) == len(capped) else None

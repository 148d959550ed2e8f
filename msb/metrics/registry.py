"""Registry of image metrics: built-in metrics, and metrics of other packages (entry points `msb.metrics`).

Benchmark records, commands and tables use the metrics in this registry.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from msb.base.packages import Lazy, PackageError, contain_errors, describe_entry, find_installed, load
from msb.errors import Finding, MetricError, shorten
from msb.metrics.chamfer import CHAMFER
from msb.metrics.identity import Definition, Identity, ImageMetric, Pixels
from msb.metrics.images import PSNR_CAP, check_pair

# Module and name of every built-in image metric, in the order of tables.
BUILT_IN = (
    "images.PSNR",
    "images.SSIM",
    "perceptual.LPIPS",
)
# Reserved keys of records, tables and files, which image metrics must not use.
RESERVED = frozenset(
    "name width height file sha256 gt images metrics missing psnr_infinite psnr_inf_count lpips_reason "  # noqa: SIM905
    "pred fps p50_ms p95_ms spread_ms busy_p50_ms host_ms unsteady memory driver_memory asset_size "
    "flicker flicker_worst holes train_seconds train_memory chamfer psnr_16 faces bake_seconds tasks "
    "vf_ratio mean_valence "
    "boundary_edge_ratio nonmanifold_edge_ratio nonmanifold_vertex_ratio lcc_face_ratio lcc_area_ratio "
    "components".split()
)
# Required types of the fields in another package's metric.
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
    """Return a mapping from key to metric."""
    places = (place.split(".") for place in BUILT_IN)
    metrics = (getattr(import_module(f"msb.metrics.{module}"), name) for module, name in places)
    ours: dict[str, ImageMetric] = {metric.key: metric for metric in metrics}
    taken = dict.fromkeys([*ours, ours["lpips"].name, CHAMFER.name], "msb.metrics")
    theirs = find_installed("metric", taken, _load_package_metric)
    return ours | {key: metric for key, (metric, _) in theirs.items()}


def _load_package_metric(key: str, entry: str) -> ImageMetric:
    metric = load(entry)
    if not isinstance(metric, ImageMetric):
        raise PackageError(f"it must be an ImageMetric, not of type {type(metric).__name__}")
    if key in RESERVED:
        raise PackageError("its key is reserved for records or tables")
    if not metric.key == metric.name == key:
        raise PackageError(f"its name and key must equal the name of its entry point, {key}")
    for name, kind in _FIELDS.items():
        if not isinstance(value := getattr(metric, name), kind):
            raise PackageError(f"its {name} has the invalid type {type(value).__name__}")
    if metric.better not in ("higher", "lower"):
        raise PackageError(f'its better is {shorten(repr(metric.better))}; it must be "higher" or "lower"')
    measure = _PackageMeasure(describe_entry("metric", key, entry), metric.measure)
    return replace(metric, measure=measure, modules=())


@dataclass(frozen=True)
class _PackageMeasure:
    """Return the function of a metric from another package.

    Error messages of the returned function name the package.
    """

    whose: str
    measure: Any

    def __call__(self, rendering: Pixels, ground_truth: Pixels) -> float:
        try:
            with contain_errors():
                value = self.measure(rendering.copy(), ground_truth.copy())
                number = math.nan if isinstance(value, bool | str | bytes) else float(value)
        except (PackageError, MetricError) as error:
            raise MetricError("METRIC_FAILED", f"{self.whose} fails: {error}") from error
        if not math.isfinite(number):
            text = f"{self.whose} returned {shorten(repr(value), 60)}; it must return a finite number"
            raise MetricError("METRIC_FAILED", text)
        return number


# The metrics by their key in records, tables and JSON. Built-in metrics come first, in the order of tables.
IMAGE_METRICS: Mapping[str, ImageMetric] = Lazy(_installed)


def _list_by_name() -> dict[str, Definition]:
    return {metric.name: metric for metric in (*IMAGE_METRICS.values(), CHAMFER)}


# For the name of every metric, the better direction: "higher" or "lower".
METRICS: Mapping[str, str] = Lazy(lambda: {name: metric.better for name, metric in _list_by_name().items()})


def identity(
    name: str, *, weights: Mapping[str, Any] | None = None, **parameters: str | float | bool | None
) -> Identity:
    """Return the identity of a value of the metric `name` computed now.

    Parameters
    ----------
    name : str
        A key of `METRICS`.
    weights : mapping, optional
        The record `LpipsVgg.weights`, for LPIPS only; passed by `LpipsVgg.identity`.
    **parameters
        Parameters chosen for this computation, such as ``quantize=False`` or ``seed=3``.

    Raises
    ------
    MetricError
        METRIC_ARGUMENT: unknown metric.
    """
    known = _list_by_name()
    if name not in tuple(known):
        raise MetricError("METRIC_ARGUMENT", f"unknown metric '{name}'; use one of {', '.join(known)}")
    return known[name].identity(weights=weights, **parameters)


class Measures:
    """Computes all image metrics of two images: ``Measures(vgg_weights)(pred, gt)``.

    Metrics that need VGG weights are None if the weights are missing.

    Attributes
    ----------
    identities : tuple of Identity
        Identities of the metrics that are computed.
    warnings : tuple of Finding
        Warnings about the weights.
    failed : dict of str to str
        For the key of each failed metric of another package, its first error with the error code.
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
                warnings += [warning for warning in network.warnings if warning not in warnings]
        self.identities: tuple[Identity, ...] = tuple(identities)
        self.warnings: tuple[Finding, ...] = tuple(warnings)
        self.failed: dict[str, str] = {}

    def __call__(self, pred: ArrayLike, gt: ArrayLike) -> dict[str, float | None]:
        """Return a mapping from the key of each metric to its value. The two images have a form that `psnr`
        accepts.

        A metric's value is None if its weights are missing or its package failed.
        """
        a, b = check_pair(pred, gt)
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
    """Return the average of a metric over images. If a value is missing, return None.

    An infinite PSNR is replaced by `PSNR_CAP`.
    """
    capped = [PSNR_CAP if value == math.inf else value for value in values]
    known = [value for value in capped if value is not None]
    return math.fsum(known) / len(known) if known and len(known) == len(capped) else None

"""The image metrics, one line each. Records, commands, gaps and tables read them here."""

from __future__ import annotations

import math
from importlib import import_module
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from msb.errors import MetricError
from msb.metrics.chamfer import CHAMFER
from msb.metrics.images import PSNR_CAP, image_pair

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from numpy.typing import ArrayLike

    from msb.errors import Finding
    from msb.metrics.identity import Definition, Identity, ImageMetric

BUILT_IN = (
    "images.PSNR",
    "images.SSIM",
    "perceptual.LPIPS",
)
"""Module here and name of every image metric, in the order of the tables."""


def _declared(place: str) -> ImageMetric:
    module, _, name = place.partition(".")
    found: ImageMetric = getattr(import_module(f"msb.metrics.{module}"), name)
    return found


IMAGE_METRICS: Mapping[str, ImageMetric] = MappingProxyType(
    {metric.key: metric for metric in map(_declared, BUILT_IN)}
)
"""Key in records, tables and JSON -> metric."""
_BY_NAME: dict[str, Definition] = {each.name: each for each in (*IMAGE_METRICS.values(), CHAMFER)}
METRICS: Mapping[str, str] = MappingProxyType({name: each.better for name, each in _BY_NAME.items()})
"""Name of every metric -> whether "higher" or "lower" is better."""


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
    if name not in _BY_NAME:
        raise MetricError("METRIC_ARGUMENT", f"there is no metric '{name}'; there are {', '.join(_BY_NAME)}")
    return _BY_NAME[name].identity(weights=weights, **parameters)


class Measures:
    """All image metrics of two images at once: ``Measures(vgg_weights)(pred, gt)``.

    Parameters
    ----------
    vgg_weights : Path, optional
        The file of weights, as for `lpips_vgg`; without it metrics that need weights are None.

    Attributes
    ----------
    identities : tuple of Identity
        The identities of the metrics that are computed.
    warnings : tuple of Finding
        Warnings about the weights.

    Raises
    ------
    UsageError, InputError, MetricError
        The weights cannot be used.
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
        self.warnings: tuple[Finding, ...] = tuple(warnings)

    def __call__(self, pred: ArrayLike, gt: ArrayLike) -> dict[str, float | None]:
        """Return key -> value of two images as `psnr` takes them, None where weights are missing.

        Raises
        ------
        UsageError
            EXTRA_MISSING.
        MetricError
            Those of the metrics.
        """
        a, b = image_pair(pred, gt)
        return {
            key: None if function is None else function(a, b) for key, function in self._functions.items()
        }


def modules_needed() -> tuple[str, ...]:
    """Return the modules of the extra `bench` that the image metrics import."""
    return tuple(dict.fromkeys(name for metric in IMAGE_METRICS.values() for name in metric.modules))


def mean_of(values: Iterable[float | None]) -> float | None:
    """Return the mean of the images' values; None if one has no value. Infinite values count `PSNR_CAP`."""
    found = list(values)
    known = [PSNR_CAP if value == math.inf else value for value in found if value is not None]
    return math.fsum(known) / len(known) if known and len(known) == len(found) else None

"""What a number is: the metric's name, the version of its definition, libraries, parameters and weights."""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from msb.errors import MetricError

if TYPE_CHECKING:
    from collections.abc import Mapping

INPUT_RULE = "clamp to [0, 1], floor(255 x + 0.5) / 255"
"""What is done to both images before any image metric; bytes are taken as they are."""


@dataclass(frozen=True)
class Identity:
    """What has to be stored beside a number so that it can be compared with another.

    Attributes
    ----------
    name : str
        A key of `METRICS`.
    version : int
        Of the definition here. It is raised when the same input would give another number.
    better : {"higher", "lower"}
        Which way is better.
    unit : str
        "dB", "mm" or "1".
    parameters : mapping
        Everything the definition leaves open.
    libraries : mapping
        Package -> version, of those whose arithmetic is in the number.
    weights : mapping, optional
        Hashes of the network's files.
    """

    name: str
    version: int
    better: str
    unit: str
    parameters: Mapping[str, Any]
    libraries: Mapping[str, str | None] = field(default_factory=dict)
    weights: Mapping[str, Any] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the record as plain JSON data."""
        plain = {"name": self.name, "version": self.version, "better": self.better, "unit": self.unit}
        weights = None if self.weights is None else dict(self.weights)
        return {
            **plain,
            "parameters": dict(self.parameters),
            "libraries": dict(self.libraries),
            "weights": weights,
        }


_SSIM = {
    "window": "gaussian 11 x 11, sigma 1.5",
    "border": "zero padding 5",
    "K1": 0.01,
    "K2": 0.03,
    "covariance": "population, not clipped",
    "channels": "mean",
    "precision": "float64",
}
_LPIPS = {
    "lpips_version": "0.1",
    "network": "vgg16",
    "input_range": "[-1, 1]",
    "spatial": "mean",
    "precision": "float32",
}
_CHAMFER = {
    "density_mm": 0.2,
    "patch_mm": 60.0,
    "max_distance_mm": 20.0,
    "thinning": "greedy, in shuffled order",
    "generator": "numpy.random.default_rng(seed).shuffle",
}
_KINDS: dict[str, tuple[int, str, str, dict[str, Any], tuple[str, ...]]] = {
    "psnr": (1, "higher", "dB", {"peak": 1.0, "mse": "all pixels and channels"}, ("numpy",)),
    "ssim": (1, "higher", "1", _SSIM, ("numpy", "scipy", "scikit-image")),
    "lpips_vgg": (1, "lower", "1", _LPIPS, ("numpy", "torch", "lpips")),
    "chamfer_dtu": (1, "lower", "mm", _CHAMFER, ("numpy", "scipy")),
}
METRICS: Mapping[str, str] = MappingProxyType({name: kind[1] for name, kind in _KINDS.items()})
"""Every metric there is, and whether "higher" or "lower" is better."""


def identity(
    name: str, *, weights: Mapping[str, Any] | None = None, **parameters: str | float | bool | None
) -> Identity:
    """Return the identity of the metric `name` as it is computed here and now.

    Parameters
    ----------
    name : str
        A key of `METRICS`.
    weights : mapping, optional
        For LPIPS: `LpipsVgg.weights`, whose own `identity` fills it in.
    **parameters
        What this computation chose: ``quantize=False``, ``seed=3``.

    Raises
    ------
    MetricError
        METRIC_ARGUMENT: there is no such metric.
    """
    if name not in _KINDS:
        raise MetricError("METRIC_ARGUMENT", f"there is no metric '{name}'; there are {', '.join(_KINDS)}")
    number, better, unit, fixed, packages = _KINDS[name]
    chosen: dict[str, Any] = {**fixed, **parameters}
    if name != "chamfer_dtu":
        quantize = chosen.pop("quantize", True)
        chosen = {"input": INPUT_RULE if quantize else "clamp to [0, 1]", **chosen}
    libraries = {package: package_version(package) for package in packages}
    return Identity(name, number, better, unit, chosen, libraries, weights)


def package_version(package: str) -> str | None:
    """Return the installed version of `package`, or None."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None

"""Definitions of metrics, and identities of values: definition, library versions and weight hashes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from msb.errors import Finding

# An image (H, W, 3) in [0, 1].
Pixels = NDArray[np.float64]

# Rounding rule for the floats of both images, used by every image metric. Images of bytes are not rounded.
INPUT_RULE = "clamp to [0, 1], floor(255 x + 0.5) / 255"


@dataclass(frozen=True)
class Identity:
    """The data to store beside a value so that it can be compared with other values.

    An identity consists of the metric's `Definition`, the versions of its libraries and the hashes of its
    weights.
    """

    name: str
    version: int
    better: str
    unit: str
    parameters: Mapping[str, Any]
    libraries: Mapping[str, str | None] = field(default_factory=dict)
    weights: Mapping[str, Any] | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the identity as plain JSON data."""
        return {
            key: dict(value) if isinstance(value, Mapping) else value for key, value in vars(self).items()
        }


def defined(identity: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of an identity that defines the metric. Versions of libraries are omitted."""
    return {key: value for key, value in identity.items() if key != "libraries"}


@dataclass(frozen=True)
class Definition:
    """The definition of a metric, independent of its input."""

    # The metric's name in identities.
    name: str
    better: Literal["higher", "lower"]
    # The unit of values: "dB", "mm" or "1".
    unit: str
    # All parameters of the metric's definition.
    parameters: Mapping[str, Any]
    # Packages whose arithmetic affects the value. The versions of these packages are recorded.
    libraries: tuple[str, ...]
    # Increase this number when a code change alters the values.
    version: int = 1

    def identity(
        self, *, weights: Mapping[str, Any] | None = None, **chosen: str | float | bool | None
    ) -> Identity:
        """Return the identity of a value computed now. The arguments `chosen` override the parameters."""
        packages = {package: package_version(package) for package in self.libraries}
        parameters = {**self.parameters, **chosen}
        return Identity(self.name, self.version, self.better, self.unit, parameters, packages, weights)


class Network(Protocol):
    """A metric with loaded weights."""

    # Record of the weights for the identity.
    weights: dict[str, Any]
    warnings: tuple[Finding, ...]

    def __call__(self, pred: Pixels, gt: Pixels, /) -> float: ...


@dataclass(frozen=True, kw_only=True)
class ImageMetric(Definition):
    """A metric of two images, declared by its module.

    A metric is registered by a line of `msb.metrics.registry`, or by an entry point of its package (group
    `msb.metrics`).

    Attributes
    ----------
    key : str
        The key in records, tables and JSON, such as "psnr".
    title : str
        The heading of its column, without unit: "PSNR".
    decimals : int
        Number of printed decimals.
    equal : float
        The value for equal images. All values are finite except the PSNR of equal images.
    measure : callable, optional
        A function of rendering and ground truth that returns the value. Both images are (H, W, 3) float64 in
        [0, 1], of equal size and rounded according to `INPUT_RULE`.
    load : callable, optional
        A replacement of `measure` for metrics with VGG weights. The function loads a weight file and returns
        a network with the signature of `measure`.
    modules : tuple of str
        Modules of the extra `bench` that the metric imports.
    """

    key: str
    title: str
    decimals: int
    equal: float
    measure: Callable[[Pixels, Pixels], float] | None = None
    load: Callable[[Path], Network] | None = None
    modules: tuple[str, ...] = ()

    def identity(
        self,
        *,
        weights: Mapping[str, Any] | None = None,
        quantize: bool | str | float | None = True,
        **chosen: str | float | bool | None,
    ) -> Identity:
        """Return the identity of a value (class `Definition`).

        Set `quantize` if floats are rounded to 8 bits.
        """
        plain = super().identity(weights=weights, **chosen)
        rule = INPUT_RULE if quantize else "clamp to [0, 1]"
        return replace(plain, parameters={"input": rule, **plain.parameters})


def package_version(package: str) -> str | None:
    """Return the installed version of `package`, or None."""
    try:
        return version(package)
    except PackageNotFoundError:
        return None

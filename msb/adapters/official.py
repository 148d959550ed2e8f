"""Write an asset as the mesh file that the official exporter of its method would write.

The exporter's file differs from the standard-tier mesh. Some exporters keep alpha, evaluate SH in a fixed
direction, merge vertices or write every face twice. Tests compare the results with files of the official
code.
"""

import os
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.errors import Unsupported, UsageError
from msb.registry import lookup, role, with_role


class Official(Protocol):
    """The required contents of a method's module `official`."""

    # File suffixes of the exporter; "" means a folder.
    SUFFIXES: tuple[str, ...]

    def write(self, asset: Asset, path: Path) -> None:
        """Write the asset to `path`, which has one of these suffixes."""


def write_official(asset: Asset, path: str | os.PathLike[str]) -> None:
    """Write `asset` to `path` like the official exporter of its method."""
    exporter, path = official_exporter(asset.manifest.method), Path(path)
    suffix = path.suffix.lower()
    if suffix not in exporter.SUFFIXES:
        wanted = " or ".join(name or "a folder" for name in exporter.SUFFIXES)
        text = f"the exporter of {asset.manifest.method} writes {wanted}, but OUT is {path.name}"
        raise UsageError("NAME_UNKNOWN", text, file=path)
    exporter.write(asset, path)


def official_exporter(method: str) -> Official:
    """Return the module that implements the official exporter of `method`."""
    exporter: Any = role(method, "official")
    if exporter is None:
        names = ", ".join(name for name, _ in with_role("official"))
        text = f"{lookup(method).title} has no official exporter; methods with an exporter: {names}"
        raise Unsupported("UNSUPPORTED_METHOD", text)
    return cast("Official", exporter)


def rounded_bytes(colors: NDArray[Any]) -> NDArray[np.uint8]:
    """Return colours in [0, 1] as bytes, rounded half to even."""
    return np.round(colors.astype(np.float64) * 255).astype(np.uint8)

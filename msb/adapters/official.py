"""What each method's own exporter writes, made from an asset.

These files differ from the standard tier on purpose: some exporters keep an alpha, evaluate SH in a fixed
direction, merge vertices or write every face twice. Tests compare with files that the official code wrote.
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
    """The members that a method's module `official` has."""

    # The suffixes of the files that the exporter writes; "" stands for a folder.
    SUFFIXES: tuple[str, ...]

    def write(self, asset: Asset, path: Path) -> None:
        """Write the asset to `path`, which has one of these suffixes."""


def write_official(asset: Asset, path: str | os.PathLike[str]) -> None:
    """Write `asset` to `path` as the method's own exporter would."""
    exporter, path = official_exporter(asset.manifest.method), Path(path)
    suffix = path.suffix.lower()
    if suffix not in exporter.SUFFIXES:
        wanted = " or ".join(name or "a folder" for name in exporter.SUFFIXES)
        text = f"the exporter of {asset.manifest.method} writes {wanted}; OUT is {path.name}"
        raise UsageError("NAME_UNKNOWN", text, file=path)
    exporter.write(asset, path)


def official_exporter(method: str) -> Official:
    """Return the module that writes as the exporter of `method` does."""
    exporter: Any = role(method, "official")
    if exporter is None:
        names = ", ".join(name for name, _ in with_role("official"))
        text = f"{lookup(method).title} has no exporter of its own for such an asset; {names} have"
        raise Unsupported("UNSUPPORTED_METHOD", text)
    return cast("Official", exporter)


def rounded_bytes(colors: NDArray[Any]) -> NDArray[np.uint8]:
    """Return colours in [0, 1] as bytes, rounded half to even."""
    return np.round(colors.astype(np.float64) * 255).astype(np.uint8)

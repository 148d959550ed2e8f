"""Interface of the engines, and the image that an engine returns."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from benchmarks.opened_in.scenes import Scene

ENGINES = Path(__file__).parent.parent.parent / ".engines"
"""Folder of the npm and PyPI packages that `make engines` installs."""
NOT_INSTALLED = "not installed; run make engines"


class Shown(NamedTuple):
    """An image (H, W, 3), the version of the engine, and the device it used."""

    image: NDArray[np.uint8]
    by: str


class Engine(Protocol):
    """An engine that opens a file with default settings, or (`mended`) with corrected colour settings."""

    def missing(self) -> str | None:
        """Return the reason why the engine cannot run here, or None."""

    def draw(self, glb: bytes, scene: Scene, *, mended: bool) -> Shown:
        """Return the engine's image of a file."""

"""What an engine is, here, and what it made of a file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from benchmarks.opened_in.scenes import Scene

ENGINES = Path(__file__).parent.parent.parent / ".engines"
"""Where `make engines` puts what it takes from npm and PyPI."""
NOT_INSTALLED = "not installed: make engines"


class Shown(NamedTuple):
    """A picture (H, W, 3), and who drew it: version, and what it drew on."""

    image: NDArray[np.uint8]
    by: str


class Engine(Protocol):
    """An engine that opens a file as it comes, or `mended`: with what a user can set for its colours."""

    def missing(self) -> str | None:
        """Return why it cannot draw here, or None."""

    def draw(self, glb: bytes, scene: Scene, *, mended: bool) -> Shown:
        """Return what it shows of a file."""

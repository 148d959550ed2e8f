"""The reference as a renderer among the others: tier "reference"."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np

from msb._version import __version__
from msb.reference import ReferenceFrame, render_reference

if TYPE_CHECKING:
    from collections.abc import Mapping

    from msb.asset import Asset
    from msb.scenes import Camera


class ReferenceRenderer:
    """NumPy, on the host: `device` is taken and ignored.

    Parameters
    ----------
    asset, settings
        As for `render_reference`.
    dtype : "float32" or "float64"
        float32 repeats the official order of operations.
    """

    name = "msb-reference"
    version = __version__

    def __init__(
        self,
        asset: Asset,
        *,
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        dtype: str = "float32",
    ) -> None:
        self._asset, self._settings = asset, settings
        self._dtype: type[Any] = np.dtype(dtype).type

    def render(self, camera: Camera, background: tuple[float, float, float]) -> ReferenceFrame:
        """Draw the asset from `camera` over `background`; `timings` has the time NumPy took."""
        start = time.perf_counter()
        frame = render_reference(self._asset, camera, background, self._settings, self._dtype)
        frame.timings["numpy"] = 1000 * (time.perf_counter() - start)
        return frame

    def memory(self) -> Mapping[str, int]:
        """Return nothing: there is no device."""
        return {}

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

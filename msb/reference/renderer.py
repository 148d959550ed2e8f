"""The reference as a renderer among the others: tier "reference"."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from msb.asset.settings import check_modes
from msb.base.version import __version__
from msb.reference import ReferenceFrame, precision, render_reference

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.registry import Order, Sampling
    from msb.scenes import Camera


class ReferenceRenderer:
    """NumPy, on the host: `device` is taken and ignored, the rest is as for `render_reference`."""

    name = "msb-reference"
    version = __version__

    def __init__(
        self,
        asset: Asset,
        *,
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        dtype: str = "float32",
        order: Order = "tile",
        sampling: Sampling = "official",
    ) -> None:
        check_modes(order, sampling)
        self._asset, self._settings = asset, settings
        self._order, self._sampling = order, sampling
        self._dtype = precision(dtype)

    def render(self, camera: Camera, background: tuple[float, float, float]) -> ReferenceFrame:
        """Draw the asset from `camera` over `background`; `timings` has the time NumPy took."""
        start = time.perf_counter()
        frame = render_reference(
            self._asset,
            camera,
            background,
            self._settings,
            self._dtype,
            order=self._order,
            sampling=self._sampling,
        )
        frame.timings["numpy"] = 1000 * (time.perf_counter() - start)
        return frame

    def memory(self) -> Mapping[str, int]:
        """Return nothing: there is no device."""
        return {}

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

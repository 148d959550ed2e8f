"""The common parts of the engines: options, supersampling, how a frame is put together, what is missing."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from msb.engines.mesh import engine_mesh
from msb.errors import UsageError, shorten
from msb.render.frame import Frame
from msb.render.standard.supersampling import box_filter, checked_supersample, enlarged

if TYPE_CHECKING:
    from msb.asset import Asset
    from msb.render.backend import Drawn
    from msb.scenes import Camera

    Color = tuple[float, float, float]

NEAR = 0.01
"""The depth of the near plane of the standard tier; there is no far plane."""
WALL_CLOCK = "draw (wall clock)"
"""The stage of an engine that cannot say how long its device took: how long we waited for it."""
DRAW = "draw"
"""The stage of an engine whose device keeps time."""

_GROUPS = {
    **dict.fromkeys(("positions", "indices"), "geometry"),
    "vertex colors": "appearance",
    **dict.fromkeys(("image", "depth", "face ids"), "targets"),
}


class Engine(ABC):
    """A foreign engine as a renderer: draws the standard-tier mesh of an asset.

    Parameters
    ----------
    asset : Asset
    device : {"cpu", "gpu"}, optional
        Where the engine computes; its own choice if not given. An engine ignores OpenCL devices and
        MSB_DEVICE.
    settings : mapping, optional
        Overrides of the asset's settings; `ste_threshold` hides faces where the method has it.
    supersample : int
        As for the standard tier.
    """

    name: ClassVar[str]
    tiers: ClassVar[tuple[str, ...]] = ("standard",)
    version: str
    device_info: Mapping[str, str]
    """The `platform` and `name` of what draws, for reports."""

    def __init__(
        self,
        asset: Asset,
        *,
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        supersample: int = 1,
    ) -> None:
        self._kind = device_kind(device, self.name)
        self._samples = checked_supersample(supersample)
        missing = self.missing()
        if missing is not None:
            raise UsageError("ENGINE_MISSING", f"renderer {self.name}: {missing}")
        self._mesh = engine_mesh(asset, settings)

    @classmethod
    @abstractmethod
    def missing(cls) -> str | None:
        """Return what has to be installed before this can draw, or None; no engine is started to find out."""

    @classmethod
    @abstractmethod
    def installed(cls) -> str:
        """Return the version that would draw, "" where none would; no engine is started to find out."""

    @abstractmethod
    def _frame(self, camera: Camera, background: Color) -> Frame:
        """Return one frame, one sample a pixel."""

    @abstractmethod
    def _draw(self, camera: Camera, background: Color) -> Drawn:
        """Draw and wait, reading nothing back."""

    @abstractmethod
    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes."""

    def memory_groups(self) -> Mapping[str, str]:
        """Return use -> group, for the uses that engines have in common."""
        return _GROUPS

    @abstractmethod
    def close(self) -> None:
        """Release everything. A second call does nothing."""

    def render(self, camera: Camera, background: Color) -> Frame:
        """Draw the asset from `camera` over `background` (RGB, in the asset's colour space)."""
        frame = self._frame(enlarged(camera, self._samples), background)
        if self._samples == 1:
            return frame
        return replace(box_filter(frame, self._samples), timings=frame.timings)

    def draw(self, camera: Camera, background: Color) -> Drawn:
        """Draw and wait, reading nothing back."""
        return self._draw(enlarged(camera, self._samples), background)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def device_kind(device: Any, name: str) -> str | None:
    """Return "cpu", "gpu" or None (the engine's own choice)."""
    if device is None or device in ("cpu", "gpu"):
        return device  # type: ignore[no-any-return]
    shown = shorten(str(device), 40)
    text = f'device "{shown}" is one of OpenCL; renderer {name} takes cpu or gpu, or chooses itself'
    raise UsageError("DEVICE_SELECTOR", text)


def opaque_frame(
    image: NDArray[np.float32],
    hit: NDArray[np.bool_],
    depth: NDArray[np.float32],
    background: Color,
    face_id: NDArray[np.int32] | None,
    timings: Mapping[str, float],
) -> Frame:
    """Return a frame in our terms: `background` and depth 0 wherever `hit` (H, W) is false."""
    return Frame(
        image=np.where(hit[..., None], image, np.array(background, np.float32)),
        alpha=hit.astype(np.float32),
        depth=np.where(hit, depth, np.float32(0)),
        face_id=face_id,
        timings=dict(timings),
    )

"""A renderer's device: opened for it or lent to it, with what the renderer keeps there."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.cl import Device, open_device
from msb.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from msb.cl import Buffer


class Tenancy:
    """What one renderer has on a device.

    Parameters
    ----------
    device : str or Device, optional
        As for `msb.cl.open_device`; an open device is used and left open.
    name : str
        First word of the names of scratch buffers, which renderers of one name that share a device share.

    Attributes
    ----------
    device : Device
    kept : dict of str to Buffer
        What stays from frame to frame, by use.

    Raises
    ------
    UsageError, DeviceError
        As `msb.cl.open_device`.
    """

    def __init__(self, device: str | Device | None, name: str) -> None:
        self._name = name
        self._own = not isinstance(device, Device)
        self.device = device if isinstance(device, Device) else open_device(device)
        self.kept: dict[str, Buffer] = {}

    def keep(self, use: str, array: NDArray[Any]) -> None:
        """Upload what stays from frame to frame."""
        self.kept[use] = self.device.upload(array, use)

    def scratch(self, name: str, shape: int | tuple[int, ...], dtype: Any = np.float32) -> Buffer:
        """Return a buffer of undefined content, whose memory is used again from frame to frame."""
        return self.device.scratch(f"{self._name} {name}", shape, dtype)

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes on the device; of a device that was lent, only what is ours."""
        held = self.device.memory()
        if self._own:
            return held
        kept = {use: buffer.nbytes for use, buffer in self.kept.items()}
        return kept | {use: nbytes for use, nbytes in held.items() if use.startswith(f"{self._name} ")}

    def close(self) -> None:
        """Release what is kept; a device that was lent stays open, and so do its scratch buffers."""
        with contextlib.suppress(DeviceError):  # closed, or lost
            self.device.finish()  # buffers may be on memory of the host
        for buffer in self.kept.values():
            buffer.release()
        self.kept.clear()
        if self._own:
            self.device.close()

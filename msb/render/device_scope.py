"""A renderer's place on a device that it shares with others."""

from __future__ import annotations

import contextlib
import functools
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from msb.cl import Device, shared_device
from msb.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from contextlib import AbstractContextManager

    from numpy.typing import NDArray

    from msb.cl import Buffer
    from msb.render.backend import Group


class DeviceScope:
    """What one renderer has on a device that others use, too.

    Commands go into blocks of `turn`, or methods that are `in_turn`: other threads wait meanwhile, and what
    is allocated there is the renderer's own.

    Parameters
    ----------
    device : str or Device, optional
        As for `msb.cl.shared_device`, by which everything in a process draws on one device; or one that the
        caller has opened.
    name : str
        First word of the names of scratch buffers.

    Attributes
    ----------
    device : Device
    kept : dict of str to Buffer
        What stays from frame to frame, by use.

    Raises
    ------
    UsageError, DeviceError
        As `msb.cl.shared_device`.
    """

    def __init__(self, device: str | Device | None, name: str) -> None:
        self._name = name
        self.device = device if isinstance(device, Device) else shared_device(device)
        self._memory = self.device.new_memory()
        self.kept: dict[str, Buffer] = {}
        self._closed = False

    def turn(self) -> AbstractContextManager[None]:
        """Return a block that has the device alone; blocks of one thread nest.

        Raises
        ------
        DeviceError
            `DEVICE_CLOSED`, after `close`.
        """
        if self._closed:
            raise DeviceError("DEVICE_CLOSED", f"the renderer was closed (on {self.device.record})")
        return self.device.using(self._memory)

    @contextlib.contextmanager
    def setting_up(self) -> Iterator[None]:
        """Have the device alone for a block that leaves nothing there if it fails."""
        with self.turn():
            try:
                yield
            except BaseException:
                self.close()
                raise

    def keep(self, use: str, array: NDArray[Any], group: Group = "geometry") -> None:
        """Upload what stays from frame to frame."""
        self.kept[use] = self.device.upload(array, use, group)

    def scratch(
        self, name: str, shape: int | tuple[int, ...], dtype: Any = np.float32, group: Group = "scratch"
    ) -> Buffer:
        """Return a buffer of undefined content, whose memory is used again from frame to frame."""
        return self.device.scratch(f"{self._name} {name}", shape, dtype, group)

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes on the device for this renderer."""
        return self._memory.by_use()

    def memory_groups(self) -> Mapping[str, str]:
        """Return use -> the group it is of, as it was given where the buffer was made."""
        return self._memory.groups()

    def close(self) -> None:
        """Release everything of the renderer's; the device stays open. Twice is harmless."""
        with self.device.using(self._memory):
            self._closed = True
            with contextlib.suppress(DeviceError):  # closed, or lost
                self.device.finish()  # buffers may be on memory of the host
            self.kept.clear()
            self._memory.release_all()


class OnDevice:
    """What every renderer in OpenCL does by its scope, which its constructor makes."""

    _scope: DeviceScope

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes on the device for this renderer."""
        return self._scope.memory()

    def memory_groups(self) -> Mapping[str, str]:
        """Return use -> group of what `memory` names."""
        return self._scope.memory_groups()

    def close(self) -> None:
        """Release everything; the device stays open."""
        self._scope.close()


S = TypeVar("S", bound=OnDevice)
P = ParamSpec("P")
R = TypeVar("R")


def in_turn(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Make a method of a renderer one block of `turn`."""

    @functools.wraps(method)
    def taking_turns(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        with self._scope.turn():
            return method(self, *args, **kwargs)

    return taking_turns

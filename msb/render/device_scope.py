"""The buffers and commands of one renderer on a device that it shares with other renderers."""

import contextlib
import functools
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from msb.cl import Buffer, Device, shared_device
from msb.errors import DeviceError
from msb.render.backend import Group


class DeviceScope:
    """Gives a renderer separately counted memory, and exclusive access to a shared device.

    Parameters
    ----------
    device : str or Device, optional
        A selector for `msb.cl.shared_device`, which opens one device for the whole process, or a device
        opened by the caller.
    name : str
        Prefix of the names of scratch buffers.

    Attributes
    ----------
    kept : dict of str to Buffer
        For each purpose, the buffer that stays on the device from frame to frame.

    Notes
    -----
    Queue commands only in a ``with`` block of `turn`, or in a method decorated with `in_turn`. Other threads
    wait until the block ends. Memory that is allocated in the block belongs to this renderer.
    """

    def __init__(self, device: str | Device | None, name: str) -> None:
        self._name = name
        self.device = device if isinstance(device, Device) else shared_device(device)
        self._memory = self.device.new_memory()
        self.kept: dict[str, Buffer] = {}
        self._closed = False

    def turn(self) -> AbstractContextManager[None]:
        """Return a context manager that gives exclusive access to the device. The context managers of one
        thread may be nested."""
        if self._closed:
            raise DeviceError("DEVICE_CLOSED", f"the renderer was closed (on {self.device.record})")
        return self.device.using(self._memory)

    @contextlib.contextmanager
    def setting_up(self) -> Iterator[None]:
        """Give exclusive access during construction, and release all memory if the construction fails."""
        with self.turn():
            try:
                yield
            except BaseException:
                self.close()
                raise

    def keep(self, use: str, array: NDArray[Any], group: Group = "geometry") -> None:
        """Upload an array that stays on the device from frame to frame."""
        self.kept[use] = self.device.upload(array, use, group)

    def scratch(
        self, name: str, shape: int | tuple[int, ...], dtype: Any = np.float32, group: Group = "scratch"
    ) -> Buffer:
        """Return a buffer with undefined content, whose memory the next frame reuses."""
        return self.device.scratch(f"{self._name} {name}", shape, dtype, group)

    def memory(self) -> Mapping[str, int]:
        """Return the bytes of device memory that this renderer holds, by purpose."""
        return self._memory.by_use()

    def memory_groups(self) -> Mapping[str, str]:
        """Return the `Group` of each purpose, as given when its buffer was allocated."""
        return self._memory.groups()

    def close(self) -> None:
        """Release everything that the renderer holds; the device stays open. A second call of `close` has
        no effect."""
        with self.device.using(self._memory):
            self._closed = True
            with contextlib.suppress(DeviceError):  # the device was closed, or it failed
                self.device.finish()  # buffers may use memory of the host
            self.kept.clear()
            self._memory.release_all()


class OnDevice:
    """Base class of renderers in OpenCL: the methods that only call the renderer's `DeviceScope`."""

    _scope: DeviceScope

    def memory(self) -> Mapping[str, int]:
        """Return the bytes of device memory that this renderer holds, by purpose."""
        return self._scope.memory()

    def memory_groups(self) -> Mapping[str, str]:
        """Return the `Group` of each purpose in `memory`."""
        return self._scope.memory_groups()

    def close(self) -> None:
        """Release all memory; the device stays open."""
        self._scope.close()


S = TypeVar("S", bound=OnDevice)
P = ParamSpec("P")
R = TypeVar("R")


def in_turn(method: Callable[Concatenate[S, P], R]) -> Callable[Concatenate[S, P], R]:
    """Run a method of a renderer with exclusive access to its device (`DeviceScope.turn`)."""

    @functools.wraps(method)
    def run_in_turn(self: S, /, *args: P.args, **kwargs: P.kwargs) -> R:
        with self._scope.turn():
            return method(self, *args, **kwargs)

    return run_in_turn

"""A renderer's place on a device that it shares with others."""

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
    """The buffers and commands of one renderer on a device that other renderers use, too.

    Commands go into blocks of `turn`, or methods that are `in_turn`: other threads wait meanwhile, and what
    is allocated there is the renderer's own. `device` is a selector as for `msb.cl.shared_device`, by which
    everything in a process draws on one device, or a device that the caller has opened; the names of scratch
    buffers begin with `name`. `kept` has the buffers that stay from frame to frame, by use.
    """

    def __init__(self, device: str | Device | None, name: str) -> None:
        self._name = name
        self.device = device if isinstance(device, Device) else shared_device(device)
        self._memory = self.device.new_memory()
        self.kept: dict[str, Buffer] = {}
        self._closed = False

    def turn(self) -> AbstractContextManager[None]:
        """Return a block that has the device alone; blocks of one thread nest."""
        if self._closed:
            raise DeviceError("DEVICE_CLOSED", f"the renderer was closed (on {self.device.record})")
        return self.device.using(self._memory)

    @contextlib.contextmanager
    def setting_up(self) -> Iterator[None]:
        """Have the device alone for a block; if the block fails, nothing of it stays on the device."""
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
        """Return a buffer of undefined content, whose memory is used again from frame to frame."""
        return self.device.scratch(f"{self._name} {name}", shape, dtype, group)

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes on the device for this renderer."""
        return self._memory.by_use()

    def memory_groups(self) -> Mapping[str, str]:
        """Return use -> the group that was given where the buffer was made."""
        return self._memory.groups()

    def close(self) -> None:
        """Release everything that the renderer holds; the device stays open. A second call does nothing."""
        with self.device.using(self._memory):
            self._closed = True
            with contextlib.suppress(DeviceError):  # closed, or lost
                self.device.finish()  # buffers may be on memory of the host
            self.kept.clear()
            self._memory.release_all()


class OnDevice:
    """The methods that every renderer in OpenCL leaves to its scope, which its constructor makes."""

    _scope: DeviceScope

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes on the device for this renderer."""
        return self._scope.memory()

    def memory_groups(self) -> Mapping[str, str]:
        """Return use -> group, for the uses that `memory` names."""
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

"""Context and in-order queue of an open device. Every command of the device passes through this queue."""

from __future__ import annotations

import contextlib
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from msb.errors import DeviceError, shorten

if TYPE_CHECKING:
    from msb.cl.buffers import Allocation
    from msb.cl.records import DeviceRecord
    from msb.cl.timing import Timing


class Queue:
    """The part of an open device that buffers and kernels need: pyopencl, its device, context and queue.

    `timing`, if set, receives the event of every command. The counter `allocations` belongs to all users of
    the device.
    """

    def __init__(self, cl: Any, handle: Any, record: DeviceRecord) -> None:
        self.cl = cl
        self.handle = handle
        self.record = record
        self.timing: Timing | None = None
        self.allocations: weakref.WeakSet[Allocation] = weakref.WeakSet()
        # Whether a command failed for another reason than a lack of memory. Some platforms reject all
        # commands after a failed command.
        self.failed = False
        self._queue: Any = None
        try:
            self._context = cl.Context([handle])
            profiling = cl.command_queue_properties.PROFILING_ENABLE
            self._queue = cl.CommandQueue(self._context, handle, properties=profiling)
        except cl.Error as error:
            raise self._failed("opening it", error) from error

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._queue is None

    @property
    def context(self) -> Any:
        """The pyopencl context; raises DEVICE_CLOSED after `close`."""
        self.check_open()
        return self._context

    def check_open(self) -> None:
        """Raise a DeviceError `DEVICE_CLOSED` after `close`."""
        if self._queue is None:
            raise DeviceError("DEVICE_CLOSED", f"{self.record} was closed")

    def submit(self, doing: str, command: Callable[[Any], Any]) -> Any:
        """Queue a command by calling `command` with the pyopencl queue, and return the event of the
        command."""
        self.check_open()
        try:
            event = command(self._queue)
        except self.cl.Error as error:
            raise self._failed(doing, error) from error
        if self.timing is not None:
            self.timing.note(event)
        return event

    def finish(self) -> None:
        """Wait until all queued commands have finished."""
        self.check_open()
        try:
            self._queue.finish()
        except self.cl.Error as error:
            raise self._failed("waiting for it", error) from error

    def close(self) -> None:
        """Wait for all commands, and then release the queue and the context."""
        if self._queue is not None:
            with contextlib.suppress(self.cl.Error):
                self._queue.finish()
            self._queue = self._context = None

    def _failed(self, doing: str, error: Exception) -> DeviceError:
        code = "DEVICE_MEMORY" if isinstance(error, self.cl.MemoryError) else "DEVICE_COMMAND"
        self.failed |= code == "DEVICE_COMMAND"
        return DeviceError(code, f"{self.record}: {doing}: {shorten(str(error), 200)}")

"""An open device with a context, a queue, programs and buffers."""

import contextlib
import threading
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from typing import Any, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from msb.cl import programs
from msb.cl.buffers import SCRATCH, Buffer, Memory, Shape, bytes_by_use
from msb.cl.kernel_text import OWN, Define
from msb.cl.queue import Queue
from msb.cl.records import DeviceRecord, Style
from msb.cl.timing import Timing


class Device:
    """An OpenCL device with one in-order queue.

    `open_device` opens a device; `close` or the end of a ``with`` block closes the device. Threads may share
    a device. Commands are thread-safe. Put commands that belong together into a `using` or `timing` block.
    Other threads wait until the ``with`` block ends. `style` selects the kernels. The style of the kernels:
    `record.style` unless the caller chose another style.
    """

    def __init__(self, cl: Any, handle: Any, record: DeviceRecord, style: Style | None = None) -> None:
        self.record = record
        self.style: Style = style or record.style
        self._queue = Queue(cl, handle, record)
        self._default_memory = self._memory = Memory(self._queue)
        self._programs: dict[tuple[Any, ...], programs.Program] = {}
        self._lock = threading.RLock()

    def program(
        self, name: str, defines: Mapping[str, Define] | None = None, package: str = OWN
    ) -> programs.Program:
        """Return the kernels of file `name`.cl of `package`, built once for each set of `defines`."""
        chosen = dict(defines or {})
        key = (package, name, tuple(sorted(chosen.items())))
        with self._lock:
            if key not in self._programs:
                self._programs[key] = programs.build(self._queue, package, name, chosen)
            return self._programs[key]

    def upload(self, array: NDArray[Any], use: str = "static", group: str = SCRATCH) -> Buffer:
        """Return a buffer that kernels read, with the content of `array` (integers or floats of any shape).

        PoCL shares the memory of arrays that cannot change, such as read-only memory maps, instead of copying
        it. Memory counts include shared memory.
        """
        return self._memory.upload(array, use, group)

    def share(self, array: NDArray[Any], use: str = "static", group: str = SCRATCH) -> Buffer:
        """Return a buffer on the memory of `array` if PoCL runs on a CPU, otherwise a buffer with a copy.

        Kernels may write to the buffer if the array is writable. Read results from the buffer, because other
        platforms do not write them into the array. Keep the array alive and unchanged until `finish` has
        returned and the buffer is released. Kernels must not assume an alignment above the item size of the
        dtype. On systems with huge pages, pass a large new NumPy array: its first access takes a fifth of the
        time of memory from `allocate`.
        """
        return self._memory.share(array, use, group)

    def allocate(
        self, shape: Shape, dtype: DTypeLike = np.uint8, use: str = "static", group: str = SCRATCH
    ) -> Buffer:
        """Return a new buffer with undefined content."""
        return self._memory.allocate(shape, dtype, use, group)

    def scratch(self, name: str, shape: Shape, dtype: DTypeLike = np.uint8, group: str = SCRATCH) -> Buffer:
        """Return the pool buffer `name` with undefined content.

        Calls with the same name reuse the memory. If a pool buffer must grow, buffers returned earlier
        under this name are released.
        """
        return self._memory.scratch(name, shape, dtype, group)

    def release_scratch(self, prefix: str) -> None:
        """Release the pool buffers with a name that starts with `prefix`, for example when a preparation is
        finished.
        """
        self._memory.release_scratch(prefix)

    def memory(self) -> dict[str, int]:
        """Return the bytes that all users of the device have currently allocated for each use."""
        return bytes_by_use(self._queue.allocations)

    def new_memory(self) -> Memory:
        """Return a new account, which counts the buffers that one user allocates within `using`."""
        return Memory(self._queue)

    @contextlib.contextmanager
    def using(self, memory: Memory | None = None) -> Iterator[None]:
        """Reserve the device for a ``with`` block. Other threads wait.

        Buffers allocated in the block belong to the account `memory`, a result of `new_memory`. Without
        `memory`, buffers allocated in the block belong to the device.
        """
        with self._lock:
            before, self._memory = self._memory, memory or self._default_memory
            try:
                yield
            finally:
                self._memory = before

    @property
    def failed(self) -> bool:
        """Whether the device must be opened again, because the device was closed or a command failed."""
        return self._queue.closed or self._queue.failed

    @contextlib.contextmanager
    def timing(self) -> Iterator[Timing]:
        """Collect the events of all commands in the block, by stage, in the yielded `Timing`. Other threads
        wait."""
        with self._lock:
            if self._queue.timing is not None:
                raise RuntimeError("timing blocks cannot be nested")
            self._queue.timing = timing = Timing()
            try:
                yield timing
                self.finish()
            finally:
                self._queue.timing = None

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Assign the commands of a ``with`` block to the stage `name`. Outside a `timing` block, this
        method has no effect."""
        timing = self._queue.timing
        return contextlib.nullcontext() if timing is None else timing.as_stage(name)

    def finish(self) -> None:
        """Wait until all queued commands have finished."""
        self._queue.finish()

    def close(self) -> None:
        """Release all programs and buffers of the device. A second call of `close` does nothing."""
        with self._lock:
            for allocation in list(self._queue.allocations):
                allocation.release()
            self._programs.clear()
            self._queue.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Device {self.record}{', closed' if self._queue.closed else ''}>"

"""An open device: its context, its queue, and everything made on it."""

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
    """An OpenCL device with one in-order queue; made by `open_device`, closed by `close` or ``with``.

    Threads may share a device: each command is safe by itself, and commands that belong together go into a
    block of `using` or `timing`, during which other threads wait. `style` is that of the kernels to use:
    `record.style`, unless the caller chose another.
    """

    def __init__(self, cl: Any, handle: Any, record: DeviceRecord, style: Style | None = None) -> None:
        self.record = record
        self.style: Style = style or record.style
        self._queue = Queue(cl, handle, record)
        self._own_memory = self._memory = Memory(self._queue)
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
        """Return a buffer for kernels to read, holding `array` (integers or floats of any shape).

        PoCL shares the memory of an array that nobody can change, such as one mapped from a file, instead of
        copying it; its bytes are counted all the same.
        """
        return self._memory.upload(array, use, group)

    def share(self, array: NDArray[Any], use: str = "static", group: str = SCRATCH) -> Buffer:
        """Return a buffer on the memory of `array` if PoCL runs on a CPU, else a buffer with a copy.

        Kernels may write the buffer if the array can be written; read their results from the buffer, since
        only PoCL puts them into the array. Until the buffer is released, after `finish`, the array must live
        and nobody else may change it; kernels must not assume a larger alignment than that of its dtype.
        Large NumPy arrays lie in huge pages where the system has them, whose first touch costs a fifth of
        that of `allocate`.
        """
        return self._memory.share(array, use, group)

    def allocate(
        self, shape: Shape, dtype: DTypeLike = np.uint8, use: str = "static", group: str = SCRATCH
    ) -> Buffer:
        """Return a new buffer of undefined content; raises as `upload`."""
        return self._memory.allocate(shape, dtype, use, group)

    def scratch(self, name: str, shape: Shape, dtype: DTypeLike = np.uint8, group: str = SCRATCH) -> Buffer:
        """Return the buffer `name` of the pool, of undefined content; raises as `upload`.

        The memory is reused from call to call and grows when it must; then, buffers returned before under
        the same name are released.
        """
        return self._memory.scratch(name, shape, dtype, group)

    def release_scratch(self, prefix: str) -> None:
        """Give back the pool's buffers whose name begins with `prefix`, which only a preparation needed."""
        self._memory.release_scratch(prefix)

    def memory(self) -> dict[str, int]:
        """Return use -> bytes held on the device now, for all its users."""
        return bytes_by_use(self._queue.allocations)

    def new_memory(self) -> Memory:
        """Return a new account for the buffers that one user of the device allocates in `using`."""
        return Memory(self._queue)

    @contextlib.contextmanager
    def using(self, memory: Memory | None = None) -> Iterator[None]:
        """Have the device alone for a block; other threads wait.

        Buffers allocated in it belong to `memory`, an account that `new_memory` returned, or the device's.
        """
        with self._lock:
            before, self._memory = self._memory, memory or self._own_memory
            try:
                yield
            finally:
                self._memory = before

    @property
    def failed(self) -> bool:
        """Whether the device was closed or failed a command, so that it should be opened anew."""
        return self._queue.closed or self._queue.failed

    @contextlib.contextmanager
    def timing(self) -> Iterator[Timing]:
        """Collect the events of the block by stage, for the yielded `Timing`; other threads wait."""
        with self._lock:
            if self._queue.timing is not None:
                raise RuntimeError("timing blocks do not nest")
            self._queue.timing = timing = Timing()
            try:
                yield timing
                self.finish()
            finally:
                self._queue.timing = None

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Give the commands of a block the name `name`; nothing happens outside `timing`."""
        timing = self._queue.timing
        return contextlib.nullcontext() if timing is None else timing.as_stage(name)

    def finish(self) -> None:
        """Wait until everything queued is done."""
        self._queue.finish()

    def close(self) -> None:
        """Release everything made on the device. A second call does nothing."""
        with self._lock:
            for held in list(self._queue.allocations):
                held.release()
            self._programs.clear()
            self._queue.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Device {self.record}{', closed' if self._queue.closed else ''}>"

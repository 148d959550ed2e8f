"""Device memory: allocation, counts of bytes for each use, reuse and release."""

from __future__ import annotations

import contextlib
import math
import mmap
import weakref
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from msb.cl.queue import Queue
from msb.cl.records import short_name
from msb.errors import DeviceError

Shape = int | tuple[int, ...]

# The default group, for temporary results.
SCRATCH = "scratch"
# Minimum alignment, in bytes, of a host array that is shared instead of copied: one cache line. Kernels use
# types of at most 32 bytes (float8), because 64-byte types crash in the PoCL wheel.
_SAFE_ALIGNMENT = 64


class Allocation:
    """A block of device memory with a text that describes its use. Buffers are views of allocations."""

    def __init__(self, handle: Any, use: str, group: str) -> None:
        self.handle = handle
        self.use = use
        self.group = group
        self.nbytes: int = handle.size

    def release(self) -> None:
        """Release the memory; queued commands that use the memory still complete."""
        if self.handle is not None:
            self.handle.release()
            self.handle = None


class Buffer:
    """An array on the device, with a `shape`, a `dtype` and a text that describes its use.

    Like a NumPy array, a buffer may be empty. The memory is freed with the last reference to the buffer, by
    `release`, or with the device.
    """

    def __init__(self, memory: Memory, allocation: Allocation, shape: Shape, dtype: DTypeLike) -> None:
        self.shape = shape if isinstance(shape, tuple) else (shape,)
        self.dtype = np.dtype(dtype)
        self._memory = memory
        self.allocation = allocation

    @property
    def use(self) -> str:
        """The use of the memory as text."""
        return self.allocation.use

    @property
    def group(self) -> str:
        """The group of this use, for example "scratch"."""
        return self.allocation.group

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Size of the array in bytes. The allocated memory may be larger than the array."""
        return self.size * self.dtype.itemsize

    @property
    def handle(self) -> Any:
        """The pyopencl buffer."""
        self._memory.queue.check_open()
        if self.allocation.handle is None:
            raise DeviceError("DEVICE_CLOSED", f"the buffer for {self.use} was released")
        return self.allocation.handle

    def view(self, shape: Shape, dtype: DTypeLike) -> Buffer:
        """Return a buffer with this shape and dtype on the same memory, which starts at the first byte."""
        other = Buffer(self._memory, self.allocation, shape, dtype)
        if other.nbytes > self.allocation.nbytes:
            raise ValueError(
                f"{self.use}: {other.nbytes} bytes exceed the {self.allocation.nbytes} bytes of this buffer"
            )
        return other

    def read(self, out: NDArray[Any] | None = None, *, start: int = 0) -> NDArray[Any]:
        """Wait for all queued commands, then copy the elements from index `start` to the host.

        The function fills and returns `out`, a C-contiguous array with the dtype of the buffer. Without
        `out` the result is a new array, which has the shape of the buffer if `start` is 0. Pass the same
        `out` to repeated reads, because the first access to new memory takes longer than the copy.
        """
        if out is None:
            shape = self.shape if start == 0 else (self.size - start,)
            out = np.empty(shape, self.dtype)  # noqa: TID251 - filled below
        self._check_host(out, start)
        if out.size:
            offset, queue = start * self.dtype.itemsize, self._memory.queue
            queue.submit(
                f"reading {self.use}",
                lambda q: queue.cl.enqueue_copy(q, out, self.handle, src_offset=offset),
            )
        return out

    def write(self, array: NDArray[Any], *, start: int = 0) -> None:
        """Copy a C-contiguous host array of the same dtype into the buffer, beginning at index `start`."""
        self._check_host(array, start)
        if array.size:
            offset, queue = start * self.dtype.itemsize, self._memory.queue
            queue.submit(
                f"writing {self.use}",
                lambda q: queue.cl.enqueue_copy(q, self.handle, array, dst_offset=offset),
            )

    def copy(self, other: Buffer, *, start: int = 0) -> None:
        """Queue a copy of another buffer of the same dtype into this buffer, beginning at index `start`."""
        if other.dtype != self.dtype:
            raise TypeError(f"{self.use}: requires a buffer of {self.dtype}, not {other.dtype}")
        self._check_range(other.size, start)
        if other.size:
            queue, offset = self._memory.queue, start * self.dtype.itemsize
            queue.submit(
                f"copying {other.use}",
                lambda q: queue.cl.enqueue_copy(
                    q, self.handle, other.handle, byte_count=other.nbytes, dst_offset=offset
                ),
            )

    def fill(self, value: complex = 0) -> None:
        """Queue a command that sets all elements to `value`. The function does not wait for this command."""
        if self.size:
            pattern, queue = np.asarray(value, self.dtype), self._memory.queue
            queue.submit(
                f"filling {self.use}",
                lambda q: queue.cl.enqueue_fill_buffer(q, self.handle, pattern, 0, self.nbytes),
            )

    @contextlib.contextmanager
    def mapped(self) -> Iterator[NDArray[Any]]:
        """Yield the content as a read-only host array, valid only within the ``with`` block.

        No copy is made if host and device share memory. If host and device have separate memories, the
        content is copied to the host.
        """
        queue = self._memory.queue
        if not queue.record.host_unified or not self.size:
            copy = self.read()
            copy.flags.writeable = False
            yield copy
            return
        mapped: list[Any] = []

        def enqueue_map(q: Any) -> Any:
            flags = queue.cl.map_flags.READ
            array, event = queue.cl.enqueue_map_buffer(q, self.handle, flags, 0, self.shape, self.dtype)
            mapped.append(array)
            return event

        queue.submit(f"mapping {self.use}", enqueue_map)
        view = mapped[0][...]
        view.flags.writeable = False
        try:
            yield view
        finally:
            mapped[0].base.release()

    def release(self) -> None:
        """Release the memory now. After this call, neither this buffer nor any view of it can be used."""
        self.allocation.release()

    def _check_host(self, array: NDArray[Any], start: int) -> None:
        if array.dtype != self.dtype or not array.flags.c_contiguous:
            raise TypeError(f"{self.use}: requires a C-contiguous array of {self.dtype}, not {array.dtype}")
        self._check_range(array.size, start)

    def _check_range(self, size: int, start: int) -> None:
        if start < 0 or start + size > self.size:
            raise ValueError(
                f"{self.use}: elements {start} to {start + size} exceed the buffer size {self.size}"
            )


class Memory:
    """The buffers of one user of a device.

    The account checks memory limits, counts the bytes of each purpose, and reuses scratch buffers.
    """

    def __init__(self, queue: Queue) -> None:
        self.queue = queue
        self._allocations: weakref.WeakSet[Allocation] = weakref.WeakSet()
        self._pool: dict[str, Buffer] = {}

    def by_use(self) -> dict[str, int]:
        """Return the bytes that are currently allocated for each purpose, sorted by name."""
        return bytes_by_use(self._allocations)

    def groups(self) -> dict[str, str]:
        """Return the report group of each purpose in `by_use`."""
        return {block.use: block.group for block in list(self._allocations) if block.handle is not None}

    def allocate(self, shape: Shape, dtype: DTypeLike, use: str, group: str = SCRATCH) -> Buffer:
        """Return a new buffer with undefined content."""
        return self._register(shape, dtype, use, group, self.queue.cl.mem_flags.READ_WRITE)

    def upload(self, array: NDArray[Any], use: str, group: str = SCRATCH) -> Buffer:
        """Return a read-only buffer with the content of `array`, without a copy if sharing is safe."""
        if array.dtype.kind not in "iuf" or not array.dtype.isnative:
            raise TypeError(
                f"{use}: a device array holds integers and floats in native byte order, not {array.dtype}"
            )
        array = np.ascontiguousarray(array)
        flags = self.queue.cl.mem_flags
        if self._can_share(array):
            return self._register(
                array.shape, array.dtype, use, group, flags.READ_ONLY | flags.USE_HOST_PTR, host=array
            )
        buffer = self._register(array.shape, array.dtype, use, group, flags.READ_ONLY)
        buffer.write(array)
        return buffer

    def share(self, array: NDArray[Any], use: str, group: str = SCRATCH) -> Buffer:
        """Return a buffer on the memory of `array` if sharing is safe, otherwise a buffer with a copy."""
        flags = self.queue.cl.mem_flags
        if self._works_in_place() and array.size and array.flags.c_contiguous and array.flags.aligned:
            access = flags.READ_WRITE if array.flags.writeable else flags.READ_ONLY
            access |= flags.USE_HOST_PTR
            return self._register(array.shape, array.dtype, use, group, access, host=array)
        buffer = self.allocate(array.shape, array.dtype, use, group)
        buffer.write(np.ascontiguousarray(array))
        return buffer

    def scratch(self, name: str, shape: Shape, dtype: DTypeLike, group: str = SCRATCH) -> Buffer:
        """Return the pool buffer `name` as an array of this shape, with undefined content.

        Calls with the same name return the same memory if it is large enough. A pool buffer that is too small
        is freed and allocated again. Buffers returned earlier under the same name become invalid.
        """
        nbytes = _count_bytes(shape, dtype)
        pooled = self._pool.get(name)
        if pooled is None or pooled.nbytes < nbytes:
            if pooled is not None:
                self._pool.pop(name).release()  # free the old memory first, because both blocks might not fit
            size = _round_up(nbytes)
            size = size if size <= self._limit() else nbytes
            pooled = self._pool[name] = self.allocate(size, np.uint8, name, group)
        return pooled.view(shape, dtype)

    def release_scratch(self, prefix: str) -> None:
        """Release the pool buffers with a name that starts with `prefix`."""
        for name in [name for name in self._pool if name.startswith(prefix)]:
            self._pool.pop(name).release()

    def release_all(self) -> None:
        """Release every buffer of this user."""
        for held in list(self._allocations):
            held.release()
        self._pool.clear()

    def _limit(self) -> int:
        record = self.queue.record
        return min(record.max_allocation, record.global_memory - self._count_held())

    def _count_held(self) -> int:
        """Return the bytes allocated by all users of the device."""
        return sum(bytes_by_use(self.queue.allocations).values())

    def _works_in_place(self) -> bool:
        # PoCL works directly on host memory. Platforms other than PoCL may copy the array, and may write the
        # copy back when the buffer is mapped. Intel's platform copies arrays of some alignments, and then
        # crashes if the array is a read-only mapped file.
        record = self.queue.record
        return short_name(record.platform) == "pocl" and record.kind == "cpu"

    def _can_share(self, array: NDArray[Any]) -> bool:
        return (
            self._works_in_place()
            and array.size > 0
            and array.ctypes.data % _SAFE_ALIGNMENT == 0
            and _is_constant(array)
        )

    def _register(
        self, shape: Shape, dtype: DTypeLike, use: str, group: str, flags: int, host: Any = None
    ) -> Buffer:
        context, nbytes = self.queue.context, _count_bytes(shape, dtype)
        if nbytes > self._limit():
            raise self._too_large(use, nbytes)
        # An OpenCL buffer cannot be empty. A shared buffer has the size of the host array.
        size = max(nbytes, 1) if host is None else 0
        try:
            handle = self.queue.cl.Buffer(context, flags, size, host)
        except self.queue.cl.Error as error:
            raise self._too_large(use, nbytes) from error
        allocation = Allocation(handle, use, group)
        self._allocations.add(allocation)
        self.queue.allocations.add(allocation)
        return Buffer(self, allocation, shape, dtype)

    def _too_large(self, use: str, nbytes: int) -> DeviceError:
        record, held = self.queue.record, self._count_held()
        total, most = _format_mib(record.global_memory), _format_mib(record.max_allocation)
        text = (
            f"{_format_mib(nbytes)} MiB for {use} do not fit: {record.selector} has {total} MiB, "
            f"{_format_mib(held)} MiB in use, and allows at most {most} MiB per buffer"
        )
        return DeviceError("DEVICE_MEMORY", text)


def bytes_by_use(allocations: Iterable[Allocation]) -> dict[str, int]:
    """Return the bytes that are currently allocated for each purpose, sorted by name."""
    held: Counter[str] = Counter()
    for allocation in list(allocations):
        if allocation.handle is not None:
            held[allocation.use] += allocation.nbytes
    return dict(sorted(held.items()))


def _is_constant(array: NDArray[Any]) -> bool:
    """Return whether the array cannot change, so that kernels may read the host memory directly."""
    base: Any = array
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            return False
        base = base.base
    if isinstance(base, memoryview):
        return base.readonly and isinstance(base.obj, mmap.mmap | bytes)
    return base is None or isinstance(base, mmap.mmap | bytes)


def _count_bytes(shape: Shape, dtype: DTypeLike) -> int:
    count = math.prod(shape) if isinstance(shape, tuple) else shape
    return count * np.dtype(dtype).itemsize


def _format_mib(nbytes: int) -> str:
    return f"{nbytes / 2**20:,.1f}"


def _round_up(nbytes: int) -> int:
    """Return `nbytes` rounded up to an eighth of a power of two. The rounding avoids frequent reallocation of
    a growing buffer.

    >>> _round_up(1000), _round_up(1025)
    (1024, 1152)
    """
    step = 1 << max(0, nbytes.bit_length() - 4)
    return -(-nbytes // step) * step

"""Memory on the device: it is allocated, counted by use, reused, and given back."""

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

# The group of all uses without a group of their own: results that are computed in passing.
SCRATCH = "scratch"
# Alignment in bytes: a cache line. Kernels use types of at most 32 bytes (float8), because types of 64 bytes
# crash on PoCL's wheel.
_SAFE_ALIGNMENT = 64


class Allocation:
    """A piece of the device's memory and its use; buffers are views of it."""

    def __init__(self, handle: Any, use: str, group: str) -> None:
        self.handle = handle
        self.use = use
        self.group = group
        self.nbytes: int = handle.size

    def release(self) -> None:
        """Give the memory back; a queued command that uses it still completes."""
        if self.handle is not None:
            self.handle.release()
            self.handle = None


class Buffer:
    """An array on the device, with its `shape`, `dtype` and use.

    Like a NumPy array it may have no elements. Its memory is given back with the last reference to it,
    by `release`, or with its device.
    """

    def __init__(self, memory: Memory, allocation: Allocation, shape: Shape, dtype: DTypeLike) -> None:
        self.shape = shape if isinstance(shape, tuple) else (shape,)
        self.dtype = np.dtype(dtype)
        self._memory = memory
        self.allocation = allocation

    @property
    def use(self) -> str:
        """The use of the memory, in words."""
        return self.allocation.use

    @property
    def group(self) -> str:
        """The group to which the use belongs."""
        return self.allocation.group

    @property
    def size(self) -> int:
        """Number of elements."""
        return math.prod(self.shape)

    @property
    def nbytes(self) -> int:
        """Bytes of the array; its allocation may be larger."""
        return self.size * self.dtype.itemsize

    @property
    def handle(self) -> Any:
        """The pyopencl buffer."""
        self._memory.queue.check_open()
        if self.allocation.handle is None:
            raise DeviceError("DEVICE_CLOSED", f"the buffer for {self.use} was released")
        return self.allocation.handle

    def view(self, shape: Shape, dtype: DTypeLike) -> Buffer:
        """Return the same memory, from its start, as another array."""
        other = Buffer(self._memory, self.allocation, shape, dtype)
        if other.nbytes > self.allocation.nbytes:
            raise ValueError(f"{self.use}: {other.nbytes} bytes of {self.allocation.nbytes}")
        return other

    def read(self, out: NDArray[Any] | None = None, *, start: int = 0) -> NDArray[Any]:
        """Copy the elements from `start` on to the host, after everything queued before.

        `out`, a C-contiguous array of the buffer's dtype, is filled; without it a new array is (of the
        buffer's shape if `start` is 0). Give the same array again and again, because the first touch of new
        memory costs more than the copy.
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
        """Copy a C-contiguous array of the buffer's dtype to the elements from `start` on."""
        self._check_host(array, start)
        if array.size:
            offset, queue = start * self.dtype.itemsize, self._memory.queue
            queue.submit(
                f"writing {self.use}",
                lambda q: queue.cl.enqueue_copy(q, self.handle, array, dst_offset=offset),
            )

    def copy(self, other: Buffer, *, start: int = 0) -> None:
        """Queue a copy of all of another buffer of this dtype to the elements from `start` on."""
        if other.dtype != self.dtype:
            raise TypeError(f"{self.use}: a buffer of {self.dtype} is needed, not {other.dtype}")
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
        """Queue a command that sets all elements, and do not wait for it."""
        if self.size:
            pattern, queue = np.asarray(value, self.dtype), self._memory.queue
            queue.submit(
                f"filling {self.use}",
                lambda q: queue.cl.enqueue_fill_buffer(q, self.handle, pattern, 0, self.nbytes),
            )

    @contextlib.contextmanager
    def mapped(self) -> Iterator[NDArray[Any]]:
        """Yield the content as a read-only host array, valid in the block only.

        Where host and device share memory this needs no copy; elsewhere it is a `read`.
        """
        queue = self._memory.queue
        if not queue.record.host_unified or not self.size:
            copy = self.read()
            copy.flags.writeable = False
            yield copy
            return
        mapped: list[Any] = []

        def map_it(q: Any) -> Any:
            flags = queue.cl.map_flags.READ
            array, event = queue.cl.enqueue_map_buffer(q, self.handle, flags, 0, self.shape, self.dtype)
            mapped.append(array)
            return event

        queue.submit(f"mapping {self.use}", map_it)
        view = mapped[0][...]
        view.flags.writeable = False
        try:
            yield view
        finally:
            mapped[0].base.release()

    def release(self) -> None:
        """Give the memory back now; neither this nor any view of it can be used any more."""
        self.allocation.release()

    def _check_host(self, array: NDArray[Any], start: int) -> None:
        if array.dtype != self.dtype or not array.flags.c_contiguous:
            raise TypeError(f"{self.use}: a C-contiguous array of {self.dtype} is needed, not {array.dtype}")
        self._check_range(array.size, start)

    def _check_range(self, size: int, start: int) -> None:
        if start < 0 or start + size > self.size:
            raise ValueError(f"{self.use}: elements {start} to {start + size} of {self.size}")


class Memory:
    """The buffers of one user of a device: limits, bytes by use, and a pool of scratch buffers."""

    def __init__(self, queue: Queue) -> None:
        self.queue = queue
        self._allocations: weakref.WeakSet[Allocation] = weakref.WeakSet()
        self._pool: dict[str, Buffer] = {}

    def by_use(self) -> dict[str, int]:
        """Return use -> bytes the device holds for it now, in order of name."""
        return bytes_by_use(self._allocations)

    def groups(self) -> dict[str, str]:
        """Return use -> group, for the uses that `by_use` names."""
        return {held.use: held.group for held in list(self._allocations) if held.handle is not None}

    def allocate(self, shape: Shape, dtype: DTypeLike, use: str, group: str = SCRATCH) -> Buffer:
        """Return a new buffer; its content is undefined."""
        return self._register(shape, dtype, use, group, self.queue.cl.mem_flags.READ_WRITE)

    def upload(self, array: NDArray[Any], use: str, group: str = SCRATCH) -> Buffer:
        """Return a buffer with `array`, which kernels only read; without a copy where that is safe."""
        if array.dtype.kind not in "iuf" or not array.dtype.isnative:
            raise TypeError(f"{use}: a device holds native integers and floats, not {array.dtype}")
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
        """Return a buffer on the memory of `array` itself where that is safe, else a buffer with a copy."""
        flags = self.queue.cl.mem_flags
        if self._works_in_place() and array.size and array.flags.c_contiguous and array.flags.aligned:
            access = flags.READ_WRITE if array.flags.writeable else flags.READ_ONLY
            access |= flags.USE_HOST_PTR
            return self._register(array.shape, array.dtype, use, group, access, host=array)
        buffer = self.allocate(array.shape, array.dtype, use, group)
        buffer.write(np.ascontiguousarray(array))
        return buffer

    def scratch(self, name: str, shape: Shape, dtype: DTypeLike, group: str = SCRATCH) -> Buffer:
        """Return the pool's buffer `name`, with room for the array; its content is undefined.

        The memory is the same from call to call as long as it is large enough; growing releases it, so
        buffers returned earlier under this name must not be used any more.
        """
        nbytes = _nbytes(shape, dtype)
        held = self._pool.get(name)
        if held is None or held.nbytes < nbytes:
            if held is not None:
                self._pool.pop(name).release()  # first, so that both need not fit
            room = _rounded(nbytes)
            room = room if room <= self._limit() else nbytes
            held = self._pool[name] = self.allocate(room, np.uint8, name, group)
        return held.view(shape, dtype)

    def release_scratch(self, prefix: str) -> None:
        """Release the pool's buffers whose name begins with `prefix`."""
        for name in [name for name in self._pool if name.startswith(prefix)]:
            self._pool.pop(name).release()

    def release_all(self) -> None:
        """Release every buffer of this user."""
        for held in list(self._allocations):
            held.release()
        self._pool.clear()

    def _limit(self) -> int:
        record = self.queue.record
        return min(record.max_allocation, record.global_memory - self._held())

    def _held(self) -> int:
        """Return the bytes that all users of the device hold."""
        return sum(bytes_by_use(self.queue.allocations).values())

    def _works_in_place(self) -> bool:
        # PoCL works on the memory it is given. Another platform may keep a copy and write that back when the
        # buffer is mapped; Intel's does for some alignments and dies of it where a file is mapped read-only.
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
        context, nbytes = self.queue.context, _nbytes(shape, dtype)
        if nbytes > self._limit():
            raise self._too_large(use, nbytes)
        # An OpenCL buffer cannot be empty; one that shares memory takes its size from there.
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
        record, held = self.queue.record, self._held()
        text = (
            f"{_mib(nbytes)} MiB for {use} do not fit: {record.selector} has {_mib(record.global_memory)} "
            f"MiB, {_mib(held)} of them in use, and takes at most {_mib(record.max_allocation)} at once"
        )
        return DeviceError("DEVICE_MEMORY", text)


def bytes_by_use(allocations: Iterable[Allocation]) -> dict[str, int]:
    """Return use -> bytes held for that use now, in order of name."""
    held: Counter[str] = Counter()
    for allocation in list(allocations):
        if allocation.handle is not None:
            held[allocation.use] += allocation.nbytes
    return dict(sorted(held.items()))


def _is_constant(array: NDArray[Any]) -> bool:
    """Return whether nobody can change the array: sharing it cannot be told from copying it."""
    base: Any = array
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            return False
        base = base.base
    if isinstance(base, memoryview):
        return base.readonly and isinstance(base.obj, mmap.mmap | bytes)
    return base is None or isinstance(base, mmap.mmap | bytes)


def _nbytes(shape: Shape, dtype: DTypeLike) -> int:
    count = math.prod(shape) if isinstance(shape, tuple) else shape
    return count * np.dtype(dtype).itemsize


def _mib(nbytes: int) -> str:
    return f"{nbytes / 2**20:,.1f}"


def _rounded(nbytes: int) -> int:
    """Return `nbytes` rounded up to an eighth of a power of two, so that a growing need reallocates rarely.

    >>> _rounded(1000), _rounded(1025)
    (1024, 1152)
    """
    step = 1 << max(0, nbytes.bit_length() - 4)
    return -(-nbytes // step) * step

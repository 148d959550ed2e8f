"""Kernels: build a file of the package into functions that check their arguments and return an event."""

from __future__ import annotations

import math
import re
import threading
import time
import warnings
import weakref
from collections.abc import Mapping
from typing import Any

import numpy as np

from msb.cl.buffers import Buffer
from msb.cl.kernel_text import Define, define_lines, place_of, resolve
from msb.cl.queue import Queue
from msb.cl.records import DeviceRecord
from msb.errors import DeviceError, shorten

Size = int | tuple[int, ...]

_SCALARS = {
    "char": np.int8,
    "uchar": np.uint8,
    "short": np.int16,
    "ushort": np.uint16,
    "int": np.int32,
    "uint": np.uint32,
    "long": np.int64,
    "ulong": np.uint64,
    "float": np.float32,
    "double": np.float64,
}
# PoCL's log puts "error: " before the place, all others behind it.
_ERROR_LINE = re.compile(
    r"^\s*(?:error: )?(?P<file>[^:\n]+):(?P<line>\d+):\d+: "
    r"(?!warning: |note: |remark: )(?:(?:fatal )?error: )?(?P<text>.+)$"
)
# What a compiler says without a place, and what the platform says around it.
_COMPLAINT = re.compile(r"^\s*(?:fatal )?error:\s*(?P<text>.+)$", re.IGNORECASE)
_WRAPPING = re.compile(r"clBuildProgram failed|BUILD_PROGRAM_FAILURE|^Build on |^\(options:")
# What NVIDIA's compiler calls the source; it does not heed ``#line``.
_NAMELESS = "<kernel>"
# The message of clang if PoCL's LLVM is older than the processor.
UNKNOWN_CPU = "unknown target CPU"

# A build that fails without a complaint about the source is tried again: PoCL processes that meet on an empty
# cache and build the same program at the same moment disturb each other (1 of 200 starts, 8 at once).
_ATTEMPTS = 5
_PAUSE = 0.2  # seconds


class LocalMemory:
    """A `__local` pointer argument of `nbytes` bytes."""

    def __init__(self, nbytes: int) -> None:
        self.nbytes = nbytes


class Program:
    """The kernels of one file, PACKAGE/FILE, built for one device; each is an attribute."""

    def __init__(self, name: str, kernels: dict[str, Kernel]) -> None:
        self.name = name
        self._kernels = kernels

    @property
    def max_work_group(self) -> int:
        """Number of work-items of the largest work-group that all its kernels allow."""
        return min(kernel.max_work_group for kernel in self._kernels.values())

    def __getattr__(self, name: str) -> Kernel:
        try:
            return self.__dict__["_kernels"][name]  # type: ignore[no-any-return]
        except KeyError:
            raise AttributeError(f"{self.__dict__.get('name')} has no kernel {name}") from None

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._kernels]


class Kernel:
    """One kernel; ``kernel(global_size, local_size, *arguments)`` queues a launch.

    It returns the event, or None when there is nothing to do. Sizes are an integer or up to three of them.
    `global_size` is rounded up to a multiple of `local_size`, so a kernel must compare its global id with a
    count. The local size is never left to the platform: PoCL compiles every kernel once for each it meets.

    Arguments are `Buffer`, `LocalMemory`, NumPy scalars (the kernel's type exactly: ``np.uint32(n)``) or,
    for vector types, NumPy arrays of as many elements. Anything else is a TypeError. Larger work-groups than
    the device allows are a DeviceError `DEVICE_COMMAND`, and so are larger ones than the platform allows for
    the kernel, if it refuses to launch them.

    Attributes
    ----------
    name : str
    max_work_group : int
        Number of work-items of the largest work-group that surely is launched. A kernel that needs many
        registers may allow fewer than its device (OpenCL 1.2 specification, section 5.7.3,
        CL_KERNEL_WORK_GROUP_SIZE). Mesa's Rusticl 22.3 says 32 of every kernel and launches 256.
    """

    def __init__(self, queue: Queue, handle: Any) -> None:
        self.name: str = handle.function_name
        info = queue.cl.kernel_work_group_info.WORK_GROUP_SIZE
        # Some platforms answer with the size that the source requires, whatever the device allows.
        self.max_work_group: int = min(
            handle.get_work_group_info(info, queue.handle), queue.record.max_work_group
        )
        self._queue = queue
        self._handle = handle
        self._lock = threading.Lock()
        self._wanted = [_wanted(queue.cl, handle, number) for number in range(handle.num_args)]
        self._marks: list[Any] = [None] * handle.num_args  # of the arguments that it has now

    def __call__(self, global_size: Size, local_size: Size, *arguments: Any) -> Any:
        self._queue.check_open()
        local = local_size if isinstance(local_size, tuple) else (local_size,)
        wanted = global_size if isinstance(global_size, tuple) else (global_size,)
        if len(arguments) != len(self._wanted):
            raise TypeError(f"{self.name} takes {len(self._wanted)} arguments, not {len(arguments)}")
        values = [self._checked(number, argument) for number, argument in enumerate(arguments)]
        if 0 in wanted:
            return None
        most = self._queue.record.max_work_group
        if math.prod(local) > most:
            raise self._too_large(local, most)
        rounded = tuple(-(-size // group) * group for size, group in zip(wanted, local, strict=True))

        def launch(queue: Any) -> Any:
            with self._lock:  # the arguments belong to the kernel, not to the launch
                for number, (value, argument) in enumerate(zip(values, arguments, strict=True)):
                    self._set(number, value, _mark(argument))
                return self._queue.cl.enqueue_nd_range_kernel(queue, self._handle, rounded, local)

        try:
            return self._queue.submit(f"kernel {self.name} over {rounded} in groups of {local}", launch)
        except DeviceError as error:
            if math.prod(local) > self.max_work_group:
                raise self._too_large(local, self.max_work_group) from error
            raise

    def _set(self, number: int, value: Any, mark: Any) -> None:
        """Set an argument unless it is that already: for a GPU, setting ten takes longer than a launch."""
        if mark is None or self._marks[number] != mark:
            self._marks[number] = None
            self._handle.set_arg(number, value)
            self._marks[number] = mark

    def _checked(self, number: int, argument: Any) -> Any:
        wanted = self._wanted[number]
        value = _as_opencl_takes_it(wanted, argument)
        if value is None:
            given = getattr(argument, "dtype", type(argument).__name__)
            text = f"{self.name}: argument {number} must be {_in_words(wanted)}, not {given}"
            raise TypeError(text)
        return value

    def _too_large(self, local: tuple[int, ...], most: int) -> DeviceError:
        needed = math.prod(local)
        size = f"{' x '.join(map(str, local))} = {needed}" if len(local) > 1 else f"{needed}"
        return DeviceError(
            "DEVICE_COMMAND",
            f"kernel {self.name} needs work-groups of {size}, and {self._queue.record} allows {most} for it: "
            "take another device (msb devices lists them; a CPU allows thousands)",
        )


def build_options(record: DeviceRecord) -> tuple[str, ...]:
    """Return the options with which every program is built. Only this function decides them.

    - No -cl-std: the platforms' default, OpenCL C 1.2, is what all of them agree on.
    - No fast-math of any kind: it would let results differ from device to device.
    - Whether a * b + c may be fused is said in the kernel, ``#pragma OPENCL FP_CONTRACT OFF``, where
      rounding matters (OpenCL C 1.2 specification, section 6.12.4); elsewhere the default, ON, holds.
    - Division and square root are correctly rounded where the device can do it.
    """
    options = ["-cl-kernel-arg-info"]
    if record.correctly_rounded:
        options.append("-cl-fp32-correctly-rounded-divide-sqrt")
    return tuple(options)


def build(queue: Queue, package: str, name: str, defines: Mapping[str, Define]) -> Program:
    """Compile `name`.cl of `package` for the device of `queue`."""
    options = build_options(queue.record)
    source = define_lines(defines) + resolve(package, f"{name}.cl")
    for attempt in range(_ATTEMPTS):
        try:
            handles = _compile(queue, source, options)
            break
        except queue.cl.Error as error:
            log = str(error)
            found = next(filter(None, map(_ERROR_LINE.match, log.splitlines())), None)
            if found or UNKNOWN_CPU in log or attempt + 1 == _ATTEMPTS:
                raise _build_error(f"{name}.cl", source, queue.record, log, found) from error
            time.sleep(_PAUSE)
    kernels = {handle.function_name: Kernel(queue, handle) for handle in handles}
    return Program(f"{package}/{name}.cl", kernels)


def _compile(queue: Queue, source: str, options: tuple[str, ...]) -> list[Any]:
    cl = queue.cl
    # Not cl.Program(context, source): its cache on disk hangs a minute on the lock of a killed process, and
    # PoCL and NVIDIA keep caches of their own.
    program = cl.Program(cl._cl._Program(queue.context, source))
    with warnings.catch_warnings():
        # The compiler's remarks are no concern of the user's; errors arrive as exceptions.
        warnings.simplefilter("ignore", cl.CompilerWarning)
        return list(program.build(list(options)).all_kernels())


def _build_error(
    file: str, source: str, record: DeviceRecord, log: str, found: re.Match[str] | None
) -> DeviceError:
    """Return the error that says file, line and text of the first complaint `found` in the log."""
    line, said = None, shorten(found["text"] if found else _first_complaint(log), 200)
    if found:
        file, number = found["file"], int(found["line"])
        if file == _NAMELESS:
            file, number = place_of(source, number) or (file, number)
        line, said = f"line {number}", f"line {number}: {said}"
    error = DeviceError("DEVICE_BUILD", f"{said} (on {record})", file=file, pointer=line)
    error.add_note(log)
    return error


def _first_complaint(log: str) -> str:
    """Return the compiler's own line: what it calls an error, or the first not put around it."""
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    errors = (match["text"] for match in map(_COMPLAINT.match, lines) if match)
    others = (line for line in lines if not _WRAPPING.search(line))
    return next(errors, None) or next(others, None) or lines[0]


def _wanted(cl: Any, handle: Any, number: int) -> Any:
    """Return what an argument must be: Buffer, LocalMemory, (dtype, width), or None if anything goes."""
    info, qualifiers = cl.kernel_arg_info, cl.kernel_arg_address_qualifier
    try:
        place = handle.get_arg_info(number, info.ADDRESS_QUALIFIER)
        kind = handle.get_arg_info(number, info.TYPE_NAME)
    except cl.Error:  # a platform need not have it
        return None
    if place != qualifiers.PRIVATE:
        return LocalMemory if place == qualifiers.LOCAL else Buffer
    base = kind.rstrip("0123456789")
    if base not in _SCALARS:  # a struct or a name of the kernel's own
        return None
    return np.dtype(_SCALARS[base]), int(kind[len(base) :] or 1)


def _as_opencl_takes_it(wanted: Any, value: Any) -> Any:
    """Return an argument as it is handed to OpenCL, or None if it is not what is wanted."""
    if isinstance(value, Buffer):
        return value.handle if wanted in (Buffer, None) else None
    if isinstance(value, LocalMemory):
        from pyopencl import LocalMemory as Handle

        return Handle(value.nbytes) if wanted in (LocalMemory, None) else None
    if wanted is None:
        return value
    if not isinstance(wanted, tuple) or getattr(value, "dtype", None) != wanted[0]:
        return None
    width = wanted[1]
    if width == 1:
        return value if isinstance(value, np.generic) else None
    # Three numbers are stored as four: OpenCL 1.2 specification, section 6.1.5.
    return np.pad(value, (0, width == 3)) if value.shape == (width,) else None


def _mark(argument: Any) -> Any:
    """Return what equals the mark of the same argument alone; None for what is set at every launch.

    It does not keep a buffer's memory alive, and that of a dead one equals no other.
    """
    if isinstance(argument, Buffer):
        return weakref.ref(argument.allocation)
    return (type(argument), int(argument)) if isinstance(argument, np.integer) else None


def _in_words(wanted: Any) -> str:
    if not isinstance(wanted, tuple):
        return f"a {wanted.__name__}"
    dtype, width = wanted
    return f"a NumPy scalar {dtype}" if width == 1 else f"an array of {width} {dtype}"

"""Build a kernel file, and call its kernels as Python functions.

The functions check their arguments and return an event.
"""

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
from msb.cl.kernel_text import Define, place_of, resolve, write_defines
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
# PoCL puts "error: " before the position in its log; all other compilers put it after the position.
_ERROR_LINE = re.compile(
    r"^\s*(?:error: )?(?P<file>[^:\n]+):(?P<line>\d+):\d+: "
    r"(?!warning: |note: |remark: )(?:(?:fatal )?error: )?(?P<text>.+)$"
)
# _COMPLAINT matches a compiler error without a position. _WRAPPING matches text that the platform adds around
# compiler errors.
_COMPLAINT = re.compile(r"^\s*(?:fatal )?error:\s*(?P<text>.+)$", re.IGNORECASE)
_WRAPPING = re.compile(r"clBuildProgram failed|BUILD_PROGRAM_FAILURE|^Build on |^\(options:")
# Name of the source text in messages of the NVIDIA compiler. The NVIDIA compiler ignores ``#line``
# directives.
_NAMELESS = "<kernel>"
# Message of clang if the LLVM of PoCL is older than the processor.
UNKNOWN_CPU = "unknown target CPU"

# Maximum number of attempts to build a program. A build is repeated only if it fails without an error in
# the source. Several PoCL processes disturb each other when they build the same program into an empty cache.
# One of 200 builds fails with eight processes.
_ATTEMPTS = 5
_PAUSE = 0.2  # seconds


class LocalMemory:
    """A `__local` pointer argument of a kernel, with a size of `nbytes` bytes."""

    def __init__(self, nbytes: int) -> None:
        self.nbytes = nbytes


class Program:
    """The kernels of a file PACKAGE/FILE, built for a device. Each kernel of the program is an attribute."""

    def __init__(self, name: str, kernels: dict[str, Kernel]) -> None:
        self.name = name
        self._kernels = kernels

    @property
    def max_work_group(self) -> int:
        """Maximum size of a work-group, in work-items, that all kernels of the program allow."""
        return min(kernel.max_work_group for kernel in self._kernels.values())

    def __getattr__(self, name: str) -> Kernel:
        try:
            return self.__dict__["_kernels"][name]  # type: ignore[no-any-return]
        except KeyError:
            raise AttributeError(f"{self.__dict__.get('name')} has no kernel called {name}") from None

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._kernels]


class Kernel:
    """A kernel. ``kernel(global_size, local_size, *arguments)`` queues a launch of the kernel and returns
    its event.

    The returned event is None if a size is 0. Global and local sizes are an integer or a tuple of up to
    three integers. `global_size` is rounded up to a multiple of `local_size`. Kernels must compare their
    global id with the number of elements, because the global size is rounded up. The local size is required,
    because PoCL compiles a kernel again for each new local size.

    Kernel arguments are `Buffer`, `LocalMemory`, or NumPy scalars of exactly the type in the kernel
    (``np.uint32(n)``). For a vector argument, pass a NumPy array with as many elements as the vector.
    Arguments of other types raise a TypeError. A work-group that exceeds the limit of the device raises a
    DeviceError `DEVICE_COMMAND`. A work-group that exceeds only the kernel's limit fails when the platform
    rejects the launch.

    Attributes
    ----------
    name : str
    max_work_group : int
        A work-group with this number of work-items can certainly be launched. The number is smaller than the
        device's limit if the kernel needs many registers (OpenCL 1.2 specification, section 5.7.3,
        CL_KERNEL_WORK_GROUP_SIZE). Mesa's Rusticl 22.3 reports a limit of 32 for every kernel, but launches
        groups of 256.
    """

    def __init__(self, queue: Queue, handle: Any) -> None:
        self.name: str = handle.function_name
        info = queue.cl.kernel_work_group_info.WORK_GROUP_SIZE
        # Some platforms return the work-group size required by the source, even if it exceeds the device's
        # limit.
        self.max_work_group: int = min(
            handle.get_work_group_info(info, queue.handle), queue.record.max_work_group
        )
        self._queue = queue
        self._handle = handle
        self._lock = threading.Lock()
        self._kinds = [_find_kind(queue.cl, handle, number) for number in range(handle.num_args)]
        self._marks: list[Any] = [None] * handle.num_args  # the current arguments

    def __call__(self, global_size: Size, local_size: Size, *arguments: Any) -> Any:
        self._queue.check_open()
        local = local_size if isinstance(local_size, tuple) else (local_size,)
        sizes = global_size if isinstance(global_size, tuple) else (global_size,)
        if len(arguments) != len(self._kinds):
            raise TypeError(f"{self.name} takes {len(self._kinds)} arguments, not {len(arguments)}")
        values = [self._check(number, argument) for number, argument in enumerate(arguments)]
        if 0 in sizes:
            return None
        most = self._queue.record.max_work_group
        if math.prod(local) > most:
            raise self._too_large(local, most)
        rounded = tuple(-(-size // group) * group for size, group in zip(sizes, local, strict=True))

        def launch(queue: Any) -> Any:
            with self._lock:  # threads take turns, because arguments are stored in the kernel
                for number, (value, argument) in enumerate(zip(values, arguments, strict=True)):
                    self._set(number, value, _identify(argument))
                return self._queue.cl.enqueue_nd_range_kernel(queue, self._handle, rounded, local)

        try:
            return self._queue.submit(f"kernel {self.name} over {rounded} in groups of {local}", launch)
        except DeviceError as error:
            if math.prod(local) > self.max_work_group:
                raise self._too_large(local, self.max_work_group) from error
            raise

    def _set(self, number: int, value: Any, mark: Any) -> None:
        """Set a kernel argument unless it already has this value.

        On a GPU, setting ten kernel arguments takes longer than a launch.
        """
        if mark is None or self._marks[number] != mark:
            self._marks[number] = None
            self._handle.set_arg(number, value)
            self._marks[number] = mark

    def _check(self, number: int, argument: Any) -> Any:
        kind = self._kinds[number]
        value = _convert(kind, argument)
        if value is None:
            given = getattr(argument, "dtype", type(argument).__name__)
            text = f"{self.name}: argument {number} must be {_describe_kind(kind)}, not {given}"
            raise TypeError(text)
        return value

    def _too_large(self, local: tuple[int, ...], most: int) -> DeviceError:
        needed = math.prod(local)
        size = f"{' x '.join(map(str, local))} = {needed}" if len(local) > 1 else f"{needed}"
        return DeviceError(
            "DEVICE_COMMAND",
            f"kernel {self.name} needs work-groups of {size}, but {self._queue.record} allows {most}; "
            "choose another device (msb devices lists them; a CPU allows thousands)",
        )


def build_options(record: DeviceRecord) -> tuple[str, ...]:
    """Return the compiler options for every build. Only this function decides the build options.

    - No -cl-std, because the default of all platforms is OpenCL C 1.2.

    - No fast-math options, because results would differ between devices.

    - Kernels state whether a * b + c may be fused, with ``#pragma OPENCL FP_CONTRACT OFF`` if rounding
      matters (OpenCL C 1.2 specification, section 6.12.4); otherwise the default, ON, applies.

    - Division and square root are correctly rounded if the device supports it.
    """
    options = ["-cl-kernel-arg-info"]
    if record.correctly_rounded:
        options.append("-cl-fp32-correctly-rounded-divide-sqrt")
    return tuple(options)


def build(queue: Queue, package: str, name: str, defines: Mapping[str, Define]) -> Program:
    """Compile `name`.cl of `package` for the device of `queue`."""
    options = build_options(queue.record)
    source = write_defines(defines) + resolve(package, f"{name}.cl")
    for attempt in range(_ATTEMPTS):
        try:
            handles = _compile(queue, source, options)
            break
        except queue.cl.Error as error:
            log = str(error)
            complaint = next(filter(None, map(_ERROR_LINE.match, log.splitlines())), None)
            if complaint or UNKNOWN_CPU in log or attempt + 1 == _ATTEMPTS:
                raise _build_error(f"{name}.cl", source, queue.record, log, complaint) from error
            time.sleep(_PAUSE)
    kernels = {handle.function_name: Kernel(queue, handle) for handle in handles}
    return Program(f"{package}/{name}.cl", kernels)


def _compile(queue: Queue, source: str, options: tuple[str, ...]) -> list[Any]:
    cl = queue.cl
    # Do not call cl.Program(context, source), because its disk cache waits a minute for the lock of a killed
    # process. PoCL and NVIDIA cache programs themselves.
    program = cl.Program(cl._cl._Program(queue.context, source))
    with warnings.catch_warnings():
        # Compiler warnings are not meant for the user. Errors are raised as exceptions.
        warnings.simplefilter("ignore", cl.CompilerWarning)
        return list(program.build(list(options)).all_kernels())


def _build_error(
    file: str, source: str, record: DeviceRecord, log: str, complaint: re.Match[str] | None
) -> DeviceError:
    """Return an error with the file, line and text of the first error in the compiler log."""
    line, text = None, shorten(complaint["text"] if complaint else _find_first_complaint(log), 200)
    if complaint:
        file, number = complaint["file"], int(complaint["line"])
        if file == _NAMELESS:
            file, number = place_of(source, number) or (file, number)
        line, text = f"line {number}", f"line {number}: {text}"
    error = DeviceError("DEVICE_BUILD", f"{text} (on {record})", file=file, pointer=line)
    error.add_note(log)
    return error


def _find_first_complaint(log: str) -> str:
    """Return the first error in the log, or the first line of a log without errors."""
    lines = [line.strip() for line in log.splitlines() if line.strip()]
    errors = (match["text"] for match in map(_COMPLAINT.match, lines) if match)
    others = (line for line in lines if not _WRAPPING.search(line))
    return next(errors, None) or next(others, None) or lines[0]


def _find_kind(cl: Any, handle: Any, number: int) -> Any:
    """Return the kind of argument `number`: Buffer, LocalMemory, or (dtype, width); return None for an
    unknown kind."""
    info, qualifiers = cl.kernel_arg_info, cl.kernel_arg_address_qualifier
    try:
        qualifier = handle.get_arg_info(number, info.ADDRESS_QUALIFIER)
        type_name = handle.get_arg_info(number, info.TYPE_NAME)
    except cl.Error:  # optional for platforms
        return None
    if qualifier != qualifiers.PRIVATE:
        return LocalMemory if qualifier == qualifiers.LOCAL else Buffer
    base = type_name.rstrip("0123456789")
    if base not in _SCALARS:  # a struct or a typedef, which cannot be checked
        return None
    return np.dtype(_SCALARS[base]), int(type_name[len(base) :] or 1)


def _convert(kind: Any, value: Any) -> Any:
    """Return an argument in the form that pyopencl takes, or None if the argument is not of this kind."""
    if isinstance(value, Buffer):
        return value.handle if kind in (Buffer, None) else None
    if isinstance(value, LocalMemory):
        from pyopencl import LocalMemory as Handle

        return Handle(value.nbytes) if kind in (LocalMemory, None) else None
    if kind is None:
        return value
    if not isinstance(kind, tuple) or getattr(value, "dtype", None) != kind[0]:
        return None
    width = kind[1]
    if width == 1:
        return value if isinstance(value, np.generic) else None
    # A vector of three elements is stored as four: OpenCL 1.2 specification, section 6.1.5.
    return np.pad(value, (0, width == 3)) if value.shape == (width,) else None


def _identify(argument: Any) -> Any:
    """Return a value that identifies an argument, or None if the argument must be set at every launch.

    The identifying value does not keep the memory of a buffer alive. No other argument has the identifying
    value of a released buffer.
    """
    if isinstance(argument, Buffer):
        return weakref.ref(argument.allocation)
    return (type(argument), int(argument)) if isinstance(argument, np.integer) else None


def _describe_kind(kind: Any) -> str:
    if not isinstance(kind, tuple):
        return f"a {kind.__name__}"
    dtype, width = kind
    return f"a NumPy scalar {dtype}" if width == 1 else f"an array of {width} {dtype}"

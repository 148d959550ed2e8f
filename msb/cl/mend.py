"""Let the PoCL wheel build kernels on processors that it does not know.

Why this module exists: `pip install meshsplatbench` must draw without a driver, and the only PoCL wheel for
x86-64 is 3.0-rc2 of 2022 with LLVM 14. It asks LLVM for the processor's name and passes it to clang. LLVM
calls every newer processor "generic", and clang then rejects each build with "unknown target CPU 'generic'".
No environment variable and no build option changes that name. Without this module there is therefore no
OpenCL device on any x86-64 processor that is newer than the wheel and has no driver of its own.

How it works: PoCL keeps a pointer to the name in its structure of the device, at byte 640 in this build of
the library. The characters there are overwritten by a name of the same length that fits the processor.

Why that is safe: nothing is written unless the wheel's version, the driver's version, the library's file (its
name holds a hash of its content), the place of the pointer and the name there are exactly the known ones.
Memory is read through /proc/self/mem, so a wrong address cannot end the process. `msb.cl.trial` then builds
and runs kernels with the new name in a process of its own first. Delete this module as soon as there is a
wheel that knows today's processors.
"""

import contextlib
import os
import platform
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

# The environment variable that switches this off with the value 0.
MEND_VARIABLE = "MSB_MEND_POCL"
# A processor with AVX2 and FMA. A name with AVX-512 gains nothing: the speed is the same within a tenth.
NAME = b"haswell"
UNKNOWN = b"generic"
_WHEEL = "pocl-binary-distribution"
_WHEEL_VERSION = "3.0"
# The wheel's version, as its driver reports it.
DRIVER = "3.0-rc2"
# The file's name holds a hash of its content, which `auditwheel` put there.
_LIBRARY = "libpocl-21062cec.so"
# The byte of the device's structure at which the pointer to the name lies, in this build of the library.
_SLOT = 640
# The number of bytes of the structure in which no other pointer may lead to such a name.
_STRUCTURE = 1024
_NEEDS = frozenset(("avx2", "fma", "bmi1", "bmi2", "f16c", "movbe"))
_LZCNT = frozenset(("abm", "lzcnt"))  # Linux says abm
_LONGEST = 64
# Addresses of the structures of devices whose name we have overwritten.
_mended: set[int] = set()


def is_off() -> bool:
    """Return whether the user switched mending off."""
    return os.environ.get(MEND_VARIABLE) == "0"


def hindrance() -> str | None:
    """Return what keeps this machine from being mended, whatever the compiler says, or None."""
    if is_off():
        return f"{MEND_VARIABLE}=0 keeps it from being mended"
    if lacking := _lacking():
        return f"{NAME.decode()} cannot stand for it, since it lacks {', '.join(lacking)}"
    return None


def is_wheel(device: Any) -> bool:
    """Return whether a pyopencl device belongs to the known version of the PoCL wheel."""
    return (
        sys.platform == "linux"
        and platform.machine() == "x86_64"
        and device.platform.name.strip() == "Portable Computing Language"
        and device.driver_version.strip() == DRIVER
        and _the_wheel_is_loaded()
    )


def compiler_cpu(device: Any) -> str | None:
    """Return the processor's name that the wheel gives its compiler; None for any other platform."""
    if not is_wheel(device):
        return None
    place = _pointer(device)
    name = place and _read(place, _LONGEST)
    if not name or b"\0" not in name:
        return None
    text = name.partition(b"\0")[0]
    return text.decode("ascii") if text.isascii() and text.decode("ascii").isprintable() else None


def can_mend(device: Any) -> bool:
    """Return whether the wheel's compiler gets a name it refuses, and `NAME` fits this processor."""
    if hindrance() or compiler_cpu(device) != UNKNOWN.decode():
        return False
    words = _read(device.int_ptr, _STRUCTURE)
    if words is None:
        return False
    pointers = (int.from_bytes(words[at : at + 8], "little") for at in range(0, _STRUCTURE, 8))
    wanted = UNKNOWN + b"\0"
    return [at for at, there in enumerate(pointers) if _read(there, len(wanted)) == wanted] == [_SLOT // 8]


def mend(device: Any) -> bool:
    """Overwrite the name, if `can_mend`; return whether the name is ours now."""
    if can_mend(device):
        _write(device, UNKNOWN, NAME)
        _mended.add(device.int_ptr)
    return is_mended(device)


def is_mended(device: Any) -> bool:
    """Return whether `mend` gave this device its name."""
    return device.int_ptr in _mended and compiler_cpu(device) == NAME.decode()


def undo(device: Any) -> None:
    """Put back the name that `mend` replaced."""
    if is_mended(device):
        _write(device, NAME, UNKNOWN)
    _mended.discard(device.int_ptr)


def _write(device: Any, there: bytes, wanted: bytes) -> None:
    """Replace the characters of the name; both are as long, so neither pointer nor memory changes."""
    import ctypes

    place = _pointer(device)
    if place and len(there) == len(wanted) and _read(place, len(there) + 1) == there + b"\0":
        ctypes.memmove(place, wanted, len(wanted))


def _pointer(device: Any) -> int | None:
    pointer = _read(device.int_ptr + _SLOT, 8)
    return None if pointer is None else int.from_bytes(pointer, "little")


def _read(address: int, size: int) -> bytes | None:
    """Return bytes of this process, None where there are none: a wrong guess must not end it."""
    with (
        contextlib.suppress(OSError, OverflowError, ValueError),
        Path("/proc/self/mem").open("rb", 0) as memory,
    ):
        memory.seek(address)
        content: bytes = memory.read(size)
        return content if len(content) == size else None
    return None


@cache
def _the_wheel_is_loaded() -> bool:
    try:
        wheel = metadata.distribution(_WHEEL)
    except metadata.PackageNotFoundError:
        return False
    files = [Path(str(file.locate())) for file in wheel.files or () if file.name == _LIBRARY]
    with contextlib.suppress(OSError):
        return wheel.version == _WHEEL_VERSION and any(_is_mapped(file) for file in files)
    return False


def _is_mapped(file: Path) -> bool:
    with Path("/proc/self/maps").open(encoding="utf-8", errors="replace") as maps:
        return file.exists() and any(line.rstrip().endswith(str(file.resolve())) for line in maps)


def _lacking() -> list[str]:
    """Return what `NAME` promises and a processor of this machine does not have."""
    lines = []
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    flags = {line.partition(":")[2] for line in lines if line.startswith("flags")} or {""}
    common = frozenset.intersection(*(frozenset(text.split()) for text in flags))
    return sorted(_NEEDS - common) + ([] if common & _LZCNT else ["lzcnt"])

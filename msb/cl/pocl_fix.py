"""Let the PoCL wheel build kernels on processors that are unknown to its compiler.

Purpose: after `pip install meshsplatbench`, rendering must work without a driver. The only PoCL wheel for
x86-64 is 3.0-rc2 of 2022 with LLVM 14. The PoCL wheel asks LLVM for the name of the processor and passes
this name to clang. LLVM calls every newer processor "generic", and clang then rejects each build with
"unknown target CPU 'generic'". No environment variable and no build option changes the processor name.
Without this module, x86-64 processors that are newer than the PoCL wheel have no OpenCL device unless a
driver is installed.

Method: PoCL's device structure has a pointer to the processor name, at byte 640 in this build of the library.
The module overwrites the characters of this name with the name of a compatible processor of the same length.

Safety: the module writes only if five facts have the expected values. The five facts are: the version of the
wheel, the version of the driver, the file name of the library with its content hash, the offset of the
pointer, and the name at the pointer. Memory is read through /proc/self/mem, so a wrong address cannot crash
the process. `msb.cl.trial` first builds and runs kernels with the new processor name in a separate process.
Delete this module as soon as a PoCL wheel knows current processors.
"""

import contextlib
import os
import platform
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

# Environment variable; the value 0 disables this module.
FIX_VARIABLE = "MSB_MEND_POCL"
# The processor name given to the compiler: a processor with AVX2 and FMA. A processor name with
# AVX-512 would change the speed by less than 10 %.
NAME = b"haswell"
UNKNOWN = b"generic"
_WHEEL = "pocl-binary-distribution"
_WHEEL_VERSION = "3.0"
# Version of the PoCL wheel as its driver reports it.
DRIVER = "3.0-rc2"
# The file name of the library contains a hash of the content, added by `auditwheel`.
_LIBRARY = "libpocl-21062cec.so"
# Byte offset of the pointer to the processor name in the device structure of this build of the library.
_SLOT = 640
# Number of bytes of the device structure to check. The pointer at _SLOT must be the only pointer to the
# processor name.
_STRUCTURE = 1024
_NEEDS = frozenset(("avx2", "fma", "bmi1", "bmi2", "f16c", "movbe"))
_LZCNT = frozenset(("abm", "lzcnt"))  # Linux reports lzcnt as abm
_LONGEST = 64
# Addresses of device structures whose processor name was replaced.
_fixed: set[int] = set()


def is_off() -> bool:
    """Return whether the user disabled this fix."""
    return os.environ.get(FIX_VARIABLE) == "0"


def obstacle() -> str | None:
    """Return the reason why the fix cannot be applied on this machine, or None. This function does not check
    which processor name the compiler gets."""
    if is_off():
        return f"{FIX_VARIABLE}=0 disables the fix"
    if lacking := _find_lacking():
        return f"the processor cannot be treated as {NAME.decode()}, because it lacks {', '.join(lacking)}"
    return None


def is_wheel(device: Any) -> bool:
    """Return whether a pyopencl device belongs to the known version of the PoCL wheel."""
    return (
        sys.platform == "linux"
        and platform.machine() == "x86_64"
        and device.platform.name.strip() == "Portable Computing Language"
        and device.driver_version.strip() == DRIVER
        and _is_wheel_loaded()
    )


def compiler_cpu(device: Any) -> str | None:
    """Return the processor name that the PoCL wheel passes to its compiler, or None for other platforms."""
    if not is_wheel(device):
        return None
    place = _read_pointer(device)
    name = place and _read(place, _LONGEST)
    if not name or b"\0" not in name:
        return None
    text = name.partition(b"\0")[0]
    return text.decode("ascii") if text.isascii() and text.decode("ascii").isprintable() else None


def can_apply(device: Any) -> bool:
    """Return true if this processor is unknown to the PoCL wheel but compatible with `NAME`."""
    if obstacle() or compiler_cpu(device) != UNKNOWN.decode():
        return False
    words = _read(device.int_ptr, _STRUCTURE)
    if words is None:
        return False
    pointers = (int.from_bytes(words[at : at + 8], "little") for at in range(0, _STRUCTURE, 8))
    name = UNKNOWN + b"\0"
    return [at for at, address in enumerate(pointers) if _read(address, len(name)) == name] == [_SLOT // 8]


def apply(device: Any) -> bool:
    """Replace the processor name if `can_apply` allows it. Return whether the processor name is now
    `NAME`."""
    if can_apply(device):
        _write(device, UNKNOWN, NAME)
        _fixed.add(device.int_ptr)
    return is_applied(device)


def is_applied(device: Any) -> bool:
    """Return whether the processor name of this device was replaced."""
    return device.int_ptr in _fixed and compiler_cpu(device) == NAME.decode()


def undo(device: Any) -> None:
    """Restore the original processor name of the device."""
    if is_applied(device):
        _write(device, NAME, UNKNOWN)
    _fixed.discard(device.int_ptr)


def _write(device: Any, old: bytes, new: bytes) -> None:
    """Overwrite the processor name `old` with the name `new` of the same length.

    If the device has another processor name than `old`, nothing is changed.
    """
    import ctypes

    place = _read_pointer(device)
    if place and len(old) == len(new) and _read(place, len(old) + 1) == old + b"\0":
        ctypes.memmove(place, new, len(new))


def _read_pointer(device: Any) -> int | None:
    pointer = _read(device.int_ptr + _SLOT, 8)
    return None if pointer is None else int.from_bytes(pointer, "little")


def _read(address: int, size: int) -> bytes | None:
    """Return `size` bytes of the memory of this process, or None for an invalid address."""
    with (
        contextlib.suppress(OSError, OverflowError, ValueError),
        Path("/proc/self/mem").open("rb", 0) as memory,
    ):
        memory.seek(address)
        content: bytes = memory.read(size)
        return content if len(content) == size else None
    return None


@cache
def _is_wheel_loaded() -> bool:
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


def _find_lacking() -> list[str]:
    """Return the processor features of `NAME` that this machine lacks."""
    lines = []
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    flags = {line.partition(":")[2] for line in lines if line.startswith("flags")} or {""}
    common = frozenset.intersection(*(frozenset(text.split()) for text in flags))
    return sorted(_NEEDS - common) + ([] if common & _LZCNT else ["lzcnt"])

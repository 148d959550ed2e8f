"""Try once, in a process of its own, whether a device builds and runs kernels, and remember the result.

A platform that is listed need not work: its compiler may not know the processor, or may end the process. The
trial builds and runs trial.cl in a child process. The user's cache keeps the result under everything that can
change it: platform, driver, processor, and the text of the trial.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import threading
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from msb.base.atomic import new_file
from msb.base.children import Arrays, run_apart
from msb.base.limits import Limits
from msb.base.version import __version__
from msb.cl import mend
from msb.cl.device import Device
from msb.cl.kernel_text import OWN, resolve
from msb.cl.loader import opencl, user_cache
from msb.cl.records import DeviceRecord
from msb.errors import DeviceError, OutputError, one_line, shorten

# Seconds that a trial may take on a busy machine, the compiler's own start included; it mostly takes a tenth.
_SECONDS = 120.0
# Work-items of the trial.
_COUNT = 64
_MOST_REMEMBERED, _MOST_BYTES = 64, 1 << 18

_lock = threading.Lock()
_known: dict[int, Trial] = {}


@dataclass(frozen=True)
class Trial:
    """The result of building and running a small kernel.

    Attributes
    ----------
    builds : bool
    why : str or None
        What the compiler or the system said, if the device does not build kernels.
    mended : str or None
        The processor's name that `msb.cl.mend` had to give the compiler first.
    """

    builds: bool
    why: str | None = None
    mended: str | None = None


def try_device(handle: Any, record: DeviceRecord, *, again: bool = False) -> Trial:
    """Return whether the device builds kernels; mend the PoCL wheel if that is necessary and possible.

    Parameters
    ----------
    handle : pyopencl.Device
    record : DeviceRecord
    again : bool
        Whether to try again, whatever an earlier trial found.
    """
    with _lock:
        known = None if again else _known.get(handle.int_ptr)
        if known is None:
            mend.undo(handle)
            key = _key(handle, record)
            known = None if again else _remembered().get(key)
            if known is None:
                known, lasting = _try(handle, record)
                if lasting:
                    _remember(key, known)
            if known.mended and not mend.mend(handle):
                known = Trial(False, "its compiler's processor could not be named")
            _known[handle.int_ptr] = known
        return known


def forget() -> None:
    """Forget the results of this process, so that the next call looks into the cache, or tries again."""
    with _lock:
        _known.clear()


def _try(handle: Any, record: DeviceRecord) -> tuple[Trial, bool]:
    """Return what a trial found, and whether that will be so the next time."""
    why, lasting = _why_not(record, mended=False)
    if why is None:
        return Trial(True), True
    if mend.can_mend(handle) and _why_not(record, mended=True)[0] is None:
        return Trial(True, mended=mend.NAME.decode()), True
    return Trial(False, why), lasting


def _why_not(record: DeviceRecord, *, mended: bool) -> tuple[str | None, bool]:
    """Try in a child process; return None or what went wrong, and whether its compiler said so."""
    word = f"{record.selector} {'mended' if mended else 'as it is'}"
    try:
        reply = run_apart(try_here, word, {}, Limits(_SECONDS, None))
    except (OSError, OutputError) as error:
        return f"no process could be started to try it: {shorten(str(error), 100)}", False
    if reply.why:
        return f"trying it in a process of its own failed: {reply.why}", False
    return reply.data, True


def try_here(word: str, arrays: Arrays) -> tuple[str | None, Arrays]:
    """Build and run trial.cl in this process, which is a child; return why the device does not work, or None.

    `word` is the device's selector, and whether its compiler is mended first; there are no `arrays`.
    """
    os.environ["POCL_KERNEL_CACHE"] = "0"  # a kernel out of a cache says nothing of the compiler
    from msb.cl.devices import found_devices

    cl = opencl()
    selector, _, state = word.partition(" ")
    for record, handle in found_devices(cl):
        if record.selector != selector:
            continue
        if state == "mended" and not mend.mend(handle):
            return "its compiler's processor could not be named", {}
        try:
            with Device(cl, handle, record) as device:
                return (None if _is_right(device) else "it computes a small kernel wrongly"), {}
        except DeviceError as error:
            return error.message, {}
    return f"{selector} is not there in a process of its own", {}


def _is_right(device: Device) -> bool:
    given = (np.arange(8 * _COUNT, dtype=np.float32) / 16).reshape(_COUNT, 8)
    halves = device.allocate(given.shape, np.float32)
    rounded = device.allocate(given.shape, np.int32)
    program = device.program("trial")
    program.trial(_COUNT, 1, device.upload(given), halves, rounded, np.uint32(_COUNT))
    wanted = np.maximum(np.sqrt(given), 1) / 2
    return bool(
        np.allclose(halves.read(), wanted, rtol=1e-6, atol=0)
        and (rounded.read() == given.astype(np.int32) - (given > 4)).all()
    )


def _key(handle: Any, record: DeviceRecord) -> str:
    said = (
        *(record.platform, record.platform_version, record.driver, record.name, record.version),
        *(mend.compiler_cpu(handle), mend.is_off(), _processor(), __version__, resolve(OWN, "trial.cl")),
    )
    return hashlib.sha256(repr(said).encode()).hexdigest()[:32]


@cache
def _processor() -> str:
    """Return what distinguishes this machine's processor from another."""
    with contextlib.suppress(OSError):
        first = Path("/proc/cpuinfo").read_text("utf-8", "replace").partition("\n\n")[0]
        names = ("vendor_id", "cpu family", "model", "model name", "stepping", "flags", "Features")
        return "\n".join(line for line in first.splitlines() if line.partition(":")[0].strip() in names)
    return f"{platform.machine()} {platform.processor()}"


def _file() -> Path | None:
    folder = user_cache()
    return None if folder is None else folder / "meshsplatbench" / "devices.txt"


def _remembered() -> dict[str, Trial]:
    """Return what the cache says, a line a device: KEY builds MENDED, or KEY fails WHY; skip other lines."""
    file, text = _file(), ""
    with contextlib.suppress(OSError):
        if file is not None and file.stat().st_size <= _MOST_BYTES:
            text = file.read_text("utf-8", "replace")
    trials: dict[str, Trial] = {}
    for line in text.splitlines():
        key, _, rest = line.partition(" ")
        outcome, _, said = rest.partition(" ")
        if outcome == "builds":
            trials[key] = Trial(True, mended=said or None)
        elif outcome == "fails":
            trials[key] = Trial(False, said)
    return trials


def _remember(key: str, found: Trial) -> None:
    file = _file()
    if file is None:
        return
    held = {**_remembered(), key: found}
    lines = [
        f"{name} builds {trial.mended or ''}" if trial.builds else f"{name} fails {one_line(trial.why or '')}"
        for name, trial in list(held.items())[-_MOST_REMEMBERED:]
    ]
    with contextlib.suppress(OutputError, OSError), new_file(file) as stream:
        stream.write("\n".join([*lines, ""]).encode())

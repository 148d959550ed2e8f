"""Test in a child process whether a device builds and runs kernels, and cache the result.

An OpenCL device that a platform lists does not always work. The compiler of a device may not know the
processor, or may crash. The trial builds and runs trial.cl in a child process. The result of this test is
stored in the user's cache. The cache key includes everything that can change the result: platform, driver,
processor, program version and trial.cl.
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
from msb.base.children import Arrays, run_in_child
from msb.base.limits import Limits
from msb.base.version import __version__
from msb.cl import pocl_fix
from msb.cl.device import Device
from msb.cl.kernel_text import OWN, resolve
from msb.cl.loader import opencl, user_cache
from msb.cl.records import DeviceRecord
from msb.errors import DeviceError, OutputError, one_line, shorten

# Time limit of a device trial in seconds, including the start of the compiler. A typical device trial takes
# 12 seconds, or longer on a busy machine.
_SECONDS = 120.0
# Number of work-items in the trial kernel.
_COUNT = 64
# Maximum number of results in the cache file, and its maximum size in bytes.
_MOST_REMEMBERED, _MOST_BYTES = 64, 1 << 18

_lock = threading.Lock()
_known: dict[int, Trial] = {}


@dataclass(frozen=True)
class Trial:
    """The result of building and running a small kernel on a device.

    Attributes
    ----------
    builds : bool
    why : str or None
        The message of the compiler or the system if the device does not build kernels.
    mended : str or None
        The processor name that `msb.cl.pocl_fix` gave the compiler before the trial, if that was necessary.
    """

    builds: bool
    why: str | None = None
    mended: str | None = None


def try_device(handle: Any, record: DeviceRecord, *, again: bool = False) -> Trial:
    """Return whether the device builds kernels. If necessary and possible, repair the PoCL wheel first
    (`msb.cl.pocl_fix`).

    Parameters
    ----------
    handle : pyopencl.Device
    record : DeviceRecord
    again : bool
        Whether to repeat the trial even if an earlier result is known.
    """
    with _lock:
        known = None if again else _known.get(handle.int_ptr)
        if known is None:
            pocl_fix.undo(handle)
            key = _compute_key(handle, record)
            known = None if again else _read_results().get(key)
            if known is None:
                known, lasting = _try(handle, record)
                if lasting:
                    _store_result(key, known)
            if known.mended and not pocl_fix.apply(handle):
                known = Trial(False, "the processor name of the device's compiler could not be replaced")
            _known[handle.int_ptr] = known
        return known


def forget() -> None:
    """Forget the results of this process, so that the next call reads the cache or repeats the trial."""
    with _lock:
        _known.clear()


def _try(handle: Any, record: DeviceRecord) -> tuple[Trial, bool]:
    """Return the result of a device trial, and whether the result may be cached."""
    why, lasting = _find_failure(record, mended=False)
    if why is None:
        return Trial(True), True
    if pocl_fix.can_apply(handle) and _find_failure(record, mended=True)[0] is None:
        return Trial(True, mended=pocl_fix.NAME.decode()), True
    return Trial(False, why), lasting


def _find_failure(record: DeviceRecord, *, mended: bool) -> tuple[str | None, bool]:
    """Run the device trial in a child process. Return the failure of the trial (or None), and whether a
    repetition would give the same result."""
    request = f"{record.selector} {'mended' if mended else 'as it is'}"
    try:
        reply = run_in_child(run_trial, request, {}, Limits(_SECONDS, None))
    except (OSError, OutputError) as error:
        return f"no child process could be started for the trial: {shorten(str(error), 100)}", False
    if reply.why:
        return f"the trial in a child process failed: {reply.why}", False
    return reply.data, True


def run_trial(word: str, arrays: Arrays) -> tuple[str | None, Arrays]:
    """Build and run trial.cl in a child process. Return the reason why the device does not work, or None.

    The argument `word` names the device, and states whether to repair the device's compiler first. `arrays`
    is empty.
    """
    os.environ["POCL_KERNEL_CACHE"] = "0"  # a cached kernel would hide compiler failures
    from msb.cl.devices import find_devices

    cl = opencl()
    selector, _, state = word.partition(" ")
    for record, handle in find_devices(cl):
        if record.selector != selector:
            continue
        if state == "mended" and not pocl_fix.apply(handle):
            return "the processor name of the device's compiler could not be replaced", {}
        try:
            with Device(cl, handle, record) as device:
                return (
                    None if _computes_correctly(device) else "the device computes a small kernel incorrectly"
                ), {}
        except DeviceError as error:
            return error.message, {}
    return f"{selector} does not exist in a child process", {}


def _computes_correctly(device: Device) -> bool:
    values = (np.arange(8 * _COUNT, dtype=np.float32) / 16).reshape(_COUNT, 8)
    halves = device.allocate(values.shape, np.float32)
    rounded = device.allocate(values.shape, np.int32)
    program = device.program("trial")
    program.trial(_COUNT, 1, device.upload(values), halves, rounded, np.uint32(_COUNT))
    expected = np.maximum(np.sqrt(values), 1) / 2
    return bool(
        np.allclose(halves.read(), expected, rtol=1e-6, atol=0)
        and (rounded.read() == values.astype(np.int32) - (values > 4)).all()
    )


def _compute_key(handle: Any, record: DeviceRecord) -> str:
    facts = (
        *(record.platform, record.platform_version, record.driver, record.name, record.version),
        *(
            pocl_fix.compiler_cpu(handle),
            pocl_fix.is_off(),
            _describe_processor(),
            __version__,
            resolve(OWN, "trial.cl"),
        ),
    )
    return hashlib.sha256(repr(facts).encode()).hexdigest()[:32]


@cache
def _describe_processor() -> str:
    """Return the properties that distinguish this processor from other processors."""
    with contextlib.suppress(OSError):
        first = Path("/proc/cpuinfo").read_text("utf-8", "replace").partition("\n\n")[0]
        names = ("vendor_id", "cpu family", "model", "model name", "stepping", "flags", "Features")
        return "\n".join(line for line in first.splitlines() if line.partition(":")[0].strip() in names)
    return f"{platform.machine()} {platform.processor()}"


def _find_cache_file() -> Path | None:
    folder = user_cache()
    return None if folder is None else folder / "meshsplatbench" / "devices.txt"


def _read_results() -> dict[str, Trial]:
    """Return the cached trial results. Each line of the file is "KEY builds MENDED" or "KEY fails WHY"."""
    file, text = _find_cache_file(), ""
    with contextlib.suppress(OSError):
        if file is not None and file.stat().st_size <= _MOST_BYTES:
            text = file.read_text("utf-8", "replace")
    trials: dict[str, Trial] = {}
    for line in text.splitlines():
        key, _, rest = line.partition(" ")
        outcome, _, detail = rest.partition(" ")
        if outcome == "builds":
            trials[key] = Trial(True, mended=detail or None)
        elif outcome == "fails":
            trials[key] = Trial(False, detail)
    return trials


def _store_result(key: str, result: Trial) -> None:
    file = _find_cache_file()
    if file is None:
        return
    results = {**_read_results(), key: result}
    lines = [
        f"{name} builds {trial.mended or ''}" if trial.builds else f"{name} fails {one_line(trial.why or '')}"
        for name, trial in list(results.items())[-_MOST_REMEMBERED:]
    ]
    with contextlib.suppress(OutputError, OSError), new_file(file) as stream:
        stream.write("\n".join([*lines, ""]).encode())

"""Try once, in a process of its own, whether a device builds and runs kernels, and remember the result.

A platform that is listed need not work: its compiler may not know the processor, or may end the process. The
trial builds and runs trial.cl in a child process. The user's cache keeps the result under everything that can
change it: platform, driver, processor, and the text of the trial.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import platform
import subprocess
import threading
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb._version import __version__
from msb.base.atomic import new_file
from msb.base.children import ending, environment, last_line, module_command
from msb.cl import mend
from msb.cl.kernel_text import OWN, resolve
from msb.cl.loader import user_cache
from msb.errors import OutputError, one_line, shorten

if TYPE_CHECKING:
    from msb.cl.records import DeviceRecord

_SECONDS = 120.0
"""Seconds that a trial may take on a busy machine, the compiler's own start included; it mostly takes a
tenth."""
_MOST_REMEMBERED, _MOST_BYTES = 64, 1 << 18
_CHILD = "msb.cl.trial_child"
ANSWER = "msb-trial "
"""The text that precedes the child's answer in its output."""

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
        found = None if again else _known.get(handle.int_ptr)
        if found is None:
            mend.undo(handle)
            key = _key(handle, record)
            found = None if again else _remembered().get(key)
            if found is None:
                found, lasting = _try(handle, record)
                if lasting:
                    _remember(key, found)
            if found.mended and not mend.mend(handle):
                found = Trial(False, "its compiler's processor could not be named")
            _known[handle.int_ptr] = found
        return found


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
    # A kernel out of a cache says nothing of the compiler.
    variables = environment({"POCL_KERNEL_CACHE": "0"})
    words = module_command(_CHILD, record.selector, str(int(mended)))
    try:
        child = subprocess.run(
            words,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_SECONDS,
            env=variables,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"its compiler did not answer within {_SECONDS:g} s", False
    except OSError as error:
        return f"no process could be started to try it: {shorten(str(error), 100)}", False
    answers = [line for line in child.stdout.splitlines() if line.startswith(ANSWER)]
    if child.returncode == 0 and answers:
        why: str | None = json.loads(answers[-1].removeprefix(ANSWER))
        return why, True
    how = f"({ending(child.returncode)}) {last_line(child.stderr, 150)}".rstrip()
    return f"its compiler ended the process {how}", False


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
    found: dict[str, Trial] = {}
    for line in text.splitlines():
        key, _, rest = line.partition(" ")
        outcome, _, said = rest.partition(" ")
        if outcome == "builds":
            found[key] = Trial(True, mended=said or None)
        elif outcome == "fails":
            found[key] = Trial(False, said)
    return found


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

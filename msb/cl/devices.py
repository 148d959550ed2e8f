"""List the OpenCL devices and choose one by a selector."""

import os
import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

from msb.cl import pocl_fix
from msb.cl.device import Device
from msb.cl.loader import describe_search, how_to_get_a_device, how_to_get_another, opencl
from msb.cl.programs import UNKNOWN_CPU
from msb.cl.records import DeviceRecord, Style, describe, short_name
from msb.cl.trial import Trial, try_device
from msb.errors import DeviceError, UsageError, shorten

DEVICE_VARIABLE = "MSB_DEVICE"
PYOPENCL_VARIABLE = "PYOPENCL_CTX"
# Kinds of devices, which a selector can name instead of a platform.
KINDS = ("cpu", "gpu")


class Choice(NamedTuple):
    """The chosen device and the origin of its selector."""

    record: DeviceRecord
    selector: str | None
    # Origin of the selector: "argument", the name of an environment variable, or "default".
    source: str


class Tried(NamedTuple):
    """A device and the result of its trial. The trial builds and runs a small kernel."""

    record: DeviceRecord
    trial: Trial
    # Advice to the user if the device cannot build kernels, otherwise None.
    advice: str | None


def list_devices() -> list[DeviceRecord]:
    """Return every OpenCL device with a compiler, in the order of the platforms; the list may be empty."""
    return [record for record, _ in find_devices(opencl())]


def try_devices() -> list[Tried]:
    """Build and run a small kernel on every device, even if an earlier result is cached."""
    tried = []
    for record, handle in find_devices(opencl()):
        trial = try_device(handle, record, again=True)
        tried.append(Tried(record, trial, None if trial.builds else _advise(record, handle, trial.why or "")))
    return tried


def choose_device(selector: str | None = None) -> Choice:
    """Return the device that `open_device` would open."""
    return _choose(find_devices(opencl()), selector)[0]


def open_device(selector: str | None = None, *, style: Style | None = None) -> Device:
    """Open the device named by `selector`. The default is MSB_DEVICE, then PYOPENCL_CTX, then PoCL.

    If several devices match, the first device that builds kernels is opened (`msb.cl.trial`). PoCL keeps
    about 1 MB of memory for each program even after the device is closed. Use `shared_device` to avoid
    opening several devices.

    Parameters
    ----------
    selector : str, optional
        ``cpu``, ``gpu``, ``PLATFORM`` or ``PLATFORM:INDEX``. PLATFORM is the number of a platform or part of
        its name (``pocl``, ``intel``, ``nvidia``). INDEX is the number of a device on the platform, counted
        from 0. Without a selector, CPUs are preferred to GPUs, and PoCL to other CPU platforms.
    style : "cpu" | "gpu", optional
        The kernel style, independent of the device; only for tests.

    Raises
    ------
    DeviceError
        `DEVICE_NOT_FOUND`: no such device; the message lists the searched places and the existing devices.
        `DEVICE_BUILD`: no matching device can build kernels; the message gives the reason and a remedy.
    UsageError
        `DEVICE_SELECTOR`: the selector is malformed.
    """
    cl = opencl()
    choice, handle = _choose(find_devices(cl), selector)
    return Device(cl, handle, choice.record, style)


def shared_device(selector: str | None = None, *, style: Style | None = None) -> Device:
    """Return the shared device of this process, which is opened on first use and stays open.

    Parameters and errors are documented at `open_device`. Threads take turns on the device
    (`Device.using`). A device with a failed command is opened again.
    """
    cl = opencl()
    choice, handle = _choose(find_devices(cl), selector)
    with _sharing:
        device, process = _shared.get((handle.int_ptr, style), (None, os.getpid()))
        if process != os.getpid():
            raise DeviceError("DEVICE_CLOSED", "a forked process cannot use the device of its parent")
        if device is None or device.failed:
            device = Device(cl, handle, choice.record, style)
            _shared[handle.int_ptr, style] = device, process
        return device


_sharing = threading.Lock()
# The open devices, each with the process that opened it. A key is the address of the platform's device and
# the kernel style.
_shared: dict[tuple[int, Style | None], tuple[Device, int]] = {}


def find_devices(cl: Any) -> list[tuple[DeviceRecord, Any]]:
    """Return the description and the pyopencl object of every device."""
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # PLATFORM_NOT_FOUND_KHR means that no platform is installed
        return []
    known: list[tuple[DeviceRecord, Any]] = []
    counts: dict[str, int] = {}
    for number, platform in enumerate(platforms):
        try:
            devices = platform.get_devices()
        except cl.Error:
            continue
        short = short_name(platform.name.strip())
        for device in devices:
            if device.available and device.compiler_available:
                index = counts[short] = counts.get(short, -1) + 1
                known.append((describe(cl, device, f"{short}:{index}", number), device))
    return known


def _choose(known: Sequence[tuple[DeviceRecord, Any]], selector: str | None) -> tuple[Choice, Any]:
    """Return the selected device and its pyopencl handle."""
    source = "argument"
    if selector is None:
        source = next(
            (name for name in (DEVICE_VARIABLE, PYOPENCL_VARIABLE) if os.environ.get(name)), "default"
        )
        selector = os.environ.get(source) if source != "default" else None
    records = [record for record, _ in known]
    if not records:
        target = f" for {_quote(selector, source)}" if selector else ""
        text = f"no OpenCL device{target} ({describe_search()}): {how_to_get_a_device()}"
        raise DeviceError("DEVICE_NOT_FOUND", text)
    matches = records if selector is None else _match(records, selector, source)
    by_platform = selector is not None and selector.strip().lower() not in KINDS
    if not matches:
        text = f"{_quote(selector, source)} matches no OpenCL device; available: "
        raise DeviceError("DEVICE_NOT_FOUND", text + ", ".join(record.selector for record in records))
    handles = {record.selector: handle for record, handle in known}
    matches = sorted(matches, key=_is_old_wheel if by_platform else _rank)
    for record in matches:
        if try_device(handles[record.selector], record).builds:
            return Choice(record, selector, source), handles[record.selector]
    reasons = [try_device(handles[record.selector], record).why or "" for record in matches]
    text = "; ".join(
        f"{record} does not build kernels: {why}" for record, why in zip(matches, reasons, strict=True)
    )
    advice = _advise(matches[0], handles[matches[0].selector], reasons[0])
    raise DeviceError("DEVICE_BUILD", f"{text}. {advice}")


def _advise(record: DeviceRecord, handle: Any, why: str) -> str:
    """Return advice for a device that does not build kernels."""
    if UNKNOWN_CPU not in why:
        return f"Choose another device (msb devices), or repair its platform. {how_to_get_another()}"
    if not pocl_fix.is_wheel(handle):
        return f"The platform's compiler is older than this processor. {how_to_get_another()}"
    obstacle = pocl_fix.obstacle()
    detail = f" ({obstacle})" if obstacle else ""
    text = f"The PoCL wheel dates from 2022, and its compiler does not support this processor{detail}."
    return f"{text} {how_to_get_another()}"


def _match(records: Sequence[DeviceRecord], selector: str, source: str) -> list[DeviceRecord]:
    text = selector.strip().lower()
    if text in KINDS:
        return [record for record in records if record.kind == text]
    # PYOPENCL_CTX may list several devices, separated by commas; only the first is used.
    platform, colon, index = text.partition(",")[0].partition(":")
    if not platform or (colon and not index) or ":" in index:
        text = f"{_quote(selector, source)} is not a device selector; use cpu, gpu or PLATFORM:INDEX"
        raise UsageError("DEVICE_SELECTOR", text)
    on_platform = [record for record in records if _is_on(record, platform)]
    if not colon:
        return on_platform
    if index.isdecimal():
        return on_platform[int(index) : int(index) + 1]
    return [record for record in on_platform if index in record.name.lower()][:1]


def _is_on(record: DeviceRecord, platform: str) -> bool:
    if platform.isdecimal():
        return record.platform_index == int(platform)
    return platform == short_name(record.platform) or platform in record.platform.lower()


_PREFERRED_PLATFORMS = ("pocl", "intel")


def _rank(record: DeviceRecord) -> tuple[bool, int, bool]:
    """Return a sort key: CPUs first, then PoCL, then the Intel runtime."""
    name = short_name(record.platform)
    rank = _PREFERRED_PLATFORMS.index(name) if name in _PREFERRED_PLATFORMS else len(_PREFERRED_PLATFORMS)
    return record.kind != "cpu", rank, _is_old_wheel(record)


def _is_old_wheel(record: DeviceRecord) -> bool:
    """Return whether the device belongs to the PoCL wheel. The PoCL wheel is older than the PoCL package of
    the system."""
    return record.driver == pocl_fix.DRIVER


def _quote(selector: str | None, source: str) -> str:
    name = "device" if source == "argument" else source
    return f"{name} '{shorten(selector or '', 60)}'"

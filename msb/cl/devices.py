"""List the OpenCL devices, and choose the one that a selector means."""

import os
import threading
from collections.abc import Sequence
from typing import Any, NamedTuple

from msb.cl import mend
from msb.cl.device import Device
from msb.cl.loader import how_to_get_a_device, how_to_get_another, looked_for, opencl
from msb.cl.programs import UNKNOWN_CPU
from msb.cl.records import DeviceRecord, Style, describe, short_name
from msb.cl.trial import Trial, try_device
from msb.errors import DeviceError, UsageError, shorten

DEVICE_VARIABLE = "MSB_DEVICE"
PYOPENCL_VARIABLE = "PYOPENCL_CTX"
# The kinds of devices that a selector can name instead of a platform.
KINDS = ("cpu", "gpu")


class Choice(NamedTuple):
    """The device that was chosen, and the reason."""

    record: DeviceRecord
    selector: str | None
    # The source of the selector: "argument", an environment variable, or "default".
    source: str


class Tried(NamedTuple):
    """A device, and the result of trying it."""

    record: DeviceRecord
    trial: Trial
    # What to do if the device does not build kernels, or None.
    advice: str | None


def list_devices() -> list[DeviceRecord]:
    """Return every OpenCL device that says it compiles, in the order platforms are found; possibly none."""
    return [record for record, _ in found_devices(opencl())]


def try_devices() -> list[Tried]:
    """Build and run a small kernel on every device, even if tried before; raises as `list_devices`."""
    tried = []
    for record, handle in found_devices(opencl()):
        trial = try_device(handle, record, again=True)
        tried.append(Tried(record, trial, None if trial.builds else _advice(record, handle, trial.why or "")))
    return tried


def choose_device(selector: str | None = None) -> Choice:
    """Return the device `open_device` would open."""
    return _choose(found_devices(opencl()), selector)[0]


def open_device(selector: str | None = None, *, style: Style | None = None) -> Device:
    """Open the device that `selector` names; by default MSB_DEVICE's, PYOPENCL_CTX's, or PoCL.

    A device that does not build kernels (`msb.cl.trial`) is passed over for the next one that the selector
    means. Closing a device does not give back the megabyte that PoCL keeps of each of its programs;
    `shared_device` avoids opening another device.

    Parameters
    ----------
    selector : str, optional
        ``cpu``, ``gpu``, ``PLATFORM`` or ``PLATFORM:INDEX``. PLATFORM is the number of a platform or part of
        its name (``pocl``, ``intel``, ``nvidia``), INDEX counts that platform's devices from 0. Without a
        selector, a CPU is preferred to a GPU and PoCL to other CPU platforms.
    style : "cpu" | "gpu", optional
        The style of kernels to use, whatever the device is; for tests.

    Raises
    ------
    DeviceError
        `DEVICE_NOT_FOUND`: there is no such device; the message says what was looked for and what there is.
        `DEVICE_BUILD`: no matching device builds kernels; the message says why, and what to do.
    UsageError
        `DEVICE_SELECTOR`: the text cannot name a device.
    """
    cl = opencl()
    choice, handle = _choose(found_devices(cl), selector)
    return Device(cl, handle, choice.record, style)


def shared_device(selector: str | None = None, *, style: Style | None = None) -> Device:
    """Return the device that everything in this process shares; it is opened once and stays open.

    Parameters and errors are those of `open_device`. Threads take turns on the device (`Device.using`). A
    device that has failed is opened anew.
    """
    cl = opencl()
    choice, handle = _choose(found_devices(cl), selector)
    with _sharing:
        device, process = _shared.get((handle.int_ptr, style), (None, os.getpid()))
        if process != os.getpid():
            raise DeviceError("DEVICE_CLOSED", "the device belongs to the process this one was forked from")
        if device is None or device.failed:
            device = Device(cl, handle, choice.record, style)
            _shared[handle.int_ptr, style] = device, process
        return device


_sharing = threading.Lock()
# Address of the platform's device and style -> the open device, and the process it was opened in.
_shared: dict[tuple[int, Style | None], tuple[Device, int]] = {}


def found_devices(cl: Any) -> list[tuple[DeviceRecord, Any]]:
    """Return all devices, as records and as pyopencl's devices."""
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # PLATFORM_NOT_FOUND_KHR is how a loader says that there is none
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
    """Return the device that is meant, its handle with it."""
    source = "argument"
    if selector is None:
        source = next(
            (name for name in (DEVICE_VARIABLE, PYOPENCL_VARIABLE) if os.environ.get(name)), "default"
        )
        selector = os.environ.get(source) if source != "default" else None
    records = [record for record, _ in known]
    if not records:
        wanted = f" for {_quoted(selector, source)}" if selector else ""
        text = f"there is no OpenCL device{wanted} ({looked_for()}): {how_to_get_a_device()}"
        raise DeviceError("DEVICE_NOT_FOUND", text)
    meant = records if selector is None else _matching(records, selector, source)
    named = selector is not None and selector.strip().lower() not in KINDS
    if not meant:
        text = f"{_quoted(selector, source)} names no OpenCL device; there are: "
        raise DeviceError("DEVICE_NOT_FOUND", text + ", ".join(record.selector for record in records))
    handles = {record.selector: handle for record, handle in known}
    meant = sorted(meant, key=_age if named else _preference)
    for record in meant:
        if try_device(handles[record.selector], record).builds:
            return Choice(record, selector, source), handles[record.selector]
    reasons = [try_device(handles[record.selector], record).why or "" for record in meant]
    text = "; ".join(
        f"{record} does not build kernels: {why}" for record, why in zip(meant, reasons, strict=True)
    )
    advice = _advice(meant[0], handles[meant[0].selector], reasons[0])
    raise DeviceError("DEVICE_BUILD", f"{text}. {advice}")


def _advice(record: DeviceRecord, handle: Any, why: str) -> str:
    """Return what to do where a device does not build kernels."""
    if UNKNOWN_CPU not in why:
        return f"Choose another device (msb devices), or mend its platform. {how_to_get_another()}"
    if not mend.is_wheel(handle):
        return f"The platform's compiler is older than this processor. {how_to_get_another()}"
    hindrance = mend.hindrance()
    aside = f" ({hindrance})" if hindrance else ""
    text = f"PoCL's wheel is of 2022, and its compiler does not know this processor{aside}."
    return f"{text} {how_to_get_another()}"


def _matching(records: Sequence[DeviceRecord], selector: str, source: str) -> list[DeviceRecord]:
    text = selector.strip().lower()
    if text in KINDS:
        return [record for record in records if record.kind == text]
    # PYOPENCL_CTX may name several devices, separated by commas; one is all we take.
    platform, colon, index = text.partition(",")[0].partition(":")
    if not platform or (colon and not index) or ":" in index:
        text = f"{_quoted(selector, source)} is not cpu, gpu or PLATFORM:INDEX (see msb devices)"
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


_PLATFORMS = ("pocl", "intel")


def _preference(record: DeviceRecord) -> tuple[bool, int, bool]:
    """Order devices: a CPU first, then PoCL, then Intel's runtime."""
    name = short_name(record.platform)
    rank = _PLATFORMS.index(name) if name in _PLATFORMS else len(_PLATFORMS)
    return record.kind != "cpu", rank, _age(record)


def _age(record: DeviceRecord) -> bool:
    """Order devices of one platform: the system's PoCL before the older wheel's."""
    return record.driver == mend.DRIVER


def _quoted(selector: str | None, source: str) -> str:
    name = "device" if source == "argument" else source
    return f"{name} '{shorten(selector or '', 60)}'"

"""Which devices there are, and which one is meant."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, NamedTuple

from msb.cl.device import Device
from msb.cl.loader import how_to_get_a_device, looked_for, opencl
from msb.cl.records import DeviceRecord, describe, short_name
from msb.errors import DeviceError, UsageError, shorten

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msb.cl.records import Style

DEVICE_VARIABLE = "MSB_DEVICE"
PYOPENCL_VARIABLE = "PYOPENCL_CTX"


class Choice(NamedTuple):
    """The device that is meant, and why."""

    record: DeviceRecord
    selector: str | None
    source: str
    """Where the selector comes from: "argument", an environment variable, or "default"."""


def list_devices() -> list[DeviceRecord]:
    """Return every usable OpenCL device, in the order the platforms are found; possibly none.

    Raises
    ------
    DeviceError
        `DEVICE_NOT_FOUND`: pyopencl itself cannot be loaded.
    """
    return [record for record, _ in _devices(opencl())]


def choose_device(selector: str | None = None) -> Choice:
    """Return the device `open_device` would open.

    Raises
    ------
    UsageError, DeviceError
        As `open_device`.
    """
    return _choose([record for record, _ in _devices(opencl())], selector)


def open_device(selector: str | None = None, *, style: Style | None = None) -> Device:
    """Open the device that `selector` names; by default MSB_DEVICE's, PYOPENCL_CTX's, or PoCL.

    Parameters
    ----------
    selector : str, optional
        ``cpu``, ``gpu``, ``PLATFORM`` or ``PLATFORM:INDEX``. PLATFORM is the number of a platform or part of
        its name (``pocl``, ``intel``, ``nvidia``), INDEX counts that platform's devices from 0. Without
        any, a CPU is preferred to a GPU and PoCL to other CPU platforms.
    style : "cpu" | "gpu", optional
        Kernels of this style whatever the device is; for tests.

    Raises
    ------
    DeviceError
        `DEVICE_NOT_FOUND`: there is no such device; the message says what was looked for and what there is.
    UsageError
        `DEVICE_SELECTOR`: the text cannot name a device.
    """
    cl = opencl()
    found = _devices(cl)
    record = _choose([record for record, _ in found], selector).record
    handle = next(handle for candidate, handle in found if candidate is record)
    return Device(cl, handle, record, style)


def _devices(cl: Any) -> list[tuple[DeviceRecord, Any]]:
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # PLATFORM_NOT_FOUND_KHR is how a loader says that there is none
        return []
    found: list[tuple[DeviceRecord, Any]] = []
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
                found.append((describe(cl, device, f"{short}:{index}", number), device))
    return found


def _choose(records: Sequence[DeviceRecord], selector: str | None) -> Choice:
    source = "argument"
    if selector is None:
        source = next(
            (name for name in (DEVICE_VARIABLE, PYOPENCL_VARIABLE) if os.environ.get(name)), "default"
        )
        selector = os.environ.get(source) if source != "default" else None
    if not records:
        asked = f" for {_told(selector, source)}" if selector else ""
        text = f"there is no OpenCL device{asked} ({looked_for()}): {how_to_get_a_device()}"
        raise DeviceError("DEVICE_NOT_FOUND", text)
    if selector is None:
        return Choice(min(records, key=_preference), None, source)
    matching = _matching(records, selector, source)
    if not matching:
        there_are = ", ".join(record.selector for record in records)
        told = _told(selector, source)
        raise DeviceError("DEVICE_NOT_FOUND", f"{told} names no OpenCL device; there are: {there_are}")
    return Choice(min(matching, key=_preference), selector, source)


def _matching(records: Sequence[DeviceRecord], selector: str, source: str) -> list[DeviceRecord]:
    text = selector.strip().lower()
    if text in ("cpu", "gpu"):
        return [record for record in records if record.kind == text]
    # PYOPENCL_CTX may name several devices, separated by commas; one is all we take.
    platform, colon, index = text.partition(",")[0].partition(":")
    if not platform or (colon and not index) or ":" in index:
        told = _told(selector, source)
        raise UsageError("DEVICE_SELECTOR", f"{told} is not cpu, gpu or PLATFORM:INDEX (see msb devices)")
    on_platform = [record for record in records if _is_on(record, platform)]
    if not colon:
        return on_platform[:1]
    if index.isdecimal():
        return on_platform[int(index) : int(index) + 1]
    return [record for record in on_platform if index in record.name.lower()][:1]


def _is_on(record: DeviceRecord, platform: str) -> bool:
    if platform.isdecimal():
        return record.platform_index == int(platform)
    return platform == short_name(record.platform) or platform in record.platform.lower()


def _preference(record: DeviceRecord) -> tuple[bool, bool]:
    return record.kind != "cpu", short_name(record.platform) != "pocl"


def _told(selector: str | None, source: str) -> str:
    name = "device" if source == "argument" else source
    return f"{name} '{shorten(selector or '', 60)}'"

"""Which way a mesh is audited: by NumPy, or by OpenCL kernels if it is large. The one place that decides."""

from __future__ import annotations

import os
import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.errors import DeviceError, UsageError
from msb.topology.analysis import Analysis
from msb.topology.findings import Findings, find_by_numpy

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.cl import Device

FEWEST_FACES = 1 << 16
"""From here on opening a device costs less than it saves. Smaller meshes never wait for a compiler."""


def find(points: NDArray[Any], faces: NDArray[Any]) -> tuple[Findings, Analysis]:
    """Return what the audit of arrays that `mesh_arrays` has checked finds, and their analysis.

    The results are the same either way, to the last bit. Where there is no device that can do it, or it
    fails, NumPy does the work and `computed_by` says why.
    """
    analysis = Analysis(points, faces)
    note = ""
    if len(faces) >= FEWEST_FACES and faces.dtype == np.int32:
        from msb.topology.kernel import find_by_kernels

        try:
            with _the_device as device:
                return find_by_kernels(points, faces, device), analysis
        except (DeviceError, UsageError) as error:
            note = f" ({error.message})"
    findings = find_by_numpy(analysis)
    return replace(findings, computed_by=findings.computed_by + note), analysis


class _SharedDevice:
    """A CPU device, opened when it is first needed and kept; one audit at a time uses it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._device: Device | None = None
        self._process: int | None = None

    def __enter__(self) -> Device:
        if self._process not in (None, os.getpid()):
            raise DeviceError("DEVICE_CLOSED", "the device belongs to the process this one was forked from")
        self._process = os.getpid()
        self._lock.acquire()
        try:
            if self._device is None:
                self._device = _open_cpu()
        except BaseException:
            self._lock.release()
            raise
        return self._device

    def __exit__(self, *_: object) -> None:
        self._lock.release()


def _open_cpu() -> Device:
    """Return the default device, or if that is no CPU the first that is: the kernels are made for one."""
    from msb.cl import open_device
    from msb.cl.devices import choose_device

    chosen = choose_device()
    device = open_device(chosen.selector if chosen.record.kind == "cpu" else "cpu")
    if not device.record.fp64:
        raise DeviceError("DEVICE_COMMAND", f"{device.record} has no double precision")
    return device


_the_device = _SharedDevice()

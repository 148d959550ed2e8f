"""Decide how a mesh is audited: by NumPy, or by OpenCL kernels if it is large."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import DeviceError, UsageError
from msb.topology.analysis import Analysis
from msb.topology.findings import Findings, find_by_numpy

if TYPE_CHECKING:
    from msb.cl import Device

# The number of faces from which opening a device costs less than it saves. Smaller meshes never wait for a
# compiler.
FEWEST_FACES = 1 << 16


def find(points: NDArray[Any], faces: NDArray[Any]) -> tuple[Findings, Analysis]:
    """Return what the audit of arrays that `mesh_arrays` has checked finds, and their analysis.

    Both ways give the same results to the last bit. If no device can run the kernels, or the device fails,
    NumPy does the work and `computed_by` says why.
    """
    analysis = Analysis(points, faces)
    note = ""
    if len(faces) >= FEWEST_FACES and faces.dtype == np.int32:
        from msb.topology.kernel import find_by_kernels

        try:
            device = _shared_cpu()
            with device.using():  # one audit at a time
                return find_by_kernels(points, faces, device), analysis
        except (DeviceError, UsageError) as error:
            note = f" ({error.message})"
    findings = find_by_numpy(analysis)
    return replace(findings, computed_by=findings.computed_by + note), analysis


def _shared_cpu() -> Device:
    """Return the default device, or if its style is not CPU, which the kernels are of, the first CPU."""
    from msb.cl import shared_device
    from msb.cl.devices import choose_device

    chosen = choose_device()
    device = shared_device(chosen.selector if chosen.record.style == "cpu" else "cpu")
    if device.record.style != "cpu" or not device.record.fp64:
        lacks = "double precision" if device.record.style == "cpu" else "a compiler known to take the kernels"
        raise DeviceError("DEVICE_COMMAND", f"{device.record} lacks {lacks}")
    return device

"""Run an audit with NumPy for small meshes, and with OpenCL kernels for large meshes."""

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

# Minimum number of faces for using the kernels. For smaller meshes, opening a device and compiling the
# kernels takes longer than the audit with NumPy.
FEWEST_FACES = 1 << 16


def find_findings(points: NDArray[Any], faces: NDArray[Any]) -> tuple[Findings, Analysis]:
    """Return the findings and the analysis of a mesh. The arrays must come from `mesh_arrays`.

    The NumPy code and the kernels give bit-identical results. If no device can run the kernels, or the
    device fails, NumPy is used and `computed_by` gives the reason.
    """
    analysis = Analysis(points, faces)
    note = ""
    if len(faces) >= FEWEST_FACES and faces.dtype == np.int32:
        from msb.topology.kernel import find_by_kernels

        try:
            device = _shared_cpu()
            with device.using():  # only one audit at a time uses the device
                return find_by_kernels(points, faces, device), analysis
        except (DeviceError, UsageError) as error:
            note = f" ({error.message})"
    findings = find_by_numpy(analysis)
    return replace(findings, computed_by=findings.computed_by + note), analysis


def _shared_cpu() -> Device:
    """Return the default device if it has kernels of style "cpu". Otherwise return the first CPU device."""
    from msb.cl import shared_device
    from msb.cl.devices import choose_device

    chosen = choose_device()
    device = shared_device(chosen.selector if chosen.record.style == "cpu" else "cpu")
    if device.record.style != "cpu" or not device.record.fp64:
        missing = (
            "double precision" if device.record.style == "cpu" else "compiler that takes the CPU kernels"
        )
        raise DeviceError("DEVICE_COMMAND", f"{device.record} has no {missing}")
    return device

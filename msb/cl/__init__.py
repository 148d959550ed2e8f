"""OpenCL devices, programs, buffers, timing, scan and sort. This package does not depend on `.triasset`
files.

Importing this package loads neither pyopencl nor a platform. The first opened device loads pyopencl and its
platform.
"""

from msb.cl.buffers import Buffer
from msb.cl.device import Device
from msb.cl.devices import list_devices, open_device, shared_device
from msb.cl.programs import Kernel, LocalMemory, Program
from msb.cl.records import DeviceRecord
from msb.cl.scan import exclusive_scan
from msb.cl.sort import sort_pairs
from msb.cl.timing import Timing

__all__ = [
    "Buffer",
    "Device",
    "DeviceRecord",
    "Kernel",
    "LocalMemory",
    "Program",
    "Timing",
    "exclusive_scan",
    "list_devices",
    "open_device",
    "shared_device",
    "sort_pairs",
]

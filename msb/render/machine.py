"""A record of the machine and the software versions, stored with measured results."""

import os
import platform
from collections.abc import Mapping
from typing import Any

from msb.base.version import __version__
from msb.registry import METHODS, package_of

# Keys of a device record that may change between processes, and so cannot identify the device. PoCL queries
# the available memory of a CPU when it starts, and a virtual machine may change its memory.
OF_THE_MOMENT = frozenset({"global_memory", "max_allocation"})


def machine(
    device: str | None = None, *, opencl: bool = True, engine: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return a record of the system, the versions and the device.

    Parameters
    ----------
    device : str, optional
        Selector of the OpenCL device. The device record includes the build options of programs, and the
        SHA-256 of the kernel sources.
    opencl : bool
        False if the work used only the host processor; the record then has no device.
    engine : mapping, optional
        `Renderer.device_info` of another engine, recorded in place of an OpenCL device.
    """
    from importlib.metadata import version

    record: dict[str, Any] = {
        "system": platform.platform(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "meshsplatbench": __version__,
    }
    if engine is not None:
        record["device"] = dict(engine)
    elif opencl:
        from msb.cl.devices import choose_device
        from msb.cl.kernel_text import kernels_hash
        from msb.cl.programs import build_options

        chosen = choose_device(device).record
        record["pyopencl"] = version("pyopencl")
        record["device"] = chosen.to_dict()
        record["build_options"] = list(build_options(chosen))
        record["kernels_sha256"] = kernels_hash(tuple(map(package_of, METHODS)))
    return record

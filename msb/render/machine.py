"""The machine and the versions with which figures were measured."""

import os
import platform
from collections.abc import Mapping
from typing import Any

from msb.base.version import __version__
from msb.registry import METHODS, package_of

# Keys of an OpenCL device's record that do not tell which device it is. PoCL looks up in every process how
# much memory a CPU has; where that varies, as in some virtual machines, two processes get two figures.
OF_THE_MOMENT = frozenset({"global_memory", "max_allocation"})


def machine(
    device: str | None = None, *, opencl: bool = True, engine: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return system, versions, and the OpenCL device that `device` selects, or what an engine draws with.

    With an OpenCL device come the options its programs are built with and a SHA-256 of our kernels' text.
    Without `opencl`, for work of the host alone, there is no device. `engine` is `Renderer.device_info`.
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

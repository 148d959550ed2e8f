"""A processor that the PoCL wheel does not know, for every Python process with this folder in PYTHONPATH.

On such a machine LLVM calls the processor "generic", and the wheel hands that to a compiler that refuses it.
Here the name is overwritten where the wheel keeps it, as soon as somebody asks for its devices. Kernels built
before are found in PoCL's cache all the same, so it has to be an empty one.
"""

import ctypes
import importlib.util
import sys
from importlib.abc import MetaPathFinder

_POINTER = 640
"""Byte of the device's structure at which the wheel's version 3.0-rc2 has the pointer to the name."""


def _forget(get_devices):
    done = set()

    def devices(platform, *args, **kwargs):
        found = get_devices(platform, *args, **kwargs)
        for device in found:
            if device.driver_version == "3.0-rc2" and device.int_ptr not in done:
                done.add(device.int_ptr)
                name = ctypes.c_void_p.from_address(device.int_ptr + _POINTER)
                ctypes.memmove(name.value, b"generic\0", 8)
        return found

    return devices


class _Watch(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name != "pyopencl":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        run = spec.loader.exec_module

        def run_and_forget(module):
            run(module)
            module.Platform.get_devices = _forget(module.Platform.get_devices)

        spec.loader.exec_module = run_and_forget
        return spec


sys.meta_path.insert(0, _Watch())

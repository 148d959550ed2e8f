"""Simulate a processor that the PoCL wheel does not know, in every Python process with this folder in
PYTHONPATH.

On such a machine LLVM calls the processor "generic". The wheel passes this name to its compiler, and the
compiler rejects it. Here the name is overwritten in the memory of the wheel as soon as its devices are
listed. The cache must be empty, because PoCL would otherwise find kernels in it.
"""

import ctypes
import importlib.util
import sys
from importlib.abc import MetaPathFinder

# Byte offset of the pointer to the name in the device structure of version 3.0-rc2.
_POINTER = 640


def _rename(get_devices):
    done = set()

    def devices(platform, *args, **kwargs):
        listed = get_devices(platform, *args, **kwargs)
        for device in listed:
            if device.driver_version == "3.0-rc2" and device.int_ptr not in done:
                done.add(device.int_ptr)
                name = ctypes.c_void_p.from_address(device.int_ptr + _POINTER)
                ctypes.memmove(name.value, b"generic\0", 8)
        return listed

    return devices


class _Watch(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name != "pyopencl":
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        run = spec.loader.exec_module

        def run_and_patch(module):
            run(module)
            module.Platform.get_devices = _rename(module.Platform.get_devices)

        spec.loader.exec_module = run_and_patch
        return spec


sys.meta_path.insert(0, _Watch())

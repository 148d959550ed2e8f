"""Which of the adapters that wgpu finds draws, how its clock ticks, and what its things hold."""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import DeviceError, shorten

INSTALL = (
    "apt-get install mesa-vulkan-drivers brings Vulkan in software"
    if sys.platform == "linux"
    else "it needs a driver for Vulkan, Metal or Direct3D 12"
)
"""Advice if there is nothing to draw with."""
_KINDS = ("DiscreteGPU", "IntegratedGPU", "Unknown", "CPU")
_BACKENDS = ("Vulkan", "Metal", "D3D12")
"""Backends of wgpu that are used. On OpenGL, which may be all there is, it makes no 32-bit targets."""
_TEXEL_BYTES = {"rgba32float": 16, "rgba16float": 8, "r32uint": 4, "depth32float": 4, "r32float": 4}


@cache
def all_adapters() -> list[Any]:
    """Return every adapter that can draw into the targets we need."""
    import wgpu

    with _runtime_folder():
        found = wgpu.gpu.enumerate_adapters_sync()
    return [adapter for adapter in found if adapter.info["backend_type"] in _BACKENDS]


def choose_adapter(kind: str | None) -> Any:
    """Return the adapter to draw with: a GPU where there is one."""
    adapters = all_adapters()
    usable = [
        adapter
        for adapter in adapters
        if kind is None or (adapter.info["adapter_type"] == "CPU") is (kind == "cpu")
    ]
    if usable:
        return min(usable, key=lambda adapter: _rank(adapter.info))
    if kind == "gpu":
        there = ", ".join(sorted({adapter.info["device"] for adapter in adapters})) or "nothing"
        text = f"wgpu finds no GPU, only {there}; --device cpu draws in software"
    else:
        text = f"wgpu finds no {'software ' if kind else ''}adapter; {INSTALL}"
    raise DeviceError("DEVICE_NOT_FOUND", text)


def _rank(info: Mapping[str, Any]) -> tuple[int, int]:
    kinds = (*_KINDS, info["adapter_type"])
    return kinds.index(info["adapter_type"]), _BACKENDS.index(info["backend_type"])


@contextlib.contextmanager
def _runtime_folder() -> Iterator[None]:
    """Without XDG_RUNTIME_DIR (a container, a job on a cluster) Mesa complains on standard error."""
    if sys.platform != "linux" or os.environ.get("XDG_RUNTIME_DIR"):
        yield
        return
    os.environ["XDG_RUNTIME_DIR"] = tempfile.gettempdir()
    try:
        yield
    finally:
        del os.environ["XDG_RUNTIME_DIR"]


@contextlib.contextmanager
def errors_of(device: str, doing: str) -> Iterator[None]:
    """Turn what wgpu raises in a block into an error of ours, which names the device and says what it did."""
    import wgpu

    try:
        yield
    except wgpu.GPUOutOfMemoryError as error:
        raise DeviceError("DEVICE_MEMORY", f"{device}: out of memory, {doing}") from error
    except (wgpu.GPUError, RuntimeError) as error:
        lines = [line.strip() for line in str(error).splitlines() if line.strip()]
        text = shorten(lines[-1] if lines else type(error).__name__, 200)
        raise DeviceError("ENGINE_FAILED", f"{device}: {doing}: {text}") from error


def release(device: Any) -> None:
    """Destroy a device that nothing of ours refers to but the caller, and give back what it holds.

    In wgpu-py a device refers to itself, so shaders and the driver's threads would stay until Python happens
    to collect garbage: 10 to 30 MB for each device on lavapipe.
    """
    device.destroy()
    del device
    gc.collect()


def held_bytes(thing: Any) -> int:
    """Return the bytes of a buffer or a texture."""
    if hasattr(thing, "map_sync"):
        return int(thing.size)
    width, height, _ = thing.size
    return int(width * height * _TEXEL_BYTES[thing.format])


def read_mapped(buffer: Any) -> NDArray[np.uint8]:
    """Wait until a buffer can be mapped, and return a copy of its bytes."""
    import wgpu

    buffer.map_sync(wgpu.MapMode.READ)
    try:
        return np.frombuffer(buffer.read_mapped(), np.uint8).copy()
    finally:
        buffer.unmap()


def nanoseconds_a_tick(device: Any) -> float | None:
    """Return the nanoseconds in a step of the device's timestamps, None if this wgpu-py does not say.

    wgpu-py hands timestamps over as they are and has no function for their unit, so the library under it is
    asked.
    """
    from wgpu.backends.wgpu_native import lib

    try:
        return float(lib.wgpuQueueGetTimestampPeriod(device.queue._internal))
    except AttributeError:
        return None

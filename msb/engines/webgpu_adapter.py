"""The graphics adapter and device of wgpu-py, with buffers, textures, timestamps and error messages."""

import contextlib
import gc
import os
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import DeviceError, shorten

# Advice on machines without a graphics adapter.
INSTALL = (
    "apt-get install mesa-vulkan-drivers installs a software driver"
    if sys.platform == "linux"
    else "install a driver for Vulkan, Metal or Direct3D 12"
)
# Adapter types in the order of preference.
_KINDS = ("DiscreteGPU", "IntegratedGPU", "Unknown", "CPU")
# The backends of wgpu that can be used. The OpenGL backend is excluded, because it has no 32-bit float
# targets.
_BACKENDS = ("Vulkan", "Metal", "D3D12")
_TEXEL_BYTES = {
    "rgba32float": 16,
    "rgba16float": 8,
    "r32uint": 4,
    "depth32float": 4,
    "r32float": 4,
    "rgba8unorm-srgb": 4,
}


@cache
def list_adapters() -> list[Any]:
    """Return all graphics adapters of the usable backends."""
    import wgpu

    with _runtime_folder():
        adapters = wgpu.gpu.enumerate_adapters_sync()
    return [adapter for adapter in adapters if adapter.info["backend_type"] in _BACKENDS]


def choose_adapter(kind: str | None) -> Any:
    """Return the best adapter of `kind`: "cpu" (software), "gpu", or None (a GPU if possible)."""
    adapters = list_adapters()
    usable = [
        adapter
        for adapter in adapters
        if kind is None or (adapter.info["adapter_type"] == "CPU") is (kind == "cpu")
    ]
    if usable:
        return min(usable, key=lambda adapter: _rank(adapter.info))
    if kind == "gpu":
        names = ", ".join(sorted({adapter.info["device"] for adapter in adapters})) or "nothing"
        text = f"wgpu found no GPU, only {names}; use --device cpu to draw in software"
    else:
        text = f"wgpu found no {'software ' if kind else ''}adapter; {INSTALL}"
    raise DeviceError("DEVICE_NOT_FOUND", text)


def _rank(info: Mapping[str, Any]) -> tuple[int, int]:
    kinds = (*_KINDS, info["adapter_type"])
    return kinds.index(info["adapter_type"]), _BACKENDS.index(info["backend_type"])


@contextlib.contextmanager
def _runtime_folder() -> Iterator[None]:
    """Set the variable XDG_RUNTIME_DIR in a `with` block if it is missing.

    Without the variable XDG_RUNTIME_DIR, Mesa prints a warning in containers and on clusters.
    """
    if sys.platform != "linux" or os.environ.get("XDG_RUNTIME_DIR"):
        yield
        return
    os.environ["XDG_RUNTIME_DIR"] = tempfile.gettempdir()
    try:
        yield
    finally:
        del os.environ["XDG_RUNTIME_DIR"]


def _nanoseconds_per_tick(device: Any) -> float | None:
    """Return the unit of the device's timestamps in nanoseconds, or None if it is unknown.

    wgpu-py has no function for the unit of timestamps, so a function of the underlying library is called.
    """
    from wgpu.backends.wgpu_native import lib

    try:
        return float(lib.wgpuQueueGetTimestampPeriod(device.queue._internal))
    except AttributeError:
        return None


class Gpu:
    """A device of wgpu-py with its buffers and textures.

    Attributes
    ----------
    resources : dict
        Maps each use to its buffer or texture.
    nanoseconds_per_tick : float or None
        The unit of timestamps; None if the device has no timestamps.
    """

    def __init__(self, kind: str | None, features: Iterable[str]) -> None:
        import wgpu

        self._wgpu = wgpu
        self.adapter = choose_adapter(kind)
        self.features = [name for name in features if name in self.adapter.features]
        self.name: str = self.adapter.info["device"]
        self.kind = "cpu" if self.adapter.info["adapter_type"] == "CPU" else "gpu"
        self.resources: dict[str, Any] = {}
        self.device: Any = None
        self.queries: Any = None
        self.nanoseconds_per_tick: float | None = None

    def describe(self) -> dict[str, str]:
        """Return `platform`, `name` and `kind` of the adapter, for reports."""
        info = self.adapter.info
        platform = ", ".join(filter(None, (info["backend_type"], info["description"])))
        return {"platform": platform, "name": self.name, "kind": self.kind}

    def open(self, limits: Iterable[str], *, timed: bool) -> None:
        """Open the device with the adapter's maximum of all `limits`. With `timed`, enable timestamps."""
        self.device = self.adapter.request_device_sync(
            required_features=self.features,
            required_limits={name: self.adapter.limits[name] for name in limits},
        )
        if timed and "timestamp-query" in self.features:
            self.nanoseconds_per_tick = _nanoseconds_per_tick(self.device)

    @contextlib.contextmanager
    def reporting(self, doing: str) -> Iterator[None]:
        """Convert wgpu errors in a `with` block to a DeviceError.

        The error names the device and the failed step (`doing`).
        """
        wgpu = self._wgpu
        try:
            yield
        except wgpu.GPUOutOfMemoryError as error:
            raise DeviceError("DEVICE_MEMORY", f"{self.name}: out of memory while {doing}") from error
        except (wgpu.GPUError, RuntimeError) as error:
            lines = [line.strip() for line in str(error).splitlines() if line.strip()]
            text = shorten(lines[-1] if lines else type(error).__name__, 200)
            raise DeviceError("ENGINE_FAILED", f"{self.name}: error while {doing}: {text}") from error

    @contextlib.contextmanager
    def setting_up(self) -> Iterator[None]:
        """Close the device if an error occurs in the block that opens it and creates resources."""
        try:
            with self.reporting("opening the device"):
                yield
        except BaseException:
            self.close()
            raise

    def buffer(self, use: str, size: int, *usages: str, data: NDArray[Any] | None = None) -> None:
        """Create a buffer for a use, with the content `data` if given. An earlier buffer for this use is
        replaced."""
        usage = 0
        for word in usages:
            usage |= getattr(self._wgpu.BufferUsage, word.upper())
        self._drop(use)
        if data is None:
            self.resources[use] = self.device.create_buffer(size=size, usage=usage)
        else:
            array = np.ascontiguousarray(data)
            self.resources[use] = self.device.create_buffer_with_data(data=array, usage=usage)

    def texture(self, use: str, width: int, height: int, form: str, *usages: str, levels: int = 1) -> None:
        """Create a texture with `levels` mip levels for a use. An earlier texture for this use is
        replaced."""
        usage = 0
        for word in usages:
            usage |= getattr(self._wgpu.TextureUsage, word.upper())
        self._drop(use)
        self.resources[use] = self.device.create_texture(
            size=(width, height, 1), format=form, usage=usage, mip_level_count=levels
        )

    def _drop(self, use: str) -> None:
        if use in self.resources:
            self.resources.pop(use).destroy()

    def make_clock(self, count: int) -> None:
        """Create the query set and the buffers for `count` timestamps per frame."""
        if self.nanoseconds_per_tick is not None:
            if self.queries is not None:
                self.queries.destroy()
            self.queries = self.device.create_query_set(type="timestamp", count=count)
        self.buffer("times", 8 * count, "query_resolve", "copy_src", "copy_dst")
        self.buffer("times, read back", 8 * count, "copy_dst", "map_read")

    def run(self, encoder: Any) -> NDArray[np.uint64]:
        """Submit commands, wait for them, and return the timestamps in ticks (all 0 without timestamps)."""
        times = self.resources["times"]
        if self.queries is not None:
            encoder.resolve_query_set(self.queries, 0, times.size // 8, times, 0)
        encoder.copy_buffer_to_buffer(times, 0, self.resources["times, read back"], 0, times.size)
        self.device.queue.submit([encoder.finish()])
        return self.read_back("times").view(np.uint64)

    def read_back(self, use: str) -> NDArray[np.uint8]:
        """Wait for the readable copy of a buffer or texture, and return its bytes."""
        buffer = self.resources[f"{use}, read back"]
        buffer.map_sync(self._wgpu.MapMode.READ)
        try:
            return np.frombuffer(buffer.read_mapped(), np.uint8).copy()
        finally:
            buffer.unmap()

    def memory(self) -> Mapping[str, int]:
        """Return the bytes of every buffer and texture, by use."""
        return {use: _count_bytes(resource) for use, resource in self.resources.items()}

    def close(self) -> None:
        """Destroy the device and its resources; a second call does nothing.

        A device object of wgpu-py refers to itself, so only a garbage collection frees it. A freed device
        releases its shaders and driver threads, which take 10 to 30 MB on lavapipe.
        """
        for resource in self.resources.values():
            resource.destroy()
        self.resources.clear()
        self.queries = None
        if self.device is not None:
            self.device.destroy()
            self.device = None
            gc.collect()


def _count_bytes(resource: Any) -> int:
    """Return the bytes of a buffer or of a texture with its mip levels."""
    if hasattr(resource, "map_sync"):  # a buffer
        return int(resource.size)
    width, height, _ = resource.size
    levels = ((width >> level, height >> level) for level in range(resource.mip_level_count))
    return int(sum(max(1, w) * max(1, h) for w, h in levels) * _TEXEL_BYTES[resource.format])

"""The adapter and the device of wgpu-py that draw: what is held there, the clock, and what goes wrong."""

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

# Advice if there is nothing to draw with.
INSTALL = (
    "apt-get install mesa-vulkan-drivers brings Vulkan in software"
    if sys.platform == "linux"
    else "it needs a driver for Vulkan, Metal or Direct3D 12"
)
_KINDS = ("DiscreteGPU", "IntegratedGPU", "Unknown", "CPU")
# Backends of wgpu that are used. On OpenGL, which may be all there is, it makes no 32-bit targets.
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
def all_adapters() -> list[Any]:
    """Return every adapter that can draw into the targets we need."""
    import wgpu

    with _runtime_folder():
        adapters = wgpu.gpu.enumerate_adapters_sync()
    return [adapter for adapter in adapters if adapter.info["backend_type"] in _BACKENDS]


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


def _nanoseconds_a_tick(device: Any) -> float | None:
    """Return the nanoseconds in a step of the device's timestamps, None if this wgpu-py does not say.

    wgpu-py hands timestamps over as they are and has no function for their unit, so the library under it is
    asked.
    """
    from wgpu.backends.wgpu_native import lib

    try:
        return float(lib.wgpuQueueGetTimestampPeriod(device.queue._internal))
    except AttributeError:
        return None


class Gpu:
    """A device of wgpu-py, the buffers and textures it holds by their use, and the clock of its frames."""

    def __init__(self, kind: str | None, features: Iterable[str]) -> None:
        import wgpu

        self._wgpu = wgpu
        self.adapter = choose_adapter(kind)
        self.features = [name for name in features if name in self.adapter.features]
        self.name: str = self.adapter.info["device"]
        self.kind = "cpu" if self.adapter.info["adapter_type"] == "CPU" else "gpu"
        self.held: dict[str, Any] = {}
        self.device: Any = None
        self.queries: Any = None
        self.tick: float | None = None

    def about(self) -> dict[str, str]:
        """Return what draws, for reports."""
        info = self.adapter.info
        platform = ", ".join(filter(None, (info["backend_type"], info["description"])))
        return {"platform": platform, "name": self.name, "kind": self.kind}

    def open(self, limits: Iterable[str], *, timed: bool) -> None:
        """Open the device, with as much of `limits` as the adapter has, and a clock if `timed`."""
        self.device = self.adapter.request_device_sync(
            required_features=self.features,
            required_limits={name: self.adapter.limits[name] for name in limits},
        )
        if timed and "timestamp-query" in self.features:
            self.tick = _nanoseconds_a_tick(self.device)

    @contextlib.contextmanager
    def reporting(self, doing: str) -> Iterator[None]:
        """Turn what wgpu raises in a block into an error of ours, which names the device and `doing`."""
        wgpu = self._wgpu
        try:
            yield
        except wgpu.GPUOutOfMemoryError as error:
            raise DeviceError("DEVICE_MEMORY", f"{self.name}: out of memory, {doing}") from error
        except (wgpu.GPUError, RuntimeError) as error:
            lines = [line.strip() for line in str(error).splitlines() if line.strip()]
            text = shorten(lines[-1] if lines else type(error).__name__, 200)
            raise DeviceError("ENGINE_FAILED", f"{self.name}: {doing}: {text}") from error

    @contextlib.contextmanager
    def setting_up(self) -> Iterator[None]:
        """Open the device and fill it in a block; if the block fails, nothing of it stays there."""
        try:
            with self.reporting("opening the device"):
                yield
        except BaseException:
            self.close()
            raise

    def buffer(self, use: str, size: int, *usages: str, data: NDArray[Any] | None = None) -> None:
        """Make a buffer in place of the one of that use, and fill it if `data` is given."""
        usage = 0
        for word in usages:
            usage |= getattr(self._wgpu.BufferUsage, word.upper())
        self._drop(use)
        if data is None:
            self.held[use] = self.device.create_buffer(size=size, usage=usage)
        else:
            array = np.ascontiguousarray(data)
            self.held[use] = self.device.create_buffer_with_data(data=array, usage=usage)

    def texture(self, use: str, width: int, height: int, form: str, *usages: str, levels: int = 1) -> None:
        """Make a texture, with so many levels of mip maps, in place of the one of that use."""
        usage = 0
        for word in usages:
            usage |= getattr(self._wgpu.TextureUsage, word.upper())
        self._drop(use)
        self.held[use] = self.device.create_texture(
            size=(width, height, 1), format=form, usage=usage, mip_level_count=levels
        )

    def _drop(self, use: str) -> None:
        if use in self.held:
            self.held.pop(use).destroy()

    def make_clock(self, count: int) -> None:
        """Make room for the timestamps of a frame."""
        if self.tick is not None:
            if self.queries is not None:
                self.queries.destroy()
            self.queries = self.device.create_query_set(type="timestamp", count=count)
        self.buffer("times", 8 * count, "query_resolve", "copy_src", "copy_dst")
        self.buffer("times, read back", 8 * count, "copy_dst", "map_read")

    def run(self, encoder: Any) -> NDArray[np.uint64]:
        """Submit commands and return the timestamps; that they can be read says that all is done."""
        times = self.held["times"]
        if self.queries is not None:
            encoder.resolve_query_set(self.queries, 0, times.size // 8, times, 0)
        encoder.copy_buffer_to_buffer(times, 0, self.held["times, read back"], 0, times.size)
        self.device.queue.submit([encoder.finish()])
        return self.read_back("times").view(np.uint64)

    def read_back(self, use: str) -> NDArray[np.uint8]:
        """Wait until the host's copy of a buffer or texture can be mapped, and return its bytes."""
        buffer = self.held[f"{use}, read back"]
        buffer.map_sync(self._wgpu.MapMode.READ)
        try:
            return np.frombuffer(buffer.read_mapped(), np.uint8).copy()
        finally:
            buffer.unmap()

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes of every buffer and texture."""
        return {use: _held_bytes(thing) for use, thing in self.held.items()}

    def close(self) -> None:
        """Destroy the device and what it holds; a second call does nothing.

        In wgpu-py a device refers to itself, so shaders and the driver's threads would stay until Python
        happens to collect garbage: 10 to 30 MB for each device on lavapipe.
        """
        for thing in self.held.values():
            thing.destroy()
        self.held.clear()
        self.queries = None
        if self.device is not None:
            self.device.destroy()
            self.device = None
            gc.collect()


def _held_bytes(thing: Any) -> int:
    """Return the bytes of a buffer or a texture."""
    if hasattr(thing, "map_sync"):
        return int(thing.size)
    width, height, _ = thing.size
    levels = ((width >> level, height >> level) for level in range(thing.mip_level_count))
    return int(sum(max(1, w) * max(1, h) for w, h in levels) * _TEXEL_BYTES[thing.format])

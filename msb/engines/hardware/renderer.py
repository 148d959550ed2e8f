"""Renderer `wgpu` on the dedicated tier: native rendering with an ordinary graphics pipeline."""

import time
from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.settings import check_modes
from msb.engines.engine import WALL_CLOCK, device_kind
from msb.engines.hardware.device import PIXEL_BYTES, DevicePlan, count_pixel_bytes, split_into_bands
from msb.engines.hardware.packing import pack
from msb.engines.hardware.plan import Limits
from msb.engines.hardware.program import STOPS, make_plan
from msb.engines.webgpu import WgpuRenderer
from msb.engines.webgpu_adapter import Gpu
from msb.errors import DeviceError, UsageError
from msb.registry import Order, Sampling
from msb.render.backend import DrawTime
from msb.render.frame import Frame
from msb.scenes import Camera
from msb.scenes.colors import Color

# Texture formats of the render targets: float32 or half floats for blending, or face numbers for a z-buffer.
FLOAT, HALF, NUMBERS = "rgba32float", "rgba16float", "r32uint"
_BLENDS = {FLOAT: "float32", HALF: "half floats"}
# Maximum number of samples of a band, by format. The limit bounds the memory of the render targets: 256 MiB
# for colour and depth, or 128 MiB for face numbers and their depths.
_ROOM = {FLOAT: 1 << 23, HALF: 1 << 24, NUMBERS: 1 << 24}


# Maps the first word of each memory use to a group in memory reports.
_GROUPS = {
    **dict.fromkeys(("positions", "indices"), "geometry"),
    **dict.fromkeys(("coverage", "f_dc", "f_rest", "opacity", "features", "decoder"), "appearance"),
    **dict.fromkeys(("image", "depth", "covered", "nearest", "z-buffer", "pixels,", "pixels"), "targets"),
}
# The device is opened with the adapter's maximum of these limits. The first three limits are the members of
# `Limits`.
_LIMITS = (
    "max-storage-buffer-binding-size",
    "max-buffer-size",
    "max-texture-dimension-2d",
    "max-storage-buffers-per-shader-stage",
    "max-vertex-attributes",
    "max-color-attachment-bytes-per-sample",
)
# Minimum device limits for the passes. WebGPU guarantees the limits of the passes, but adapters in
# compatibility mode may have lower limits.
_NEEDED = {
    "max-storage-buffers-per-shader-stage": 8,
    "max-vertex-attributes": 9,
    "max-compute-workgroup-storage-size": 9216,
    "max-compute-invocations-per-workgroup": 256,
}


class HardwareRenderer:
    """Draws the native rendering with wgpu-py: blends faces in depth order, or uses a z-buffer.

    Parameters
    ----------
    device : {"cpu", "gpu"}, optional
        "cpu" is a software adapter, "gpu" any other adapter. Default: a GPU if possible.
    order, sampling : str
        The same options as in the OpenCL renderer.
    half : bool
        Blend in half floats even if the adapter can blend float32.
    stops : int
        Number of chunks of faces for methods that stop samples (see `program.STOPS`); with 1 chunk no sample
        stops.
    debug : bool
        Keep the data that the method `decisions` returns.
    """

    name = "wgpu"
    tiers: ClassVar[tuple[str, ...]] = ("dedicated",)

    def __init__(
        self,
        asset: Asset,
        *,
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        order: Order = "tile",
        sampling: Sampling = "official",
        half: bool = False,
        stops: int = STOPS,
        debug: bool = False,
    ) -> None:
        kind = device_kind(device, self.name)
        check_modes(order, sampling)
        missing = WgpuRenderer.missing()
        if missing is not None:
            raise UsageError("ENGINE_MISSING", f"renderer {self.name}: {missing}")
        self._packed = pack(asset, settings)
        self.version = self.installed()
        self._gpu = gpu = Gpu(kind, ("timestamp-query", "float32-blendable"))
        self._format = FLOAT if "float32-blendable" in gpu.features and not half else HALF
        if self._packed.surface is not None:
            self._format = NUMBERS
        blends = _BLENDS.get(self._format)
        self.device_info = gpu.describe() | ({} if blends is None else {"blends": blends})
        self._limits = _limits_of(gpu.adapter)
        self._plan = make_plan(
            self._packed,
            self._limits,
            gpu.name,
            order=order,
            sampling=sampling,
            form=self._format,
            stops=stops,
            debug=debug,
        )
        with gpu.setting_up():
            gpu.open(_LIMITS, timed=gpu.kind == "gpu")
            self._device_plan = DevicePlan(gpu, self._plan)
        self._size: tuple[int, int] | None = None

    @classmethod
    def installed(cls) -> str:
        """Return the version of wgpu-py without opening a device."""
        return WgpuRenderer.installed()

    def render(self, camera: Camera, background: Color) -> Frame:
        """Draw the asset from `camera` over `background` (RGB, in the asset's colour space)."""
        self._check_open()
        with self._gpu.reporting("drawing"):
            timing = self._run(camera, background, read=True)
            pixels = self._gpu.read_back("pixels").view(np.float32)
            keys = self._device_plan.read("keys").view(np.uint32)[: self._packed.faces]
        # Assemble the frame (H, W, 5) of red, green, blue, alpha and depth from the pixels of the bands.
        planes = np.zeros((camera.height, camera.width, 5), np.float32)
        for band in self._device_plan.bands:
            first = band.offset // 4
            values = pixels[first : first + 5 * band.width * band.height]
            target = planes[band.y : band.y + band.height, band.x : band.x + band.width]
            target[:] = values.reshape(band.height, band.width, 5)
        return Frame(
            image=np.ascontiguousarray(planes[..., :3]),
            alpha=np.ascontiguousarray(planes[..., 3]),
            depth=np.ascontiguousarray(planes[..., 4]),
            visible=keys != np.uint32(0xFFFFFFFF),
            timings=timing.stages,
        )

    def draw(self, camera: Camera, background: Color) -> DrawTime:
        """Draw a frame and wait until it is complete, but read nothing back."""
        self._check_open()
        with self._gpu.reporting("drawing"):
            return self._run(camera, background, read=False)

    def _run(self, camera: Camera, background: Color, *, read: bool) -> DrawTime:
        self._make_targets(camera.width, camera.height)
        view = self._packed.view_bytes(camera, background)
        self._gpu.device.queue.write_buffer(self._gpu.resources["view"], 0, view)
        timing = self._run_by_stage() if self._gpu.kind == "cpu" else self._run_at_once()
        if read:
            encoder, pixels = self._gpu.device.create_command_encoder(), self._gpu.resources["pixels"]
            encoder.copy_buffer_to_buffer(pixels, 0, self._gpu.resources["pixels, read back"], 0, pixels.size)
            self._gpu.device.queue.submit([encoder.finish()])
        return timing

    def _run_by_stage(self) -> DrawTime:
        """Submit each stage separately and time it with the wall clock, for software adapters.

        Lavapipe writes the timestamps of a compute pass only at the next draw, so its timestamps are useless
        here. Waiting for each stage costs no extra time with a software adapter.
        """
        spent: dict[str, float] = {}
        begun = time.perf_counter()
        for stage, steps in self._device_plan.stages():
            start = time.perf_counter()
            encoder = self._gpu.device.create_command_encoder()
            self._device_plan.encode(encoder, steps)
            self._gpu.run(encoder)
            spent[stage] = spent.get(stage, 0.0) + 1000 * (time.perf_counter() - start)
        return DrawTime(spent, 1000 * (time.perf_counter() - begun))

    def _run_at_once(self) -> DrawTime:
        """Submit the whole frame at once; the device measures the stages if it has timestamps."""
        start = time.perf_counter()
        encoder = self._gpu.device.create_command_encoder()
        stages = self._device_plan.stages()
        for k, (_, steps) in enumerate(stages):
            timed = (self._gpu.queries, 2 * k, 2 * k + 1) if self._gpu.queries else None
            self._device_plan.encode(encoder, steps, timed)
        times = self._gpu.run(encoder).reshape(-1, 2).astype(np.float64)
        waited = 1000 * (time.perf_counter() - start)
        if self._gpu.nanoseconds_per_tick is None:
            return DrawTime({WALL_CLOCK: waited}, waited)
        # Start and end of each stage (S, 2), in milliseconds.
        times *= self._gpu.nanoseconds_per_tick / 1e6
        spent: dict[str, float] = {}
        for (stage, _), (began, ended) in zip(stages, times.tolist(), strict=True):
            spent[stage] = spent.get(stage, 0.0) + max(0.0, ended - began)
        return DrawTime(spent, max(0.0, float(times[-1, 1] - times[0, 0])))

    def _make_targets(self, width: int, height: int) -> None:
        if self._size == (width, height):
            return
        self._size = None
        device_plan, scale, limits = self._device_plan, self._plan.scale, self._limits
        room = min(_ROOM[self._format] // scale**2, limits.binding // PIXEL_BYTES)
        bands = split_into_bands(width, height, scale, limits.side, room)
        size = count_pixel_bytes(bands)
        if size > limits.buffer:
            text = f"{width} x {height} pixels need a buffer of {size:,} bytes; "
            text += f"{self.device_info['name']} allows {limits.buffer:,}"
            raise DeviceError("DEVICE_MEMORY", text)
        device_plan.set_bands(bands)
        self._gpu.make_clock(2 * len(device_plan.stages()))
        self._size = width, height

    def decisions(self) -> tuple[NDArray[np.uint32], NDArray[np.int32]]:
        """Return the depth keys (F,) and the tile rectangles (F, 4) of the last frame; requires `debug`.

        A key is the bit pattern of the float32 depth. The key 0xffffffff marks faces that the official
        culling removes, and 0xfffffffe marks other faces that are not drawn. The rectangle of a drawn face is
        x0, y0, x1, y1: the range of the official tiles that the face covers. x1 and y1 are exclusive.
        """
        count = self._packed.faces
        keys = self._device_plan.read("keys").view(np.uint32)[:count]
        return keys, self._device_plan.read("rectangles").view(np.int32).reshape(-1, 4)[:count]

    def memory(self) -> Mapping[str, int]:
        """Return the bytes of every buffer and texture, by use."""
        return self._gpu.memory()

    def memory_groups(self) -> Mapping[str, str]:
        """Return the report group of each memory use."""
        return {name: _GROUPS[word] for name in self._gpu.resources if (word := name.split()[0]) in _GROUPS}

    def close(self) -> None:
        """Release everything."""
        self._device_plan.close()
        self._gpu.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _check_open(self) -> None:
        if self._gpu.device is None:
            raise DeviceError("DEVICE_CLOSED", f"the renderer on {self.device_info['name']} is closed")


def _limits_of(adapter: Any) -> Limits:
    """Return the limits of the adapter; raise DEVICE_MEMORY if a limit is too low for the passes."""
    for name, needed in _NEEDED.items():
        if adapter.limits[name] < needed:
            text = (
                f"{adapter.info['device']}: the limit {name} is {adapter.limits[name]}, but {needed} is "
                "needed"
            )
            raise DeviceError("DEVICE_MEMORY", text)
    return Limits(*(adapter.limits[name] for name in _LIMITS[:3]))

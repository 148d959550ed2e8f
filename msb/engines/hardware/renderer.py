"""Renderer `wgpu` on the dedicated tier: the official look by an ordinary graphics pipeline."""

from __future__ import annotations

import contextlib
import time
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from msb.asset.settings import check_modes
from msb.engines.engine import WALL_CLOCK, device_kind
from msb.engines.hardware.device import DevicePlan, bands_of
from msb.engines.hardware.packing import pack
from msb.engines.hardware.program import Limits, make_plan
from msb.engines.webgpu import WgpuRenderer
from msb.engines.webgpu_adapter import choose_adapter, nanoseconds_a_tick
from msb.errors import DeviceError, UsageError, shorten
from msb.render.backend import Drawn
from msb.render.frame import Frame

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from msb.asset import Asset
    from msb.methods import Order, Sampling
    from msb.scenes import Camera

    Color = tuple[float, float, float]

FLOAT, HALF = "rgba32float", "rgba16float"
_ROOM = {FLOAT: 1 << 23, HALF: 1 << 24}
"""The most samples of a band: 256 MiB of two targets."""


class HardwareRenderer:
    """Draws an asset of a blended method as quads in depth order, through wgpu-py.

    Parameters
    ----------
    asset : Asset
    device : {"cpu", "gpu"}, optional
        "cpu" is a software adapter, "gpu" anything else; a GPU where there is one if not given.
    settings : mapping, optional
        Overrides of the asset's settings.
    order, sampling : str
        As for the dedicated tier in OpenCL.
    half : bool
        Whether to blend into half floats even where the adapter can blend float32.

    Raises
    ------
    UsageError
        `ENGINE_MISSING`, `DEVICE_SELECTOR`, `SETTING_UNKNOWN`, `SETTING_VALUE`, `USAGE`.
    Unsupported
        `UNSUPPORTED_TIER`: the method's package brings no WGSL.
    AssetError
        Values that cannot be drawn.
    DeviceError
        `ENGINE_FAILED`, `DEVICE_NOT_FOUND`, `DEVICE_MEMORY`.
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
        debug: bool = False,
    ) -> None:
        kind = device_kind(device, self.name)
        check_modes(order, sampling)
        missing = WgpuRenderer.missing()
        if missing is not None:
            raise UsageError("ENGINE_MISSING", f"renderer {self.name}: {missing}", value=self.name)
        self._packed = pack(asset, settings)
        import wgpu

        self.version = wgpu.__version__
        self._gpu = wgpu
        adapter = choose_adapter(kind)
        about = dict(adapter.info)
        features = [name for name in ("timestamp-query", "float32-blendable") if name in adapter.features]
        self._format = FLOAT if "float32-blendable" in features and not half else HALF
        self.device_info = {
            "platform": f"{about['backend_type']}, {about['description']}".rstrip(", "),
            "name": about["device"],
            "kind": "cpu" if about["adapter_type"] == "CPU" else "gpu",
        }
        limits = {
            name: adapter.limits[name]
            for name in (
                "max-buffer-size",
                "max-storage-buffer-binding-size",
                "max-texture-dimension-2d",
            )
        }
        self._side = limits["max-texture-dimension-2d"]
        room = Limits(limits["max-storage-buffer-binding-size"], limits["max-buffer-size"])
        plan = make_plan(
            self._packed,
            room,
            about["device"],
            order=order,
            sampling=sampling,
            form=self._format,
            debug=debug,
        )
        self._plan = plan
        with self._told("opening the device"):
            self._device = adapter.request_device_sync(required_features=features, required_limits=limits)
            self._runs = DevicePlan(wgpu, self._device, plan)
            timed = "timestamp-query" in features
            self._tick = nanoseconds_a_tick(self._device) if timed else None
        self._size: tuple[int, int] | None = None
        self._queries: Any = None

    def render(self, camera: Camera, background: Color) -> Frame:
        """Draw the asset from `camera` over `background` (RGB, in the asset's colour space)."""
        with self._told("drawing"):
            drawn = self._run(camera, background, read=True)
            pixels = self._mapped("pixels, read back").view(np.float32)
            keys = self._runs.read("keys").view(np.uint32)[: self._packed.faces]
        found = np.zeros((camera.height, camera.width, 5), np.float32)
        for band in self._runs.bands:
            first = band.offset // 4
            here = pixels[first : first + 5 * band.width * band.height]
            place = found[band.y : band.y + band.height, band.x : band.x + band.width]
            place[:] = here.reshape(band.height, band.width, 5)
        return Frame(
            image=np.ascontiguousarray(found[..., :3]),
            alpha=np.ascontiguousarray(found[..., 3]),
            depth=np.ascontiguousarray(found[..., 4]),
            visible=keys != np.uint32(0xFFFFFFFF),
            timings=drawn.stages,
        )

    def draw(self, camera: Camera, background: Color) -> Drawn:
        """Draw and wait, reading nothing back."""
        with self._told("drawing"):
            return self._run(camera, background, read=False)

    def _run(self, camera: Camera, background: Color, *, read: bool) -> Drawn:
        self._make_targets(camera.width, camera.height)
        start = time.perf_counter()
        runs, queue = self._runs, self._device.queue
        queue.write_buffer(runs.held["view"], 0, self._packed.view_bytes(camera, background))
        encoder = self._device.create_command_encoder()
        runs.encode(encoder, self._queries)
        stages = runs.stages()
        if read:
            size = runs.held["pixels"].size
            encoder.copy_buffer_to_buffer(runs.held["pixels"], 0, runs.held["pixels, read back"], 0, size)
        if self._queries is not None:
            encoder.resolve_query_set(self._queries, 0, 2 * len(stages), runs.held["times"], 0)
        size = runs.held["times"].size
        encoder.copy_buffer_to_buffer(runs.held["times"], 0, runs.held["times, read back"], 0, size)
        queue.submit([encoder.finish()])
        times = self._mapped("times, read back").view(np.uint64).reshape(-1, 2)
        waited = 1000 * (time.perf_counter() - start)
        if self._tick is None:
            return Drawn({WALL_CLOCK: waited}, waited)
        found: dict[str, float] = {}
        for stage, (began, ended) in zip(stages, times.tolist(), strict=True):
            found[stage] = found.get(stage, 0.0) + max(0, ended - began) * self._tick / 1e6
        return Drawn(found, max(0, int(times[-1, 1]) - int(times[0, 0])) * self._tick / 1e6)

    def _make_targets(self, width: int, height: int) -> None:
        if self._size == (width, height):
            return
        self._size = None
        runs = self._runs
        runs.set_bands(bands_of(width, height, self._plan.scale, self._side, _ROOM[self._format]))
        count = 2 * len(runs.stages())
        if self._tick is not None:
            if self._queries is not None:
                self._queries.destroy()
            self._queries = self._device.create_query_set(type="timestamp", count=count)
        # Each frame ends with a copy of these; that they can be read says that the frame is done.
        runs.buffer("times", 8 * count, "query_resolve", "copy_src")
        runs.buffer("times, read back", 8 * count, "copy_dst", "map_read")
        self._size = width, height

    def _mapped(self, name: str) -> NDArray[np.uint8]:
        buffer = self._runs.held[name]
        buffer.map_sync(self._gpu.MapMode.READ)
        try:
            return np.frombuffer(buffer.read_mapped(), np.uint8).copy()
        finally:
            buffer.unmap()

    def decisions(self) -> tuple[NDArray[np.uint32], NDArray[np.int32]]:
        """Return what decided about faces in the last frame, with `debug`.

        Returns
        -------
        keys : (F,) uint32
            The bits of the depth key; from 0xfffffffe on for faces that are not drawn, 0xffffffff for those
            that the official culling drops.
        rectangles : (F, 4) int32
            The official tiles x0, y0, x1, y1 of kept faces, high ends excluded; 0 for the others.
        """
        count = self._packed.faces
        keys = self._runs.read("keys").view(np.uint32)[:count]
        return keys, self._runs.read("rectangles").view(np.int32).reshape(-1, 4)[:count]

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes of every buffer and texture."""
        return {name: _nbytes(thing) for name, thing in self._runs.held.items()}

    def close(self) -> None:
        """Release everything."""
        self._runs.close()
        self._device.destroy()

    @contextlib.contextmanager
    def _told(self, doing: str) -> Iterator[None]:
        """Turn what wgpu raises into an error of ours."""
        try:
            yield
        except self._gpu.GPUOutOfMemoryError as error:
            text = f"{self.device_info['name']}: out of memory, {doing}"
            raise DeviceError("DEVICE_MEMORY", text) from error
        except (self._gpu.GPUError, RuntimeError) as error:
            text = f"{self.device_info['name']}: {doing}: {shorten(str(error), 200)}"
            raise DeviceError("ENGINE_FAILED", text) from error


def _nbytes(thing: Any) -> int:
    if hasattr(thing, "map_sync"):
        return int(thing.size)
    width, height, _ = thing.size
    return int(width * height * (16 if thing.format == FLOAT else 8))

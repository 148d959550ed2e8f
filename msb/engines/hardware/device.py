"""A plan on a device of wgpu-py: its buffers, pipelines and commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.engines.hardware.plan import SLOT, Compute, Draws

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from msb.engines.hardware.plan import Binding, Plan

_LAYOUTS = {
    "uniform": {"buffer": {"type": "uniform"}},
    "read": {"buffer": {"type": "read-only-storage"}},
    "write": {"buffer": {"type": "storage"}},
    "texture": {"texture": {"sample_type": "unfilterable-float", "view_dimension": "2d"}},
    "numbers": {"texture": {"sample_type": "uint", "view_dimension": "2d"}},
}
Z_BUFFER = "z-buffer"
"""The texture of depths, where a plan has one."""
_DEPTH = "depth32float"
PIXEL_BYTES = 20
"""Red, green, blue, alpha and depth, float32."""


@dataclass(frozen=True)
class Band:
    """A part of the frame, in pixels, and where its pixels begin in the buffer `pixels`, in bytes."""

    x: int
    y: int
    width: int
    height: int
    offset: int


def bands_of(width: int, height: int, scale: int, side: int, room: int) -> list[Band]:
    """Return the bands of a frame.

    Parameters
    ----------
    side : int
        The most samples of a band along each axis.
    room : int
        The most pixels of a band.
    """
    columns = min(width, side // scale, room)
    rows = max(min(height, side // scale, room // columns), 1)
    found, offset = [], 0
    for y in range(0, height, rows):
        for x in range(0, width, columns):
            band = Band(x, y, min(columns, width - x), min(rows, height - y), offset)
            offset += -(-PIXEL_BYTES * band.width * band.height // SLOT) * SLOT
            found.append(band)
    return found


class DevicePlan:
    """Runs a plan."""

    def __init__(self, gpu: Any, device: Any, plan: Plan) -> None:
        self._gpu, self._device, self._plan = gpu, device, plan
        self.held: dict[str, Any] = {}
        self._modules = {name: device.create_shader_module(code=code) for name, code in plan.modules.items()}
        for name, (size, usages) in plan.buffers.items():
            self.buffer(name, size, *usages)
            if name in plan.data:
                array = np.ascontiguousarray(plan.data[name])
                device.queue.write_buffer(self.held[name], 0, array)
        self._pipelines: dict[int, Any] = {}
        self._layouts: dict[int, Any] = {}
        for number, step in enumerate((*plan.passes, *plan.band_passes)):
            self._layouts[number] = self._layout(step.bindings)
            self._pipelines[number] = self._pipeline(step, self._layouts[number])
        self._groups: dict[tuple[int, int], Any] = {}

    def buffer(self, name: str, size: int, *usages: str) -> Any:
        """Make a buffer in place of the one of that name."""
        old = self.held.pop(name, None)
        if old is not None:
            old.destroy()
        usage = 0
        for word in usages:
            usage |= getattr(self._gpu.BufferUsage, word.upper())
        self.held[name] = self._device.create_buffer(size=size, usage=usage)
        return self.held[name]

    def _layout(self, bindings: Iterable[Binding]) -> Any:
        stages = self._gpu.ShaderStage
        visible = stages.COMPUTE | stages.VERTEX | stages.FRAGMENT
        entries = [
            {
                "binding": binding.number,
                "visibility": stages.COMPUTE if binding.kind == "write" else visible,
                **_LAYOUTS[binding.kind],
            }
            for binding in bindings
        ]
        return self._device.create_bind_group_layout(entries=entries)

    def _pipeline(self, step: Compute | Draws, layout: Any) -> Any:
        module = self._modules[step.module]
        whole = self._device.create_pipeline_layout(bind_group_layouts=[layout])
        if isinstance(step, Compute):
            return self._device.create_compute_pipeline(
                layout=whole, compute={"module": module, "entry_point": step.entry}
            )
        one = {"src_factor": "one-minus-dst-alpha", "dst_factor": "one", "operation": "add"}
        blended: dict[str, Any] = {} if step.z_buffer else {"blend": {"color": one, "alpha": one}}
        nearest = {"format": _DEPTH, "depth_write_enabled": True, "depth_compare": "less"}
        attributes = [
            {"format": "float32x4", "offset": 16 * k, "shader_location": k} for k in range(step.members)
        ]
        targets = [{"format": self._plan.format, **blended} for _ in step.targets]
        return self._device.create_render_pipeline(
            layout=whole,
            vertex={
                "module": module,
                "entry_point": "corner",
                "buffers": [
                    {"array_stride": 16 * step.members, "step_mode": "instance", "attributes": attributes}
                ],
            },
            primitive={"topology": "triangle-strip", "cull_mode": "none"},
            depth_stencil=nearest if step.z_buffer else None,
            fragment={
                "module": module,
                "entry_point": "nearest" if step.z_buffer else "blend",
                "targets": targets,
            },
        )

    def set_bands(self, bands: list[Band]) -> None:
        """Make targets and results for frames of these bands."""
        self.bands = bands
        self._groups = {key: group for key, group in self._groups.items() if key[0] < len(self._plan.passes)}
        rows = np.zeros((len(bands), SLOT // 4), np.uint32)
        for row, band in zip(rows, bands, strict=True):
            row[:5] = band.x, band.y, band.width, band.height, band.offset // 4
        self.buffer("bands", rows.nbytes, "uniform", "copy_dst")
        self._device.queue.write_buffer(self.held["bands"], 0, rows)
        size = bands[-1].offset + PIXEL_BYTES * bands[-1].width * bands[-1].height
        self.buffer("pixels", size, "storage", "copy_src")
        self.buffer("pixels, read back", size, "copy_dst", "map_read")
        usage = self._gpu.TextureUsage.RENDER_ATTACHMENT | self._gpu.TextureUsage.TEXTURE_BINDING
        scale = self._plan.scale
        for name, form in self._targets().items():
            old = self.held.pop(name, None)
            if old is not None:
                old.destroy()
            self.held[name] = self._device.create_texture(
                size=(scale * bands[0].width, scale * bands[0].height, 1), format=form, usage=usage
            )

    def _targets(self) -> dict[str, str]:
        """Return name -> format of what is drawn into."""
        step = next(step for step in self._plan.band_passes if isinstance(step, Draws))
        found = dict.fromkeys(step.targets, self._plan.format)
        return {**found, Z_BUFFER: _DEPTH} if step.z_buffer else found

    def _group(self, number: int, step: Compute | Draws, k: int) -> Any:
        """Return the bind group of a step for band `k`."""
        if (number, k) not in self._groups:
            entries = [
                {"binding": binding.number, "resource": self._resource(binding, k)}
                for binding in step.bindings
            ]
            layout = self._layouts[number]
            self._groups[number, k] = self._device.create_bind_group(layout=layout, entries=entries)
        return self._groups[number, k]

    def _resource(self, binding: Binding, k: int) -> Any:
        held = self.held[binding.name]
        if binding.kind in ("texture", "numbers"):
            return held.create_view()
        offset, size = binding.offset, binding.size
        if binding.name == "pixels":
            band = self.bands[k]
            offset, size = band.offset, PIXEL_BYTES * band.width * band.height
        elif binding.per_band:
            offset = SLOT * k
        return {"buffer": held, "offset": offset, "size": held.size - offset if size is None else size}

    def stages(self) -> list[tuple[str, list[tuple[int, int]]]]:
        """Return what a frame runs in order: a stage, and steps by their number and their band.

        Dispatches of one stage that follow each other are one pass of commands; a draw is one of its own.
        """
        found: list[tuple[str, list[tuple[int, int]]]] = []
        for number, step in enumerate(self._plan.passes):
            if not found or found[-1][0] != step.stage:
                found.append((step.stage, []))
            found[-1][1].append((number, 0))
        first = len(self._plan.passes)
        for band in range(len(self.bands)):
            for number, drawn in enumerate(self._plan.band_passes, first):
                found.append((drawn.stage, [(number, band)]))
        return found

    def encode(self, encoder: Any, steps: list[tuple[int, int]], timed: dict[str, Any]) -> None:
        """Encode the steps of one entry of `stages`; `timed` says where its timestamps go."""
        whole = (*self._plan.passes, *self._plan.band_passes)
        number, band = steps[0]
        drawn = whole[number]
        if isinstance(drawn, Draws):
            self._draw(encoder, number, drawn, band, timed)
            return
        computing = encoder.begin_compute_pass(**timed)
        for number, band in steps:
            step = whole[number]
            assert isinstance(step, Compute)
            self._dispatch(computing, number, step, band)
        computing.end()

    def _dispatch(self, computing: Any, number: int, step: Compute, k: int) -> None:
        computing.set_pipeline(self._pipelines[number])
        computing.set_bind_group(0, self._group(number, step, k))
        if step.indirect is not None:
            computing.dispatch_workgroups_indirect(self.held["arguments"], step.indirect)
        elif step.groups is not None:
            computing.dispatch_workgroups(step.groups)
        else:
            band = self.bands[k]
            computing.dispatch_workgroups(-(-band.width // 64), band.height)

    def _draw(self, encoder: Any, number: int, step: Draws, k: int, timed: dict[str, Any]) -> None:
        band, scale = self.bands[k], self._plan.scale
        first = step.z_buffer or "clear"
        if step.z_buffer:
            timed["depth_stencil_attachment"] = {
                "view": self.held[Z_BUFFER].create_view(),
                "depth_load_op": first,
                "depth_store_op": "store",
                "depth_clear_value": 1.0,
            }
        drawing = encoder.begin_render_pass(
            color_attachments=[
                {
                    "view": self.held[target].create_view(),
                    "load_op": first,
                    "store_op": "store",
                    "clear_value": (0, 0, 0, 0),
                }
                for target in step.targets
            ],
            **timed,
        )
        drawing.set_viewport(0, 0, scale * band.width, scale * band.height, 0, 1)
        drawing.set_scissor_rect(0, 0, scale * band.width, scale * band.height)
        drawing.set_pipeline(self._pipelines[number])
        drawing.set_bind_group(0, self._group(number, step, k))
        for records, offset in step.records:
            drawing.set_vertex_buffer(0, self.held[records])
            drawing.draw_indirect(self.held["arguments"], offset)
        drawing.end()

    def read(self, name: str) -> NDArray[np.uint8]:
        """Return the bytes of a buffer, by way of one that the host can map."""
        buffer = self.held[name]
        return np.frombuffer(self._device.queue.read_buffer(buffer), np.uint8)

    def close(self) -> None:
        """Release every buffer and texture."""
        for thing in self.held.values():
            thing.destroy()
        self.held.clear()

"""Execution of a plan with wgpu-py: buffers, pipelines and commands."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.engines.hardware.plan import SLOT, Binding, ComputePass, DrawPass, Plan
from msb.engines.webgpu_adapter import Gpu

# The entry in a bind group layout for each kind of `Binding`.
_LAYOUTS = {
    "uniform": {"buffer": {"type": "uniform"}},
    "read": {"buffer": {"type": "read-only-storage"}},
    "write": {"buffer": {"type": "storage"}},
    "texture": {"texture": {"sample_type": "unfilterable-float", "view_dimension": "2d"}},
    "numbers": {"texture": {"sample_type": "uint", "view_dimension": "2d"}},
    "store": {"storage_texture": {"format": "r32float", "access": "write-only", "view_dimension": "2d"}},
}
# Name of the depth texture of a plan with a z-buffer.
Z_BUFFER = "z-buffer"
_DEPTH, _STORED = "depth32float", "r32float"
# Number of bytes of a pixel in the output buffer: red, green, blue, alpha and depth, float32.
PIXEL_BYTES = 20


@dataclass(frozen=True)
class Band:
    """A rectangle of the frame, in pixels; its values start at byte `offset` of the buffer `pixels`."""

    x: int
    y: int
    width: int
    height: int
    offset: int


def split_into_bands(width: int, height: int, scale: int, side: int, room: int) -> list[Band]:
    """Return the bands that cover a frame of `width` x `height` pixels.

    A band has at most `room` pixels. A band is at most `side` samples wide and high; a pixel has `scale`
    samples along each axis.
    """
    columns = min(width, side // scale, room)
    rows = max(min(height, side // scale, room // columns), 1)
    bands, offset = [], 0
    for y in range(0, height, rows):
        for x in range(0, width, columns):
            band = Band(x, y, min(columns, width - x), min(rows, height - y), offset)
            offset += -(-PIXEL_BYTES * band.width * band.height // SLOT) * SLOT
            bands.append(band)
    return bands


def count_pixel_bytes(bands: list[Band]) -> int:
    """Return the size in bytes of the buffer for the pixels of all bands."""
    return bands[-1].offset + PIXEL_BYTES * bands[-1].width * bands[-1].height


class DevicePlan:
    """A frame plan with its buffers and compiled pipelines on a device."""

    def __init__(self, gpu: Gpu, plan: Plan) -> None:
        self._gpu, self._plan, device = gpu, plan, gpu.device
        self._modules = {name: device.create_shader_module(code=code) for name, code in plan.modules.items()}
        for name, (size, usages) in plan.buffers.items():
            gpu.buffer(name, size, *usages)
            if name in plan.data:
                array = np.ascontiguousarray(plan.data[name])
                device.queue.write_buffer(gpu.resources[name], 0, array)
        self._steps = (*plan.passes, *plan.band_passes)
        # Steps with the same entry point and layout share a pipeline, because compiling is slow.
        compiled: dict[Any, tuple[Any, Any]] = {}
        # Bind group layout and pipeline of each step.
        self._pipelines: list[tuple[Any, Any]] = []
        for step in self._steps:
            kinds = tuple((binding.number, binding.kind) for binding in step.bindings)
            key = step.module, step.entry if isinstance(step, ComputePass) else "", kinds
            if key not in compiled:
                layout = self._make_layout(step.bindings)
                compiled[key] = layout, self._make_pipeline(step, layout)
            self._pipelines.append(compiled[key])
        # The bind group for each pair (step number, band number).
        self._groups: dict[tuple[int, int], Any] = {}

    def _make_layout(self, bindings: Iterable[Binding]) -> Any:
        import wgpu

        stages = wgpu.ShaderStage
        visible = stages.COMPUTE | stages.VERTEX | stages.FRAGMENT
        entries = [
            {
                "binding": binding.number,
                "visibility": stages.COMPUTE if binding.kind in ("write", "store") else visible,
                **_LAYOUTS[binding.kind],
            }
            for binding in bindings
        ]
        return self._gpu.device.create_bind_group_layout(entries=entries)

    def _make_pipeline(self, step: ComputePass | DrawPass, layout: Any) -> Any:
        module = self._modules[step.module]
        whole = self._gpu.device.create_pipeline_layout(bind_group_layouts=[layout])
        if isinstance(step, ComputePass):
            return self._gpu.device.create_compute_pipeline(
                layout=whole, compute={"module": module, "entry_point": step.entry}
            )
        color, alpha = (
            {"src_factor": source, "dst_factor": target, "operation": "add"}
            for source, target in self._plan.blend
        )
        blended: dict[str, Any] = {} if step.z_buffer else {"blend": {"color": color, "alpha": alpha}}
        nearest = {"format": _DEPTH, "depth_write_enabled": True, "depth_compare": "less"}
        attributes = [
            {"format": "float32x4", "offset": 16 * k, "shader_location": k} for k in range(step.members)
        ]
        targets = [{"format": self._plan.format, **blended} for _ in step.targets]
        return self._gpu.device.create_render_pipeline(
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
        """Create the textures and buffers for frames with these bands, the largest band first."""
        self.bands = bands
        self._groups = {key: group for key, group in self._groups.items() if key[0] < len(self._plan.passes)}
        # The uniform buffer has a slot for each band: x, y, width, height, and the index of the first output
        # value.
        rows = np.zeros((len(bands), SLOT // 4), np.uint32)
        for row, band in zip(rows, bands, strict=True):
            row[:5] = band.x, band.y, band.width, band.height, band.offset // 4
        gpu, scale, size = self._gpu, self._plan.scale, count_pixel_bytes(bands)
        gpu.buffer("bands", rows.nbytes, "uniform", "copy_dst")
        gpu.device.queue.write_buffer(gpu.resources["bands"], 0, rows)
        gpu.buffer("pixels", size, "storage", "copy_src")
        gpu.buffer("pixels, read back", size, "copy_dst", "map_read")
        width, height = scale * bands[0].width, scale * bands[0].height
        for name, form in self._targets().items():
            usage = "storage_binding" if form == _STORED else "render_attachment"
            gpu.texture(name, width, height, form, "texture_binding", usage)

    def _targets(self) -> dict[str, str]:
        """Return the formats, by name, of the textures that the passes of a band write."""
        formats: dict[str, str] = {}
        for step in self._plan.band_passes:
            if isinstance(step, DrawPass):
                formats |= dict.fromkeys(step.targets, self._plan.format)
                formats |= {Z_BUFFER: _DEPTH} if step.z_buffer else {}
            formats |= {binding.name: _STORED for binding in step.bindings if binding.kind == "store"}
        return formats

    def _group(self, number: int, step: ComputePass | DrawPass, k: int) -> Any:
        """Return the bind group of step `number` for band `k`."""
        if (number, k) not in self._groups:
            entries = [
                {"binding": binding.number, "resource": self._resource(binding, k)}
                for binding in step.bindings
            ]
            layout, _ = self._pipelines[number]
            self._groups[number, k] = self._gpu.device.create_bind_group(layout=layout, entries=entries)
        return self._groups[number, k]

    def _resource(self, binding: Binding, k: int) -> Any:
        """Return the resource of a binding in band `k`: a texture view, or a range of a buffer."""
        resource = self._gpu.resources[binding.name]
        if binding.kind in ("texture", "numbers", "store"):
            return resource.create_view()
        offset, size = binding.offset, binding.size
        if binding.name == "pixels":
            band = self.bands[k]
            offset, size = band.offset, PIXEL_BYTES * band.width * band.height
        elif binding.per_band:
            offset = SLOT * k
        return {
            "buffer": resource,
            "offset": offset,
            "size": resource.size - offset if size is None else size,
        }

    def stages(self) -> list[tuple[str, list[tuple[int, int]]]]:
        """Return the stages of a frame in order.

        A stage consists of a name and a list of pairs (step number, band number).
        """
        first = len(self._plan.passes)
        order = [(number, 0) for number in range(first)]
        order += [(number, k) for k in range(len(self.bands)) for number in range(first, len(self._steps))]
        return [
            (stage, list(steps)) for stage, steps in groupby(order, lambda step: self._steps[step[0]].stage)
        ]

    def encode(
        self, encoder: Any, steps: list[tuple[int, int]], timed: tuple[Any, int, int] | None = None
    ) -> None:
        """Encode the steps of one stage.

        `timed` holds a query set, the index of the start query, and the index of the end query. Consecutive
        compute steps share a compute pass; every draw step is a separate render pass.
        """
        # Group the steps into compute and render passes.
        passes: list[list[tuple[int, int]]] = []
        for number, band in steps:
            if not passes or DrawPass in (type(self._steps[number]), type(self._steps[passes[-1][0][0]])):
                passes.append([])
            passes[-1].append((number, band))
        for k, part in enumerate(passes):
            stamps: dict[str, Any] = {}
            if timed is not None and k == 0:
                stamps["beginning_of_pass_write_index"] = timed[1]
            if timed is not None and k == len(passes) - 1:
                stamps["end_of_pass_write_index"] = timed[2]
            options = {"timestamp_writes": {"query_set": timed[0], **stamps}} if timed and stamps else {}
            number, band = part[0]
            first = self._steps[number]
            if isinstance(first, DrawPass):
                self._draw(encoder, number, first, band, options)
                continue
            computing = encoder.begin_compute_pass(**options)
            for number, band in part:
                step = self._steps[number]
                assert isinstance(step, ComputePass)
                self._dispatch(computing, number, step, band)
            computing.end()

    def _dispatch(self, computing: Any, number: int, step: ComputePass, k: int) -> None:
        computing.set_pipeline(self._pipelines[number][1])
        computing.set_bind_group(0, self._group(number, step, k))
        if step.indirect is not None:
            computing.dispatch_workgroups_indirect(self._gpu.resources["arguments"], step.indirect)
        elif step.groups is not None:
            computing.dispatch_workgroups(step.groups)
        else:
            band = self.bands[k]
            computing.dispatch_workgroups(-(-band.width // 64), band.height)

    def _draw(self, encoder: Any, number: int, step: DrawPass, k: int, timed: dict[str, Any]) -> None:
        band, scale = self.bands[k], self._plan.scale
        if step.z_buffer:
            timed["depth_stencil_attachment"] = {
                "view": self._gpu.resources[Z_BUFFER].create_view(),
                "depth_load_op": step.load,
                "depth_store_op": "store",
                "depth_clear_value": 1.0,
            }
        drawing = encoder.begin_render_pass(
            color_attachments=[
                {
                    "view": self._gpu.resources[target].create_view(),
                    "load_op": step.load,
                    "store_op": "store",
                    "clear_value": (0, 0, 0, self._plan.clear),
                }
                for target in step.targets
            ],
            **timed,
        )
        drawing.set_viewport(0, 0, scale * band.width, scale * band.height, 0, 1)
        drawing.set_scissor_rect(0, 0, scale * band.width, scale * band.height)
        drawing.set_pipeline(self._pipelines[number][1])
        drawing.set_bind_group(0, self._group(number, step, k))
        for records, offset in step.records:
            drawing.set_vertex_buffer(0, self._gpu.resources[records])
            drawing.draw_indirect(self._gpu.resources["arguments"], offset)
        drawing.end()

    def read(self, name: str) -> NDArray[np.uint8]:
        """Return the bytes of a buffer."""
        buffer = self._gpu.resources[name]
        return np.frombuffer(self._gpu.device.queue.read_buffer(buffer), np.uint8)

    def close(self) -> None:
        """Drop all references to objects of the device, because references prevent their release."""
        for references in (self._groups, self._pipelines, self._modules):
            references.clear()

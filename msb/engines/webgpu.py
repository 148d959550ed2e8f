"""The renderer `wgpu` uses Vulkan, Metal or Direct3D 12 through wgpu-py, with a hardware z-buffer.

The pipeline draws an opaque, unlit mesh with vertex colours or textures. The camera has our intrinsics and
pose, a near plane at 0.01 and no far plane. The depth buffer is reversed: 1 at the near plane, 0 at infinity.
Colours are written to a float32 render target, so they are neither rounded nor converted.
"""

import contextlib
import time
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.base.extras import install, is_installed
from msb.base.version import __version__
from msb.engines.engine import DRAW, NEAR, WALL_CLOCK, Engine, opaque_frame
from msb.engines.webgpu_adapter import INSTALL, Gpu, list_adapters
from msb.engines.webgpu_texture import ATTRIBUTES, TexturedMesh
from msb.errors import DeviceError
from msb.render.backend import DrawTime
from msb.render.frame import Frame
from msb.scenes import Camera
from msb.scenes.colors import Color

IMAGE_FORMAT = "rgba32float"
IDS_FORMAT = "r32uint"
DEPTH_FORMAT = "depth32float"
_HEAD = """
struct Camera { clip: mat4x4<f32>, center: vec4<f32>, rest: vec4<f32> };
@group(0) @binding(0) var<uniform> camera: Camera;
struct Seen { @location(0) color: vec4<f32> IDS_FIELD };
"""
_SHADER = """
struct Between { @builtin(position) place: vec4<f32>, @location(0) color: vec3<f32> };
@vertex fn project(@location(0) place: vec3<f32>, @location(1) color: vec4<f32>) -> Between {
    // The camera's centre is the sum of two float32 values; `rest` is the rounding error of `center`.
    let local = (place - camera.center.xyz) - camera.rest.xyz;
    return Between(camera.clip * vec4<f32>(local, 1.0), color.rgb);
}
@fragment fn shade(between: Between IDS_INPUT) -> Seen {
    return Seen(vec4<f32>(between.color, 1.0) IDS_VALUE);
}
"""


class WgpuRenderer(Engine):
    """Draws through wgpu-py.

    With `device` "cpu", a software adapter draws. With "gpu", any other adapter draws.

    Frames have a `face_id` if the adapter supports primitive indices. If the adapter supports timestamps, the
    device measures times. If the adapter has no timestamps, the wall clock measures times in the stage
    `WALL_CLOCK`.
    """

    name = "wgpu"
    tiers = ("standard", "dedicated")

    def __init__(
        self,
        asset: Asset,
        *,
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        supersample: int = 1,
    ) -> None:
        super().__init__(asset, device=device, settings=settings, supersample=supersample)
        self.version = self.installed()
        self._gpu = gpu = Gpu(self._kind, ("timestamp-query", "primitive-index"))
        self.device_info = gpu.describe()
        self._textured: TexturedMesh | None = None
        self._has_face_ids = "primitive-index" in gpu.features or self._mesh.textured is not None
        limit = gpu.adapter.limits["max-buffer-size"]
        self._max_side = gpu.adapter.limits["max-texture-dimension-2d"]
        needed = max(self._mesh.positions.nbytes, self._mesh.indices.nbytes, 16 * len(self._mesh.colors))
        if self._mesh.textured is not None:
            needed = 16 * self._mesh.indices.size
        if needed > limit:
            text = f"this mesh needs a buffer of {needed:,} bytes, but {gpu.name} allows only {limit:,}"
            raise DeviceError("DEVICE_MEMORY", text)
        with gpu.setting_up():
            gpu.open(("max-buffer-size", "max-texture-dimension-2d"), timed=True)
            self._make_mesh()
            self._pipelines = {ids: self._make_pipeline(ids) for ids in {False, self._has_face_ids}}
            gpu.make_clock(2)
        self._size: tuple[int, int] | None = None

    @classmethod
    def of_tier(cls, tier: str) -> Any:
        """Return the renderer class of `tier`; the class for the dedicated tier draws native renderings."""
        if tier == "standard":
            return cls
        from msb.engines.hardware.renderer import HardwareRenderer

        return HardwareRenderer

    @classmethod
    def missing(cls) -> str | None:
        """Return a message if the package or a graphics driver is missing."""
        if not is_installed("wgpu"):
            return f"wgpu-py is not installed: {install('wgpu')}"
        return None if list_adapters() else f"no graphics driver was found; {INSTALL}"

    @classmethod
    def installed(cls) -> str:
        """Return the versions of this package, which contains the shaders, and of wgpu-py."""
        with contextlib.suppress(PackageNotFoundError):
            return f"{__version__}, wgpu-py {version('wgpu')}"
        return __version__

    def memory(self) -> Mapping[str, int]:
        """Return the bytes of every buffer and texture, by use."""
        return self._gpu.memory()

    def close(self) -> None:
        """Release everything."""
        self._pipelines.clear()
        self._gpu.close()

    def memory_groups(self) -> Mapping[str, str]:
        """Return the report group of each memory use. Textures belong to the group "appearance"."""
        textures = (use for use in self._gpu.resources if use.startswith("texture "))
        return {**super().memory_groups(), **dict.fromkeys(textures, "appearance")}

    def _make_mesh(self) -> None:
        """Upload the camera buffer and the mesh."""
        mesh, colors = self._mesh, self._mesh.colors
        self._gpu.buffer("camera", 96, "uniform", "copy_dst")
        if mesh.textured is not None:
            self._textured = TexturedMesh(self._gpu, mesh, mesh.textured, self._max_side)
            return
        if colors.dtype == np.uint8:
            colors = np.concatenate([colors, np.full((len(colors), 1), 255, np.uint8)], axis=1)
            self._color_layout = 4, "unorm8x4"
        else:
            self._color_layout = 12, "float32x3"
        self._gpu.buffer("positions", 0, "vertex", data=mesh.positions)
        self._gpu.buffer("vertex colors", 0, "vertex", data=colors)
        self._gpu.buffer("indices", 0, "index", data=mesh.indices)

    def _make_pipeline(self, ids: bool) -> Any:
        """Return the render pipeline. With `ids`, the pipeline writes face numbers to a second target."""
        if self._textured is None:
            attributes = {"positions": (12, "float32x3"), "vertex colors": self._color_layout}
            source = ("enable primitive_index;" if ids else "") + _HEAD + _SHADER
        else:
            attributes, source = ATTRIBUTES, _HEAD + self._textured.shader
        source = source.replace("IDS_FIELD", ", @location(1) face: u32" if ids else "")
        source = source.replace("IDS_INPUT", ", @builtin(primitive_index) face: u32" if ids else "")
        source = source.replace("IDS_VALUE", ", face" if ids else "")
        shader = self._gpu.device.create_shader_module(code=source)
        buffers = [
            {
                "array_stride": stride,
                "step_mode": "vertex",
                "attributes": [{"format": kind, "offset": 0, "shader_location": location}],
            }
            for location, (stride, kind) in enumerate(attributes.values())  # one vertex buffer per attribute
        ]
        targets = [{"format": IMAGE_FORMAT}, *([{"format": IDS_FORMAT}] if ids else [])]
        return self._gpu.device.create_render_pipeline(
            layout="auto",
            vertex={"module": shader, "entry_point": "project", "buffers": buffers},
            primitive={"topology": "triangle-list", "cull_mode": "none"},
            depth_stencil={
                "format": DEPTH_FORMAT,
                "depth_write_enabled": True,
                "depth_compare": "greater",  # at equal depths the first face is kept
            },
            fragment={"module": shader, "entry_point": "shade", "targets": targets},
        )

    def _make_targets(self, width: int, height: int) -> None:
        """Create the textures of a frame, and the buffers through which the host reads them."""
        if self._size == (width, height):
            return
        if max(width, height) > self._max_side:
            size = f"{width} x {height}"
            limit = f"{self._max_side} x {self._max_side} pixels"
            text = f"{self.device_info['name']} draws images of at most {limit}, not {size}"
            raise DeviceError("DEVICE_MEMORY", text)
        self._size = None
        formats = {"image": IMAGE_FORMAT, "depth": DEPTH_FORMAT}
        if self._has_face_ids:
            formats["face ids"] = IDS_FORMAT
        for use, form in formats.items():
            self._gpu.texture(use, width, height, form, "render_attachment", "copy_src")
            row = _row_bytes(width, 16 if use == "image" else 4)
            self._gpu.buffer(f"{use}, read back", row * height, "copy_dst", "map_read")
        self._size = width, height

    def _frame(self, camera: Camera, background: Color) -> Frame:
        with self._gpu.reporting("drawing"):
            timing = self._run(camera, background, everything=True)
            image = self._read("image", np.float32, 4)
            depth = self._read("depth", np.float32, 1)
            face_id = self._read_face_ids() if self._has_face_ids else None
        # The depth buffer holds near / z (H, W), and 0 in pixels without a face.
        hit = depth > 0
        depth = np.divide(NEAR, depth, out=np.zeros_like(depth), where=hit, dtype=np.float32)
        return opaque_frame(image[..., :3], hit, depth, background, face_id, timing.stages)

    def _draw(self, camera: Camera, background: Color) -> DrawTime:
        with self._gpu.reporting("drawing"):
            return self._run(camera, background, everything=False)

    def _run(self, camera: Camera, background: Color, *, everything: bool) -> DrawTime:
        """Draw a frame and wait. With `everything`, also draw face ids and make all targets readable."""
        self._make_targets(camera.width, camera.height)
        start = time.perf_counter()
        self._gpu.device.queue.write_buffer(self._gpu.resources["camera"], 0, pack_camera(camera))
        encoder = self._gpu.device.create_command_encoder()
        ids = everything and self._has_face_ids
        self._encode_pass(encoder, background, ids)
        if everything:
            for use, nbytes in (("image", 16), ("depth", 4), *([("face ids", 4)] if ids else [])):
                layout = {
                    "buffer": self._gpu.resources[f"{use}, read back"],
                    "bytes_per_row": _row_bytes(camera.width, nbytes),
                    "rows_per_image": camera.height,
                }
                size = camera.width, camera.height, 1
                encoder.copy_texture_to_buffer({"texture": self._gpu.resources[use]}, layout, size)
        began, ended = self._gpu.run(encoder).tolist()
        waited = 1000 * (time.perf_counter() - start)
        if self._gpu.nanoseconds_per_tick is None:
            return DrawTime({WALL_CLOCK: waited}, waited)
        milliseconds = max(0, ended - began) * self._gpu.nanoseconds_per_tick / 1e6
        return DrawTime({DRAW: milliseconds}, milliseconds)

    def _encode_pass(self, encoder: Any, background: Color, ids: bool) -> None:
        """Encode the render pass; if the device has a clock, write timestamps before and after the pass."""
        resources = self._gpu.resources
        clears = {"image": (*background, 0.0), **({"face ids": (2.0**32 - 1, 0, 0, 0)} if ids else {})}
        options: dict[str, Any] = {}
        if self._gpu.queries is not None:
            options["timestamp_writes"] = {
                "query_set": self._gpu.queries,
                "beginning_of_pass_write_index": 0,
                "end_of_pass_write_index": 1,
            }
        drawing = encoder.begin_render_pass(
            color_attachments=[
                {
                    "view": resources[use].create_view(),
                    "load_op": "clear",
                    "store_op": "store",
                    "clear_value": value,
                }
                for use, value in clears.items()
            ],
            depth_stencil_attachment={
                "view": resources["depth"].create_view(),
                "depth_clear_value": 0.0,
                "depth_load_op": "clear",
                "depth_store_op": "store",
            },
            **options,
        )
        pipeline = self._pipelines[ids]
        drawing.set_pipeline(pipeline)
        entries = [{"binding": 0, "resource": {"buffer": resources["camera"]}}]
        layout = pipeline.get_bind_group_layout(0)
        drawing.set_bind_group(0, self._gpu.device.create_bind_group(layout=layout, entries=entries))
        if self._textured is not None:
            self._textured.draw(drawing, pipeline, ids)
        else:
            drawing.set_vertex_buffer(0, resources["positions"])
            drawing.set_vertex_buffer(1, resources["vertex colors"])
            drawing.set_index_buffer(resources["indices"], "uint32")
            drawing.draw_indexed(self._mesh.indices.size)
        drawing.end()

    def _read_face_ids(self) -> NDArray[np.int32]:
        """Return the index of the visible face for each pixel (H, W), or -1 in pixels without a face."""
        face_id = self._read("face ids", np.uint32, 1)
        empty = face_id == np.uint32(2**32 - 1)
        if self._mesh.numbers is not None:
            face_id = self._mesh.numbers[np.where(empty, 0, face_id)]
        return np.where(empty, -1, face_id.astype(np.int64)).astype(np.int32)

    def _read(self, use: str, dtype: Any, channels: int) -> NDArray[Any]:
        """Return a target as (H, W) or (H, W, channels); rows in the buffer are padded to 256 bytes."""
        assert self._size is not None
        width, height = self._size
        values = self._gpu.read_back(use).view(dtype).reshape(height, -1)[:, : width * channels]
        return np.reshape(values, (height, width) if channels == 1 else (height, width, channels))


def pack_camera(camera: Camera) -> NDArray[np.float32]:
    """Return the uniform buffer of the shader, (24,) float32.

    The buffer contains three values: the column-major 4 x 4 clip matrix for points relative to the camera,
    the camera's centre rounded to float32, and the rounding error of the centre. For a point at pixel (u, v),
    clip x is (2u/W - 1) * depth, clip y is (1 - 2v/H) * depth, and clip w is the depth. The depth buffer
    contains near / depth, because clip z is the distance of the near plane.
    """
    rounded = camera.center.astype(np.float32).astype(np.float64)
    width, height = camera.width, camera.height
    projection = np.array(
        [
            [2 * camera.fx / width, 0, 2 * camera.cx / width - 1, 0],
            [0, -2 * camera.fy / height, 1 - 2 * camera.cy / height, 0],
            [0, 0, 0, NEAR],
            [0, 0, 1, 0],
        ]
    )
    rotation = np.eye(4)
    rotation[:3, :3] = camera.world_to_camera[:3, :3]
    parts = ((projection @ rotation).T.reshape(-1), rounded, [0.0], camera.center - rounded, [0.0])
    with np.errstate(over="ignore"):  # camera coordinates beyond 1e38 overflow; the image is empty
        return np.concatenate(parts).astype(np.float32)


def _row_bytes(width: int, nbytes: int) -> int:
    """Return the number of bytes of a copied row; WebGPU requires a multiple of 256."""
    return -(-nbytes * width // 256) * 256

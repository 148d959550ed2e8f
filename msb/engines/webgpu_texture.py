"""Draws a mesh with textures for the renderer `wgpu`, with the samplers and mip maps of the hardware.

Faces do not share vertices. The faces are drawn in the order of the asset, with one draw call for each run of
consecutive faces with the same texture. If several faces have equal depths, the first face is visible, as in
our renderer.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.look import StaticColors, corner_tint
from msb.asset.texture import ROUNDING, Textured, levels_read
from msb.engines.engine import EngineMesh
from msb.engines.webgpu_adapter import Gpu
from msb.errors import DeviceError

_WRAPS = {"repeat": "repeat", "clamp": "clamp-to-edge", "mirror": "mirror-repeat"}
# For each vertex buffer: bytes per corner, and format.
ATTRIBUTES = {
    "positions": (12, "float32x3"),
    "texture coordinates": (8, "float32x2"),
    "tints": (16, "float32x4"),
}
# The text below is appended to the declarations in webgpu.py. Fragments with an alpha below CUTOFF are
# discarded.
SHADER = """
@group(1) @binding(0) var texels: texture_2d<f32>;
@group(1) @binding(1) var reading: sampler;
struct Between {
    @builtin(position) place: vec4<f32>,
    @location(0) uv: vec2<f32>,
    @location(1) tint: vec4<f32>,
    @location(2) @interpolate(flat) face: u32,
};
@vertex fn project(@builtin(vertex_index) corner: u32, @location(0) place: vec3<f32>,
        @location(1) uv: vec2<f32>, @location(2) tint: vec4<f32>) -> Between {
    let local = (place - camera.center.xyz) - camera.rest.xyz;
    return Between(camera.clip * vec4<f32>(local, 1.0), uv, tint, corner / 3u);
}
@fragment fn shade(between: Between) -> Seen {
    // The mip level from exact derivatives: uv * w and w are affine on the screen (w is 1 / depth here).
    // Hardware uses differences in a block of 2 x 2 pixels, whose logarithm may be off by 0.05.
    let at = between.uv * vec2<f32>(textureDimensions(texels));
    let w = between.place.w;
    let right = (dpdxFine(at * w) - at * dpdxFine(w)) / w;
    let down = (dpdyFine(at * w) - at * dpdyFine(w)) / w;
    let level = log2(max(length(right), length(down)));
    let light = textureSampleLevel(texels, reading, between.uv, level) * between.tint;
    if light.a < CUTOFF { discard; }
    let curve = 1.055 * pow(max(light.rgb, vec3<f32>(0.0031308)), vec3<f32>(1.0 / 2.4)) - 0.055;
    let color = select(12.92 * light.rgb, curve, light.rgb > vec3<f32>(0.0031308));
    let face = between.face;
    return Seen(vec4<f32>(color, 1.0) IDS_VALUE);
}
"""


class TexturedMesh:
    """The corners and textures of a mesh on a device.

    `side` is the device's maximum width and height of a texture, in texels.

    Raises
    ------
    DeviceError
        DEVICE_MEMORY: a texture is larger than the device allows.
    """

    def __init__(self, gpu: Gpu, mesh: EngineMesh, textured: Textured, side: int) -> None:
        self._gpu = gpu
        sampler = textured.sampler
        largest = max(max(image.shape[:2]) for image in textured.images)
        if largest > side:
            text = f"this mesh has a texture of {largest} texels; {gpu.name} allows {side} in each direction"
            raise DeviceError("DEVICE_MEMORY", text)
        colors = StaticColors(mesh.colors, "vertex")
        gpu.buffer("positions", 0, "vertex", data=mesh.positions[mesh.indices.reshape(-1)])
        gpu.buffer("texture coordinates", 0, "vertex", data=textured.uvs)
        gpu.buffer("tints", 0, "vertex", data=corner_tint(colors, mesh.indices))
        for number, image in enumerate(textured.images):
            self._upload(f"texture {number}", levels_read(image, sampler))
        self._sampler = gpu.device.create_sampler(
            address_mode_u=_WRAPS[sampler.wrap_u],
            address_mode_v=_WRAPS[sampler.wrap_v],
            mag_filter=sampler.filter,
            min_filter=sampler.filter,
            mipmap_filter=sampler.filter,
        )
        self._count = len(textured.images)
        numbers = textured.face_texture
        self._runs = [(0, 0, len(mesh.indices))] if numbers is None else split_runs(numbers)
        cutoff = sampler.alpha_cutoff
        self.shader = SHADER.replace("CUTOFF", "-1.0" if cutoff is None else repr(cutoff - ROUNDING))
        self._groups: dict[bool, list[Any]] = {}

    def _upload(self, use: str, levels: list[NDArray[np.uint8]]) -> None:
        """Upload the mip levels of a texture, each (H, W, 3 or 4) uint8 sRGB."""
        gpu, (height, width) = self._gpu, levels[0].shape[:2]
        form = "rgba8unorm-srgb"
        gpu.texture(use, width, height, form, "texture_binding", "copy_dst", levels=len(levels))
        for number, image in enumerate(levels):
            height, width = image.shape[:2]
            texels = np.full((height, width, 4), 255, np.uint8)
            texels[..., : image.shape[2]] = image
            gpu.device.queue.write_texture(
                {"texture": gpu.resources[use], "mip_level": number},
                texels,
                {"bytes_per_row": 4 * width, "rows_per_image": height},
                (width, height, 1),
            )

    def draw(self, drawing: Any, pipeline: Any, ids: bool) -> None:
        """Encode the draw calls into a render pass whose pipeline and camera are already set.

        `ids` is true if `pipeline` draws face ids. Each render pipeline needs separate bind groups.
        """
        gpu = self._gpu
        if ids not in self._groups:
            layout = pipeline.get_bind_group_layout(1)
            self._groups[ids] = [
                gpu.device.create_bind_group(
                    layout=layout,
                    entries=[
                        {"binding": 0, "resource": gpu.resources[f"texture {number}"].create_view()},
                        {"binding": 1, "resource": self._sampler},
                    ],
                )
                for number in range(self._count)
            ]
        for slot, use in enumerate(ATTRIBUTES):
            drawing.set_vertex_buffer(slot, gpu.resources[use])
        for number, first, count in self._runs:
            drawing.set_bind_group(1, self._groups[ids][number])
            drawing.draw(3 * count, 1, 3 * first)


def split_runs(numbers: NDArray[np.uint32]) -> list[tuple[int, int, int]]:
    """Return (value, start, length) of each run of equal consecutive values in an array (F,)."""
    starts = np.concatenate(([0], np.flatnonzero(np.diff(numbers)) + 1))
    lengths = np.diff(np.append(starts, len(numbers)))
    return list(zip(numbers[starts].tolist(), starts.tolist(), lengths.tolist(), strict=True))

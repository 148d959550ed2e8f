"""An asset's triangles on the device, prepared once, in the form that the z-buffer kernels read."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.look import StaticColors, corner_tint, drawn_colors, select_faces, tint_of
from msb.asset.texture import textures_of
from msb.cl import Buffer, Device, sort_pairs
from msb.render.standard.texels import Texels, put_texels

# Bits of the grid to which corners are snapped: steps of 1/4096 pixel.
SUBPIXEL_BITS = 12
# Number of floats in the record of a triangle.
WORDS = 16
# Kinds of colours: RGBA8 per corner in the record, RGB per face in the record, RGB floats per corner in a
# separate buffer, or textures.
BYTES_OF_CORNERS, FLOATS_OF_FACE, FLOATS_OF_CORNERS, TEXTURES = range(4)
# Definitions for every program that includes zbuffer_math.cl.
RECORD_DEFINES = {
    "SUBPIXEL_BITS": SUBPIXEL_BITS,
    "WORDS": WORDS,
    "BYTES_OF_CORNERS": BYTES_OF_CORNERS,
    "FLOATS_OF_FACE": FLOATS_OF_FACE,
    "FLOATS_OF_CORNERS": FLOATS_OF_CORNERS,
    "TEXTURES": TEXTURES,
}
# Number of triangles that a CPU draws at once (SIMD lanes).
BLOCK = 8
# Number of triangles in a cluster, which are culled together by a bounding box.
CLUSTER = 2 * BLOCK
# Number of clusters whose screen rectangles are culled together.
GROUP = 64
_GROUP_SIZE = 64
# Name prefix of scratch buffers that are released before the first frame.
_PREPARATION = "standard preparation"
# Number of vertices that are sampled to find the grid for the drawing order.
_SAMPLES = 1 << 14
# Bits of a Morton code, 10 per axis.
_MORTON_BITS = 30


@dataclass(frozen=True)
class Triangles:
    """The buffers that stay on the device between frames."""

    # Triangle records (slots, 16) words: corners, colours, face. A slot is a position in drawing order. On a
    # CPU, neighbouring slots are close in space. On a GPU, slots are in the order of faces.
    records: Buffer
    # Float colours per corner are (slots, 9) float32. Vertex colours that multiply textures are (slots, 12).
    # For other kinds of colours, this is one unused word.
    colors: Buffer
    # (6, stride) float32: centre and half extent of each cluster.
    boxes: Buffer
    # The kind of colours, which the kernels call COLORS.
    kind: int
    slots: int
    clusters: int
    stride: int
    texels: Texels | None
    # Call `fill` to compute records, colours and boxes again from the source arrays, which must exist.
    fill: Callable[[], None]
    # Queues a copy of the records into a buffer of the same shape. A second buffer, (F,) uint8, is 0 for
    # faces that become empty triangles.
    copy_some: Callable[[Buffer, Buffer], None]
    # If triangles may move, the positions and colours as the asset stores them; otherwise empty.
    sources: dict[str, Buffer]

    @property
    def buffers(self) -> dict[str, Buffer]:
        """All buffers, by the purpose of their memory."""
        buffers = self.records, self.colors, self.boxes, *self.textures
        return {buffer.use: buffer for buffer in buffers}

    @property
    def textures(self) -> tuple[Buffer, ...]:
        """The additional arguments of kernels that draw textures."""
        return self.texels.buffers if self.texels else ()

    @property
    def defines(self) -> dict[str, int]:
        """Definitions for the drawing kernels: the kind of colours, and constants of records and textures."""
        return {**RECORD_DEFINES, "COLORS": self.kind, **(self.texels.defines if self.texels else {})}


def make_triangles(
    device: Device, asset: Asset, settings: Mapping[str, Any], *, moving: bool = False
) -> Triangles:
    """Upload the triangles of `asset` to `device` in drawing order.

    If `moving` is true, the source arrays stay on the device. To move triangles, write to the source arrays
    and call `fill`. Triangles are sorted by their positions at the first call. Moved triangles are always
    drawn correctly. Drawing stays fast while the triangles are near their first positions.
    """
    positions, indices = asset.buffers["positions"], asset.buffers["indices"]
    listed = select_faces(asset, settings.get("ste_threshold"))
    count = len(indices) if listed is None else len(listed)
    slots = -(-count // BLOCK) * BLOCK
    texels, tint = None, None
    if (textured := textures_of(asset)) is None:
        kind, colors, domain = _classify_colors(drawn_colors(asset))
        wide = 9 if kind == FLOATS_OF_CORNERS else 0
    else:
        kind, colors, domain, tint = TEXTURES, textured.uvs.reshape(-1, 2), "corner", tint_of(asset)
        wide = 0 if tint is None else 12
        texels = put_texels(device, textured, slots, tinted=tint is not None)
    number = "uchar" if kind == BYTES_OF_CORNERS else "float"
    color_type = f"__global const {number} *"
    defines: dict[str, Any] = {**RECORD_DEFINES, "COLORS": kind, "COLOR_TYPE": color_type, "LANES": 1}
    defines |= {"CHANNELS": colors.shape[1], **(texels.defines if texels else {})}
    program = device.program("zbuffer_prepare", defines)

    none = np.zeros(1, np.uint32)
    arrays = [positions, indices, none if listed is None else listed, colors]
    if textured is not None:
        arrays.append(none.view(np.float32) if tint is None else corner_tint(tint, indices))
        arrays.append(none if textured.face_texture is None else textured.face_texture)
    source = [_put(device, array) if moving else device.upload(array, "standard source") for array in arrays]
    vertices, faces, chosen, color, *more = source
    head = vertices, faces, chosen, np.int32(listed is None)
    # On a CPU, sort the faces by the Morton codes of their positions, which makes clusters compact.
    order, ordered = chosen, device.style == "cpu" and count > 0
    if ordered:
        low, scale = _cells(asset)
        keys = device.scratch(f"{_PREPARATION} along the curve", count, np.uint32)
        program.place(count, _GROUP_SIZE, *head, keys, low, scale, np.uint32(count))
        order = sort_pairs(device, keys, bits=_MORTON_BITS, name=_PREPARATION)[1]
    # Allocate the results: records, colours per corner, and boxes of clusters.
    records = device.allocate((slots, WORDS), np.float32, "standard triangles", "geometry")
    corner_colors = device.allocate(
        (slots, wide) if wide else (1,), np.float32, "standard colors", "appearance"
    )
    clusters = -(-slots // CLUSTER)
    stride = -(-clusters // BLOCK) * BLOCK
    boxes = device.allocate((6, stride), np.float32, "standard boxes", "geometry")
    sizes = tuple(np.int32(value) for value in (CLUSTER, slots, clusters, stride))
    colors_and_targets = (np.int32(ordered), color, np.int32(domain == "corner"), records, corner_colors)
    ends = np.uint32(count), np.uint32(slots), *([] if texels is None else texels.preparation(*more))

    def fill() -> None:
        program.records(slots, _GROUP_SIZE, *head, order, *colors_and_targets, *ends)
        program.bound(clusters, _GROUP_SIZE, records, boxes, *sizes)

    def copy_some(selected: Buffer, copies: Buffer) -> None:
        program.copy_selected_records(slots, _GROUP_SIZE, records, selected, copies, np.uint32(slots))

    fill()
    device.finish()
    shape = kind, slots, clusters, stride, texels
    if moving:
        sources = {"positions": vertices, "colors": color}
        return Triangles(records, corner_colors, boxes, *shape, fill, copy_some, sources)
    for buffer in source:
        buffer.release()
    device.release_scratch(_PREPARATION)
    return Triangles(records, corner_colors, boxes, *shape, fill, copy_some, {})


def _put(device: Device, array: NDArray[Any]) -> Buffer:
    """Return a writable copy of an array on the device (`upload` may share memory with the array)."""
    buffer = device.allocate(array.shape, array.dtype, "standard source", "geometry")
    buffer.write(np.ascontiguousarray(array))
    return buffer


def _classify_colors(colors: StaticColors) -> tuple[int, NDArray[Any], str]:
    """Return the kind of colours, the array that the kernel reads, and its domain."""
    values = np.ascontiguousarray(colors.values)
    if colors.domain == "face":
        if values.dtype == np.uint8:
            values = values.astype(np.float32) / np.float32(255)
        return FLOATS_OF_FACE, values, "face"
    return (BYTES_OF_CORNERS if values.dtype == np.uint8 else FLOATS_OF_CORNERS), values, colors.domain


def _cells(asset: Asset) -> tuple[NDArray[np.float32], np.float32]:
    """Return the origin and the cells per unit of the grid that orders triangles.

    The grid spans the bounds of the vertices, but at most 1.5 times the range from the 2nd to the 98th
    percentile. Captured scenes have a few triangles far away. If the grid covered these triangles, all other
    triangles would share a single grid cell.
    """
    positions, bounds = asset.buffers["positions"], asset.manifest.bounds
    step = max(1, len(positions) // _SAMPLES)
    sample = np.sort(positions[::step].astype(np.float64), axis=0)  # np.quantile would import numpy.ma
    low, high = sample[len(sample) // 50], sample[-1 - len(sample) // 50]
    margin = (high - low) / 4
    low = np.maximum(low - margin, bounds.min)
    high = np.minimum(high + margin, bounds.max)
    size = max(float((high - low).max()), 1e-30)
    return np.append(low, 0).astype(np.float32), np.float32(1024 / size)

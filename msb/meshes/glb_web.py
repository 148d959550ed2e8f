"""Writes GLB files for the web: positions on a grid, and arrays compressed with EXT_meshopt_compression.

Positions are stored as integer grid coordinates. The scale of the node converts grid coordinates back to
positions. Grid coordinates are uint16 if they fit (KHR_mesh_quantization). If uint16 is too small, grid
coordinates are floats. The filter EXPONENTIAL of EXT_meshopt_compression stores float coordinates as mantissa
and exponent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import linear_to_srgb, srgb_to_linear
from msb.base.extras import need_extra
from msb.base.origin import to_world
from msb.base.soup import is_unindexed
from msb.meshes.colors import as_floats, with_alpha
from msb.meshes.formats import Style, Web
from msb.meshes.glb_write import INDICES, VERTICES, GlbBuilder, Primitive, add_mesh, finish, split, start_root
from msb.meshes.mesh import Mesh
from msb.meshes.writing import as_local

_MESHOPT, _QUANTIZATION = "EXT_meshopt_compression", "KHR_mesh_quantization"
# Finest precision of positions, in quarters of a bit. Mantissas of 24 bits cannot represent the coordinates
# of a finer grid. The second limit is for a grid step that varies by distance. The second limit is 3 bits
# lower, because some steps of such a grid are up to 8 times finer.
_FINEST, _FINEST_BY_DISTANCE = 88, 76
# Finest and coarsest grid step if the step varies by distance. The values are binary logarithms, relative to
# the step at the median distance: -3 is 8 times finer, and 5 is 32 times coarser.
_FINER, _COARSER = -3, 5
# When the distance doubles, the grid step increases by this number of bits. At twice the distance, the step
# is 2.8 times coarser.
_BITS_PER_DOUBLING = 1.5
# Precision of texture coordinates in bits. The smallest step is 1/16 texel.
_TEXEL_BITS = 4
# Number of bits of a mantissa without its sign. Far outside [0, 1], the mantissa limits the precision of
# texture coordinates.
_MANTISSA = 23


@dataclass(frozen=True)
class Grid:
    """Positions (V, 3) rounded to a grid.

    The position of vertex v is corner + step * whole[v]. The integers whole[v] are multiples of 2 **
    exponents[v]. The field `corner` is relative to `origin` (3,).
    """

    whole: NDArray[np.int64]
    exponents: NDArray[np.int64]
    corner: NDArray[np.float64]
    step: float
    origin: NDArray[np.float64]

    @classmethod
    def of(cls, mesh: Mesh, web: Web) -> Grid:
        """Return the positions of `mesh` rounded with the precision of `web`.

        The step of the position grid is a power of two, multiplied by 8, 7, 6 or 5 eighths. The grid step is
        at least the distance between neighbouring float32 numbers at the farthest vertex. With this step,
        different grid positions stay different after decoding.
        """
        local, origin = as_local(mesh.vertices, "GLB")
        positions = local.astype(np.float64)
        coarser = np.zeros(len(positions), np.int64)
        if web.by_distance and is_unindexed(mesh.faces, len(mesh.vertices)):
            coarser = _coarsen_by_distance(mesh, positions)
        # Choose the step from the extent of the longest side and the number of bits.
        bits, rest = divmod(min(web.quarters, _FINEST_BY_DISTANCE if coarser.any() else _FINEST), 4)
        low = positions.min(axis=0)
        extent = float((positions.max(axis=0) - low).max())
        step = 2.0 ** (math.ceil(math.log2(extent or 1.0)) - bits + int(coarser.min())) * (8 - rest) / 8
        step = max(step, float(np.spacing(np.abs(positions).max().astype(np.float32))))
        # Round the coordinates of vertex v to multiples of 2 ** exponents[v].
        corner = np.floor(low / step) * step
        exponents = coarser - coarser.min()
        multiple = 2 ** exponents[:, None]
        whole = np.rint((positions - corner) / step / multiple).astype(np.int64) * multiple
        return cls(whole, exponents, corner, step, np.array(origin))

    @property
    def positions(self) -> NDArray[Any]:
        """The decoded positions (V, 3): float32, or float64 with an origin."""
        return to_world((self.whole * self.step + self.corner).astype(np.float32), self.origin)

    @property
    def stored(self) -> NDArray[Any]:
        """The stored grid coordinates (V, 3): uint16, or float32 if uint16 is too small."""
        short = self.whole.max() < 1 << 16 and not self.exponents.any()
        return self.whole.astype(np.uint16 if short else np.float32)


def _coarsen_by_distance(mesh: Mesh, positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """For each vertex (V,) of a soup, return the coarsening of the grid step in bits.

    Negative values mean a finer step. The grid step grows with the distance of the face from the centre of
    the scene. Cameras are near the centre of a scene. Cameras view distant faces from far away, and distant
    faces are larger.
    """
    offset = positions[mesh.faces].mean(axis=1) - np.median(positions, axis=0)
    distance = np.linalg.norm(offset, axis=1)
    median = float(np.median(distance)) or 1.0
    bits = _BITS_PER_DOUBLING * np.log2(np.maximum(distance / median, 2.0**_FINER))
    coarser = np.zeros(len(positions), np.int64)
    coarser[mesh.faces] = np.rint(bits).clip(_FINER, _COARSER)[:, None]
    return coarser


def write_web(mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write `mesh` as a compressed GLB.

    The UVs of the mesh must be per vertex. Faces and vertices are reordered for compression.
    """
    need_extra("compressed", "meshopt", what="a GLB for the web")
    web = style.web
    assert web is not None
    builder = _CompressedBuilder(start_root(mesh, style))
    if web.by_distance and mesh.face_textures is not None:
        web = replace(web, by_distance=False)  # `Grid.exponents` describes whole meshes only.
    # Store positions as grid coordinates, with a node transform that converts the coordinates back.
    grid = Grid.of(mesh, web)
    builder.root["nodes"][0] |= {
        "translation": (grid.origin + grid.corner).tolist(),
        "scale": [grid.step] * 3,
    }
    attributes: dict[str, NDArray[Any]] = {"POSITION": grid.stored}
    if mesh.vertex_colors is not None:
        attributes["COLOR_0"] = with_alpha(quantize_light(mesh.vertex_colors, web.levels))
    if mesh.vertex_uvs is not None and mesh.textures:
        # Texture coordinates are rounded to multiples of 2 ** -bits. The mantissa of the largest coordinate
        # limits the bits.
        side = max(max(image.shape[:2]) for image in mesh.textures)
        most = max(float(np.abs(mesh.vertex_uvs).max(initial=0)), 1.0)
        # Rounding may increase the largest value to the next power of two.
        rounded = most * (1 + 0.5**_MANTISSA)
        bits = min(math.ceil(math.log2(side)) + _TEXEL_BITS, _MANTISSA - math.frexp(rounded)[1])
        builder.exponents["TEXCOORD_0"] = np.full(1, -bits)
        attributes["TEXCOORD_0"] = (np.rint(mesh.vertex_uvs * 2.0**bits) * 0.5**bits).astype(np.float32)
    # Reorder the rows of each primitive for compression.
    builder.exponents["POSITION"] = np.zeros(1, np.int64)
    parts = []
    for part in split(mesh, attributes):
        assert part.faces is not None
        if is_unindexed(mesh.faces, len(mesh.vertices)):
            order = _order_soup(part, grid.exponents)
            parts.append(_select_rows(part, order, None))
            if grid.exponents.any():
                builder.exponents["POSITION"] = grid.exponents[order]
        else:
            parts.append(_reorder_mesh(part))
    add_mesh(builder, parts, mesh, style)
    builder.require(_MESHOPT)
    if attributes["POSITION"].dtype == np.uint16:
        builder.require(_QUANTIZATION)
    # This buffer is for readers without decompression. EXT_meshopt_compression requires a fallback buffer. It
    # stays empty.
    builder.add("buffers", {"byteLength": builder.plain, "extensions": {_MESHOPT: {"fallback": True}}})
    finish(builder, stream)


def quantize_light(colors: NDArray[Any], levels: float | None) -> NDArray[Any]:
    """Return sRGB colours (V, 3 | 4) as linear light with an error of at most `levels` levels of 8-bit sRGB.

    The colours are uint8 if `levels` is None, else uint16. Every uint16 value is rounded to as few
    significant bits as the error allows. With fewer significant bits, the low bytes are often zero and
    compress well.
    """
    values = as_floats(colors)
    light = values.astype(np.float64)
    light[:, :3] = srgb_to_linear(values[:, :3])
    if levels is None:
        return np.asarray(np.rint(light * 255).astype(np.uint8))
    # Round the colours to multiples of 2, 4, ..., 256. For each colour, keep the coarsest value whose error
    # is small enough.
    exact = light * 65535
    stored = np.rint(exact)
    for bits in range(1, 9):
        coarse = np.minimum(np.rint(exact[:, :3] / (1 << bits)) * (1 << bits), 65536 - (1 << bits))
        error = np.abs(linear_to_srgb(coarse / 65535) - values[:, :3])
        stored[:, :3] = np.where(error <= levels / 255, coarse, stored[:, :3])
    return np.asarray(stored.astype(np.uint16))


def convert_to_srgb(light: NDArray[Any]) -> NDArray[np.float32]:
    """Return the sRGB values (V, 3 | 4) of stored linear colours, as float32 in [0, 1]."""
    values = light / np.float32(np.iinfo(light.dtype).max)
    values[:, :3] = linear_to_srgb(values[:, :3])
    return np.asarray(values, np.float32)


def _order_soup(part: Primitive, exponents: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return an order (V,) of the vertices that compresses well.

    Every three vertices in the returned order form a face.

    Faces are sorted by grid step, then along a space-filling curve. Each face begins with the corner that is
    nearest to the last corner of the previous face.
    """
    import meshopt

    assert part.faces is not None
    points = part.attributes["POSITION"].astype(np.float32)
    rank = meshopt.reorder_points(points[part.faces].mean(axis=1))
    order = np.lexsort((rank, exponents[part.faces[:, 0]]))
    faces = part.faces[order]
    # Choose the first corner of each face by L1 distance.
    first, last = [], (0.0, 0.0, 0.0)
    for corners in points[faces].tolist():
        distances = [sum(abs(x - y) for x, y in zip(corner, last, strict=True)) for corner in corners]
        first.append(distances.index(min(distances)))
        last = corners[first[-1] - 1]
    rotated = (np.array(first)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, rotated, axis=1).reshape(-1)


def _select_rows(part: Primitive, order: NDArray[np.int64], faces: NDArray[np.int64] | None) -> Primitive:
    """Return `part` with the vertices in the given `order` (V,).

    The indices `faces` (F, 3) refer to the new order.
    """
    rows = {name: np.ascontiguousarray(values[order]) for name, values in part.attributes.items()}
    return Primitive(rows, faces, part.texture)


def _reorder_mesh(part: Primitive) -> Primitive:
    """Return `part` with the faces in meshopt's order and the vertices in the order of their first use.

    Unused vertices come last in this order.
    """
    import meshopt

    assert part.faces is not None
    # Sort the faces along a space-filling curve. The library meshopt then optimises this order.
    points = part.attributes["POSITION"].astype(np.float32)
    rank = meshopt.reorder_points(points[part.faces].mean(axis=1))
    start = np.argsort(rank)
    flat = np.ascontiguousarray(part.faces[start].reshape(-1).astype(np.uint32))
    faces, place, used = meshopt.reorder_mesh(flat, True, True)
    # place (V,): the new index of each vertex. The library meshopt omits unused vertices at the end.
    count = len(points)
    place = np.concatenate((place, np.full(count - len(place), count)))
    is_used = place < used
    order = np.zeros(count, np.int64)
    order[place[is_used]] = np.flatnonzero(is_used)
    order[used:] = np.flatnonzero(~is_used)
    return _select_rows(part, order, faces.reshape(-1, 3).astype(np.int64))


@dataclass
class _CompressedBuilder(GlbBuilder):
    """A GLB file with compressed arrays.

    The field `plain` is the size of the uncompressed arrays in bytes.

    The values of a float attribute are multiples of powers of two. For each attribute name, `exponents`
    contains the exponents of these powers, (V,) or (1,).
    """

    plain: int = 0
    exponents: dict[str, NDArray[np.int64]] = field(default_factory=dict)

    def rows(self, name: str, rows: NDArray[Any]) -> int:
        """Append the compressed attribute `name` (V, K) of the vertices. Return the index of its buffer
        view."""
        import meshopt

        kind: dict[str, Any] = {"mode": "ATTRIBUTES"}
        if rows.dtype.kind == "f":
            kind["filter"] = "EXPONENTIAL"
            # The filter stores an exponent of 8 bits and a mantissa of 24 bits per value.
            exponents = self.exponents[name][:, None]
            whole = np.rint(rows * 2.0**-exponents).astype(np.int64)
            rows = ((exponents & 0xFF) << 24 | whole & 0xFFFFFF).astype("<u4")
        # The size of an element must be a multiple of four bytes.
        if odd := rows.strides[0] % 4:
            rows = np.pad(rows, ((0, 0), (0, odd // rows.itemsize)))
        content = meshopt.encode_gltf_buffer(np.ascontiguousarray(rows), "ATTRIBUTES", 0)
        return self._view(content, len(rows), rows.strides[0], kind, VERTICES)

    def indices(self, faces: NDArray[Any]) -> int:
        """Append compressed faces (F, 3). Return the index of their buffer view."""
        import meshopt

        content = meshopt.encode_gltf_buffer(faces.reshape(-1).astype(np.uint32), "TRIANGLES", 0)
        return self._view(content, faces.size, faces.itemsize, {"mode": "TRIANGLES"}, INDICES)

    def _view(self, content: bytes, count: int, stride: int, kind: dict[str, Any], target: int) -> int:
        """Append compressed data of `count` elements of `stride` bytes. Return the index of its buffer
        view."""
        packed = self.put(content) | {"byteStride": stride, "count": count} | kind
        plain: dict[str, Any] = {"buffer": 1, "byteOffset": self.plain, "byteLength": count * stride}
        if target == VERTICES:
            plain["byteStride"] = stride
        self.plain += -(-count * stride // 4) * 4
        return self.add("bufferViews", plain | {"target": target, "extensions": {_MESHOPT: packed}})

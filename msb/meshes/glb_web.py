"""Meshes written as GLB for the web: positions on a grid, and arrays compressed (EXT_meshopt_compression).

Positions are whole numbers of steps, which the node scales: of two bytes (KHR_mesh_quantization) where these
are enough, else floats by the extension's filter EXPONENTIAL, a mantissa and an exponent of any size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import linear_to_srgb, srgb_to_linear
from msb.base.extras import need_extra
from msb.base.soup import is_unindexed
from msb.meshes.colors import as_floats, with_alpha
from msb.meshes.formats import Style, Web
from msb.meshes.glb_write import INDICES, VERTICES, Part, Parts, add_mesh, finish, root_of, split
from msb.meshes.mesh import Mesh
from msb.meshes.writing import as_float32

_MESHOPT, _QUANTIZATION = "EXT_meshopt_compression", "KHR_mesh_quantization"
# Quarters of a bit beyond which neither a mantissa nor a float would hold whole numbers of steps.
_FINEST, _FINEST_BY_DISTANCE = 88, 76
# Bits between the step of a face at the usual distance and the finest and coarsest of others.
_FINER, _COARSER = -3, 5
# Bits that a step is coarser where the distance is twice as far.
_STEEP = 1.5
# Texture coordinates are kept to 2 ** -4 of a texel or better.
_TEXEL = 4
# Bits of a mantissa beside its sign: what is tiled very often has coarser texture coordinates.
_MANTISSA = 23


@dataclass(frozen=True)
class Grid:
    """Positions (V, 3) in whole numbers of steps from a corner; row v is a multiple of 2 ** exponents[v]."""

    whole: NDArray[np.int64]
    exponents: NDArray[np.int64]
    corner: NDArray[np.float64]
    step: float

    @classmethod
    def of(cls, mesh: Mesh, web: Web) -> Grid:
        """Return the positions of `mesh`, rounded.

        A step is a power of two, or seven, six or five eighths of one, and no finer than float32 is at the
        farthest vertex, so that no sum of the corner and so many steps is rounded onto another.
        """
        positions = as_float32(mesh.vertices, "GLB").astype(np.float64)
        coarser = np.zeros(len(positions), np.int64)
        if web.by_distance and is_unindexed(mesh.faces, len(mesh.vertices)):
            coarser = _by_distance(mesh, positions)
        bits, rest = divmod(min(web.quarters, _FINEST_BY_DISTANCE if coarser.any() else _FINEST), 4)
        low = positions.min(axis=0)
        extent = float((positions.max(axis=0) - low).max())
        step = 2.0 ** (math.ceil(math.log2(extent or 1.0)) - bits + int(coarser.min())) * (8 - rest) / 8
        step = max(step, float(np.spacing(np.abs(positions).max().astype(np.float32))))
        corner = np.floor(low / step) * step
        exponents = coarser - coarser.min()
        own = 2 ** exponents[:, None]
        return cls(np.rint((positions - corner) / step / own).astype(np.int64) * own, exponents, corner, step)

    @property
    def positions(self) -> NDArray[np.float32]:
        """What is read again."""
        return (self.whole * self.step + self.corner).astype(np.float32)

    @property
    def stored(self) -> NDArray[Any]:
        """Positions (V, 3) as a file has them: uint16, or float32 where these do not fit."""
        short = self.whole.max() < 1 << 16 and not self.exponents.any()
        return self.whole.astype(np.uint16 if short else np.float32)


def _by_distance(mesh: Mesh, positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return by how many bits the step of a vertex (V,) of a soup is coarser than the usual one.

    Cameras of a scene are about its middle, and what is far from it is larger and seen from afar.
    """
    off = positions[mesh.faces].mean(axis=1) - np.median(positions, axis=0)
    distance = np.linalg.norm(off, axis=1)
    usual = float(np.median(distance)) or 1.0
    bits = _STEEP * np.log2(np.maximum(distance / usual, 2.0**_FINER))
    made = np.zeros(len(positions), np.int64)
    made[mesh.faces] = np.rint(bits).clip(_FINER, _COARSER)[:, None]
    return made


def write_web(mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write `mesh`, whose texture coordinates are by vertex. Faces and vertices are put in another order."""
    need_extra("compressed", "meshopt", what="a GLB for the web")
    web = style.web
    assert web is not None
    parts = _Compressed(root_of(mesh, style))
    if web.by_distance and mesh.face_textures is not None:
        web = replace(web, by_distance=False)  # primitives would need exponents of their own
    grid = Grid.of(mesh, web)
    parts.root["nodes"][0] |= {"translation": grid.corner.tolist(), "scale": [grid.step] * 3}
    attributes: dict[str, NDArray[Any]] = {"POSITION": grid.stored}
    if mesh.vertex_colors is not None:
        attributes["COLOR_0"] = with_alpha(stored_light(mesh.vertex_colors, web.levels))
    if mesh.vertex_uvs is not None and mesh.textures:
        side = max(max(image.shape[:2]) for image in mesh.textures)
        most = max(float(np.abs(mesh.vertex_uvs).max(initial=0)), 1.0)
        rounded = most * (1 + 0.5**_MANTISSA)  # the float just below a power of two may become that
        bits = min(math.ceil(math.log2(side)) + _TEXEL, _MANTISSA - math.frexp(rounded)[1])
        parts.exponents["TEXCOORD_0"] = np.full(1, -bits)
        attributes["TEXCOORD_0"] = (np.rint(mesh.vertex_uvs * 2.0**bits) * 0.5**bits).astype(np.float32)
    parts.exponents["POSITION"] = np.zeros(1, np.int64)
    made = []
    for part in split(mesh, attributes):
        assert part.faces is not None
        if is_unindexed(mesh.faces, len(mesh.vertices)):
            order = _soup_order(part, grid.exponents)
            made.append(_taken(part, order, None))
            if grid.exponents.any():
                parts.exponents["POSITION"] = grid.exponents[order]
        else:
            made.append(_ordered(part))
    add_mesh(parts, made, mesh, style)
    parts.require(_MESHOPT)
    if attributes["POSITION"].dtype == np.uint16:
        parts.require(_QUANTIZATION)
    # Where the arrays would be for who cannot decode them: nowhere.
    parts.add("buffers", {"byteLength": parts.plain, "extensions": {_MESHOPT: {"fallback": True}}})
    finish(parts, stream)


def stored_light(colors: NDArray[Any], levels: float | None) -> NDArray[Any]:
    """Return sRGB colours (V, 3 | 4) as linear light: uint8, or uint16 where None is no limit of `levels`.

    A low byte that is zero, as that of its neighbours, takes no room; it has no more bits than it needs.
    """
    values = as_floats(colors)
    light = values.astype(np.float64)
    light[:, :3] = srgb_to_linear(values[:, :3])
    if levels is None:
        return np.asarray(np.rint(light * 255).astype(np.uint8))
    exact = light * 65535
    made = np.rint(exact)
    for bits in range(1, 9):
        coarse = np.minimum(np.rint(exact[:, :3] / (1 << bits)) * (1 << bits), 65536 - (1 << bits))
        off = np.abs(linear_to_srgb(coarse / 65535) - values[:, :3])
        made[:, :3] = np.where(off <= levels / 255, coarse, made[:, :3])
    return np.asarray(made.astype(np.uint16))


def srgb_of(light: NDArray[Any]) -> NDArray[np.float32]:
    """Return what is shown of colours that are stored so."""
    values = light / np.float32(np.iinfo(light.dtype).max)
    values[:, :3] = linear_to_srgb(values[:, :3])
    return np.asarray(values, np.float32)


def _soup_order(part: Part, exponents: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return vertices (V,) in an order in which they compress well and each three are a face.

    Faces of one step follow each other along a curve that fills space, and each begins with the corner that
    is nearest to where the last one ended.
    """
    import meshopt

    assert part.faces is not None
    points = part.attributes["POSITION"].astype(np.float32)
    rank = meshopt.reorder_points(points[part.faces].mean(axis=1))
    order = np.lexsort((rank, exponents[part.faces[:, 0]]))
    faces = part.faces[order]
    first, last = [], (0.0, 0.0, 0.0)
    for corners in points[faces].tolist():
        off = [sum(abs(x - y) for x, y in zip(corner, last, strict=True)) for corner in corners]
        first.append(off.index(min(off)))
        last = corners[first[-1] - 1]
    turned = (np.array(first)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, turned, axis=1).reshape(-1)


def _taken(part: Part, order: NDArray[np.int64], faces: NDArray[np.int64] | None) -> Part:
    """Return vertices `order` (V,) of `part`, with `faces` of these."""
    rows = {name: np.ascontiguousarray(values[order]) for name, values in part.attributes.items()}
    return Part(rows, faces, part.texture)


def _ordered(part: Part) -> Part:
    """Return `part` with faces in the order of meshopt.

    Vertices come as faces first use them; those that no face uses come last.
    """
    import meshopt

    assert part.faces is not None
    points = part.attributes["POSITION"].astype(np.float32)
    rank = meshopt.reorder_points(points[part.faces].mean(axis=1))
    start = np.argsort(rank)
    flat = np.ascontiguousarray(part.faces[start].reshape(-1).astype(np.uint32))
    faces, place, used = meshopt.reorder_mesh(flat, True, True)
    count = len(points)
    place = np.concatenate((place, np.full(count - len(place), count)))  # of the last, if no face uses them
    is_used = place < used
    order = np.zeros(count, np.int64)
    order[place[is_used]] = np.flatnonzero(is_used)
    order[used:] = np.flatnonzero(~is_used)
    return _taken(part, order, faces.reshape(-1, 3).astype(np.int64))


@dataclass
class _Compressed(Parts):
    """Parts whose arrays are compressed; `plain` is the size that they would have.

    `exponents` (V,) or (1,) holds for each attribute of floats the powers of two that these are multiples of.
    """

    plain: int = 0
    exponents: dict[str, NDArray[np.int64]] = field(default_factory=dict)

    def rows(self, name: str, rows: NDArray[Any]) -> int:
        """Append an attribute, floats by their mantissas."""
        import meshopt

        kind: dict[str, Any] = {"mode": "ATTRIBUTES"}
        if rows.dtype.kind == "f":
            kind["filter"] = "EXPONENTIAL"
            exponents = self.exponents[name][:, None]
            whole = np.rint(rows * 2.0**-exponents).astype(np.int64)
            rows = ((exponents & 0xFF) << 24 | whole & 0xFFFFFF).astype("<u4")
        if odd := rows.strides[0] % 4:
            rows = np.pad(rows, ((0, 0), (0, odd // rows.itemsize)))
        content = meshopt.encode_gltf_buffer(np.ascontiguousarray(rows), "ATTRIBUTES", 0)
        return self._view(content, len(rows), rows.strides[0], kind, VERTICES)

    def indices(self, faces: NDArray[Any]) -> int:
        """Append faces."""
        import meshopt

        content = meshopt.encode_gltf_buffer(faces.reshape(-1).astype(np.uint32), "TRIANGLES", 0)
        return self._view(content, faces.size, faces.itemsize, {"mode": "TRIANGLES"}, INDICES)

    def _view(self, content: bytes, count: int, stride: int, kind: dict[str, Any], target: int) -> int:
        packed = self.put(content) | {"byteStride": stride, "count": count} | kind
        plain: dict[str, Any] = {"buffer": 1, "byteOffset": self.plain, "byteLength": count * stride}
        if target == VERTICES:
            plain["byteStride"] = stride
        self.plain += -(-count * stride // 4) * 4
        return self.add("bufferViews", plain | {"target": target, "extensions": {_MESHOPT: packed}})

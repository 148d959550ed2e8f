"""Meshes written as GLB for the web: positions on a grid, and arrays compressed (EXT_meshopt_compression).

The extension's filter EXPONENTIAL keeps a float as a mantissa and an exponent: positions are floats, as
everywhere, of any number of bits, and no node scales them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import linear_to_srgb, srgb_to_linear
from msb.base.extras import need_extra
from msb.meshes.colors import with_alpha
from msb.meshes.glb_write import INDICES, VERTICES, Part, Parts, add_mesh, finish, root_of, split
from msb.meshes.writing import as_float32

if TYPE_CHECKING:
    from msb.meshes.formats import Style
    from msb.meshes.mesh import Mesh

_MESHOPT = "EXT_meshopt_compression"
_MANTISSA = 24
"""Bits of a mantissa, its sign included."""
_TEXEL = 4
"""Texture coordinates are kept to 2 ** -4 of a texel or better."""


def write_web(mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write `mesh`, whose texture coordinates are by vertex. Faces and vertices are put in another order."""
    need_extra("compressed", "meshopt", what="a GLB for the web")
    assert style.web is not None
    parts = _Compressed(root_of(mesh, style))
    positions, moved, parts.steps["POSITION"] = on_grid(as_float32(mesh.vertices, "GLB"), style.web.bits)
    parts.root["nodes"][0]["translation"] = moved
    attributes: dict[str, NDArray[Any]] = {"POSITION": positions}
    if mesh.vertex_colors is not None:
        attributes["COLOR_0"] = with_alpha(_colors(mesh.vertex_colors, fine=style.web.fine_colors))
    if mesh.vertex_uvs is not None and mesh.textures:
        side = max(max(image.shape[:2]) for image in mesh.textures)
        parts.steps["TEXCOORD_0"] = step = 0.5 ** (math.ceil(math.log2(side)) + _TEXEL)
        attributes["TEXCOORD_0"] = (np.rint(mesh.vertex_uvs / step) * step).astype(np.float32)
    add_mesh(parts, [_arranged(part) for part in split(mesh, attributes)], mesh, style)
    parts.require(_MESHOPT)
    # Where the arrays would be for who cannot decode them: nowhere.
    parts.add("buffers", {"byteLength": parts.plain, "extensions": {_MESHOPT: {"fallback": True}}})
    finish(parts, stream)


def on_grid(positions: NDArray[np.float32], bits: int) -> tuple[NDArray[np.float32], list[float], float]:
    """Return `positions` (V, 3) in whole steps from a corner of their box, that corner, and the step.

    A step is a power of two, so that no sum of the two is rounded.
    """
    low = positions.min(axis=0).astype(np.float64)
    extent = float((positions.max(axis=0) - low).max())
    step = 2.0 ** (math.ceil(math.log2(extent or 1.0)) - min(bits, _MANTISSA - 2))
    corner = np.floor(low / step) * step
    return (np.rint((positions - corner) / step) * step).astype(np.float32), corner.tolist(), step


def _colors(colors: NDArray[Any], *, fine: bool) -> NDArray[Any]:
    """Return sRGB colours as linear light: uint8 or, `fine`, uint16 with as few bits as a level allows."""
    values = colors / np.float32(255 if colors.dtype == np.uint8 else 1)
    light = values.copy()
    light[:, :3] = srgb_to_linear(values[:, :3])
    if not fine:
        return np.asarray(np.rint(light * 255).astype(np.uint8))
    exact = np.rint(light * 65535).astype(np.int64)
    made = exact.copy()
    for bits in range(1, 9):  # what has the same low byte as its neighbours takes no room
        coarse = (exact >> bits << bits) + (1 << bits - 1)
        off = linear_to_srgb(coarse[:, :3] / 65535) - values[:, :3]
        made[:, :3] = np.where(np.abs(off) <= 1 / 255, coarse[:, :3], made[:, :3])
    return made.astype(np.uint16)


def _arranged(part: Part) -> Part:
    """Return `part` in an order in which it compresses well; vertices that no face uses come last."""
    import meshopt

    count = len(part.attributes["POSITION"])
    flat = np.ascontiguousarray(part.faces.reshape(-1).astype(np.uint32))
    faces, place, used = meshopt.reorder_mesh(flat, True, True)
    is_used = place < used
    order = np.zeros(count, np.int64)
    order[place[is_used]] = np.flatnonzero(is_used)
    order[used:] = np.setdiff1d(np.arange(count), order[:used])
    rows = {name: np.ascontiguousarray(values[order]) for name, values in part.attributes.items()}
    return Part(rows, faces.reshape(-1, 3).astype(np.int64), part.texture)


@dataclass
class _Compressed(Parts):
    """Parts whose arrays are compressed; `plain` is the size that they would have.

    `steps` holds for each attribute of floats what these are whole multiples of.
    """

    plain: int = 0
    steps: dict[str, float] = field(default_factory=dict)

    def rows(self, name: str, rows: NDArray[Any]) -> int:
        """Append an attribute, floats by their mantissas."""
        import meshopt

        kind: dict[str, Any] = {"mode": "ATTRIBUTES"}
        data = rows
        if rows.dtype.kind == "f":
            kind["filter"] = "EXPONENTIAL"
            bits = 1 + int(np.abs(rows).max(initial=0) / self.steps[name]).bit_length()
            data = meshopt.encode_filter_exp(np.ascontiguousarray(rows), bits, "SharedComponent")
        content = meshopt.encode_gltf_buffer(np.ascontiguousarray(data), "ATTRIBUTES", 0)
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

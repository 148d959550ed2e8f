"""The triangles of a glTF document, as arrays that a simplification can weigh against each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.delivery.surface_distance import Floats, Ints
from msb.errors import MeshError
from msb.meshes.gltf import Accessor, Document, list_placed_meshes, parse_accessor, place_nodes
from msb.meshes.gltf_packed import unpack
from msb.meshes.gltf_parts import TRIANGLES, parse_primitives, read_arrays, read_numbers
from msb.meshes.gltf_poses import Poses

# The glTF accessor types and component types of vertex attributes.
_KINDS, _COMPONENTS = "SCALAR VEC2 VEC3 VEC4", "i1 u1 i2 u2 u4 f4"
# Odd factors of a 64-bit hash of the columns of a table (the constant of splitmix64, and its mixing steps).
_GOLDEN, _MIX = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9)


@dataclass(frozen=True, eq=False)
class Part:
    """One primitive with triangles.

    Attributes
    ----------
    mesh, primitive : int
        Its place in the document.
    entry : dict
        Its JSON.
    faces : (F, 3) int64
        Rows of its accessors. Vertices that are equal in all attributes are one row.
    attributes, targets : dict and list of dict
        The accessors of its vertices and of its morph targets, by name.
    positions : (V, 3) float64
        Positions in the pose and the place of its first node, in the unit of the document.
    """

    mesh: int
    primitive: int
    entry: dict[str, Any]
    faces: Ints
    attributes: dict[str, Accessor]
    targets: list[dict[str, Accessor]]
    positions: Floats

    def read(self, name: str) -> NDArray[Any] | None:
        """Return an attribute (V, K) as floats, or None if it is missing."""
        stored = self.attributes.get(name)
        return None if stored is None else read_numbers(stored)


@dataclass(frozen=True, eq=False)
class Scene:
    """A glTF document, and its parts in the order of the meshes."""

    document: Document
    parts: tuple[Part, ...]

    @property
    def face_count(self) -> int:
        """The number of triangles of all meshes; a mesh counts once, however many nodes show it."""
        return sum(len(part.faces) for part in self.parts)

    def join(self) -> tuple[NDArray[np.float32], Ints, list[Ints]]:
        """Return the used vertices (V, 3) and faces (F, 3) of all parts, centred and scaled to a size of 1.

        The third value has for each part the rows of its vertices. Unused vertices are left out, because
        parts often share one array.
        """
        rows, faces, start = [], [], 0
        for part in self.parts:
            used, number = np.unique(part.faces, return_inverse=True)
            rows.append(used)
            faces.append(number.reshape(-1, 3) + start)
            start += len(used)
        points = np.concatenate([part.positions[used] for part, used in zip(self.parts, rows, strict=True)])
        low, high = points.min(axis=0), points.max(axis=0)
        unit = (points - (low + high) / 2) / (float((high - low).max()) or 1.0)
        return unit.astype(np.float32), np.concatenate(faces), rows


def read_parts(document: Document) -> Scene:
    """Return the scene of a document. Compressed arrays are decoded.

    Faces with an invalid index, with two equal corners or with a coordinate that is not finite are left out.

    Raises
    ------
    MeshFileError
        The document is invalid.
    MeshError
        MESH_ARRAY: no face is left.
    """
    nodes = place_nodes(document)
    placed = [entry for entry, _ in list_placed_meshes(document, nodes)]
    unpack(document, list(dict.fromkeys(entry.mesh for entry in placed)), every_view=True)
    poses = Poses(document, nodes.worlds)
    parts: list[Part] = []
    seen: set[int] = set()
    for entry in placed:
        if entry.mesh in seen:
            continue
        seen.add(entry.mesh)
        for primitive in parse_primitives(document, entry.mesh):
            arrays = read_arrays(primitive)
            attributes, targets = _read_accessors(document, primitive.entry, primitive.pointer)
            points = poses.apply(arrays, primitive, entry).vertices.astype(np.float64)
            faces = _merge_equal(arrays.faces, [*attributes.values(), *_values(targets)], len(points))
            faces = _drop_invalid(faces, points)
            if len(faces):
                number = int(primitive.pointer.rpartition("/")[2])
                parts.append(Part(entry.mesh, number, primitive.entry, faces, attributes, targets, points))
    if not parts:
        text = "the file has no valid triangle, so there is nothing to reduce"
        raise MeshError("MESH_ARRAY", text, file=document.source.path)
    return Scene(document, tuple(parts))


def _read_accessors(
    document: Document, entry: dict[str, Any], pointer: str
) -> tuple[dict[str, Accessor], list[dict[str, Accessor]]]:
    """Return the accessors of the attributes and of the morph targets of a primitive."""
    unpacked = document.packed.get(pointer, {})

    def parse(owner: dict[str, Any], packed: dict[str, NDArray[Any]]) -> dict[str, Accessor]:
        return {
            name: parse_accessor(
                document, number, kinds=_KINDS, components=_COMPONENTS, unpacked=packed.get(name)
            )
            for name, number in owner.items()
        }

    targets = [parse(target, {}) for target in document.array(entry, "targets", pointer)]
    return parse(document.object(entry, "attributes", pointer), unpacked), targets


def _values(targets: list[dict[str, Accessor]]) -> Iterator[Accessor]:
    for target in targets:
        yield from target.values()


def _merge_equal(faces: Ints, attributes: list[Accessor], count: int) -> Ints:
    """Return the faces with equal vertices merged: all corners use the first of `count` equal rows."""
    first, number = number_equal_rows([stored.read() for stored in attributes])
    valid = (faces >= 0) & (faces < count)
    merged: Ints = np.where(valid, first[number[np.where(valid, faces, 0)]], faces)
    return merged


def number_equal_rows(columns: Sequence[NDArray[Any]]) -> tuple[Ints, Ints]:
    """Return the first of all equal rows (n,), and for each row (V,) the number of its equal ones.

    Rows are the same rows of all arrays (V, K). Rows count as equal if their 64-bit hashes are.
    """
    key = np.zeros(len(columns[0]), np.uint64)
    with np.errstate(over="ignore"):
        for values in columns:
            for column in np.ascontiguousarray(values).T:
                bits = np.ascontiguousarray(column).view(f"u{column.itemsize}").astype(np.uint64)
                key = (key ^ bits) * _GOLDEN
                key = (key ^ (key >> np.uint64(29))) * _MIX
                key ^= key >> np.uint64(32)
    _, first, number = np.unique(key, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def _drop_invalid(faces: Ints, points: Floats) -> Ints:
    """Return the faces with three different valid corners and finite positions."""
    faces = faces[((faces >= 0) & (faces < len(points))).all(axis=1)]
    is_finite = np.isfinite(points[faces]).all(axis=(1, 2))
    kept: Ints = faces[is_finite & (faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return kept


__all__ = ["TRIANGLES", "Floats", "Ints", "Part", "Scene", "read_parts"]

"""Applies the stored pose of a glTF scene: morph targets with their weights, and skins with their joints."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.errors import MeshFileError, shorten
from msb.meshes.gltf import Document, PlacedMesh, parse_accessor, parse_node_numbers
from msb.meshes.gltf_parts import Primitive, PrimitiveArrays, read_numbers, transform_arrays

# Number of bytes per vertex while a pose is applied: for each morph target, and for a skin.
_TARGET_BYTES, _SKIN_BYTES = 24, 256
_COMPONENTS = "i1 u1 i2 u2 f4"
Floats = NDArray[np.float64]


@dataclass
class Poses:
    """The poses of the meshes in a scene.

    Attributes
    ----------
    worlds : dict
        The world transforms (4, 4) of the nodes. The key is the node index.
    left_out : dict
        The names of pose data that the reader ignores.
    is_skinned : bool
        Whether a skin has been applied.
    """

    document: Document
    worlds: dict[int, Floats]
    left_out: dict[str, None] = field(default_factory=dict)
    is_skinned: bool = False
    _joints: dict[Any, Floats | None] = field(default_factory=dict)

    def count_bytes(self, primitive: Primitive, placed: PlacedMesh) -> int:
        """Return the memory in bytes that the pose of a primitive needs."""
        targets = _TARGET_BYTES * len(self._list_weights(primitive, placed))
        return primitive.positions.count * (targets + _SKIN_BYTES * _has_skin(primitive, placed))

    def apply(self, part: PrimitiveArrays, primitive: Primitive, placed: PlacedMesh) -> PrimitiveArrays:
        """Return `part`, the arrays of `primitive`, in world coordinates.

        The transform of a node does not affect a mesh with a skin. If the skin cannot be read, the mesh is
        returned without its pose.
        """
        try:
            part = self._morph(part, primitive, placed)
        except MeshFileError as error:
            self.left_out[f"the weights of morph targets ({shorten(error.message, 200)})"] = None
        if not _has_skin(primitive, placed):
            return transform_arrays(part, placed.world)
        joints = self._find_joints(placed.node["skin"])
        try:
            return part if joints is None else self._skin(part, primitive, joints)
        except MeshFileError as error:
            self.left_out[f"the pose of a skin ({shorten(error.message, 200)})"] = None
            return part

    def _list_weights(self, primitive: Primitive, placed: PlacedMesh) -> dict[int, float]:
        """Return the non-zero weights of a primitive's morph targets. The key is the index of the target."""
        owner, _ = self.document.entry("meshes", placed.mesh)
        weights = placed.node.get("weights", owner.get("weights"))
        targets = primitive.entry.get("targets")
        if not (isinstance(weights, list) and isinstance(targets, list)):
            return {}
        numbers = [float(value) if type(value) in (int, float) else 0.0 for value in weights[: len(targets)]]
        return {number: value for number, value in enumerate(numbers) if value and np.isfinite(value)}

    def _morph(self, part: PrimitiveArrays, primitive: Primitive, placed: PlacedMesh) -> PrimitiveArrays:
        """Return `part` with the displacements of its morph targets added.

        Each displacement is multiplied with the weight of its morph target.
        """
        vertices = part.vertices
        for number, weight in self._list_weights(primitive, placed).items():
            target = primitive.entry["targets"][number]
            where = f"{primitive.pointer}/targets/{number}"
            if isinstance(target, dict) and "POSITION" in target:
                moved = self._read_attribute(target, "POSITION", where, primitive, ("VEC3", _COMPONENTS))
                vertices = vertices + weight * moved
        return part if vertices is part.vertices else replace(part, vertices=vertices.astype(np.float64))

    def _skin(self, part: PrimitiveArrays, primitive: Primitive, joints: Floats) -> PrimitiveArrays:
        """Return `part` after moving each vertex by the weighted average of its matrices in `joints` (J, 3,
        4)."""
        numbers, weights = self._read_weights(primitive, len(joints))
        # blended (V, 3, 4): the matrix of each vertex.
        blended = np.zeros((len(part.vertices), 3, 4))
        for number, weight in zip(numbers.T, weights.T, strict=True):
            blended += joints[number] * weight[:, None, None]
        self.is_skinned = True
        if np.array_equal(blended, np.broadcast_to(np.eye(3, 4), blended.shape)):
            return part
        x, y, z = part.vertices.astype(np.float64).T[:, :, None]
        with np.errstate(over="ignore", invalid="ignore"):
            vertices = blended[..., 0] * x + blended[..., 1] * y + blended[..., 2] * z + blended[..., 3]
            # Mirroring matrices turn the front sides of faces inwards.
            is_mirrored = np.median(np.linalg.det(blended[..., :3])) < 0 if len(blended) else False
        return replace(part, vertices=vertices, faces=part.faces[:, [0, 2, 1]] if is_mirrored else part.faces)

    def _read_weights(self, primitive: Primitive, joints: int) -> tuple[NDArray[np.int64], Floats]:
        """Return the joints (V, K) of each vertex, and their weights (V, K).

        The weights of a vertex add up to 1.
        """
        attributes, where = primitive.entry["attributes"], f"{primitive.pointer}/attributes"
        numbers, weights, number = [], [], 0
        while {f"JOINTS_{number}", f"WEIGHTS_{number}"} <= attributes.keys():
            of_set = []
            for name, components in ((f"JOINTS_{number}", "u1 u2"), (f"WEIGHTS_{number}", "u1 u2 f4")):
                kind = "VEC4", components
                of_set.append(self._read_attribute(attributes, name, where, primitive, kind))
            numbers.append(of_set[0].astype(np.int64))
            weights.append(np.nan_to_num(of_set[1].astype(np.float64)))
            number += 1
        indices, shares = np.concatenate(numbers, axis=1), np.concatenate(weights, axis=1)
        indices = np.where(shares == 0, 0, indices)
        if indices.size and indices.max() >= joints:
            text = f"a vertex uses joint {indices.max()}, but the skin has {joints}"
            raise self.document.error("MESH_FILE_INVALID", where, text)
        total = shares.sum(axis=1, keepdims=True)
        shares[total[:, 0] == 0, 0] = 1
        return indices, shares / np.where(total == 0, 1, total)

    def _read_attribute(
        self, attributes: dict[str, Any], name: str, where: str, primitive: Primitive, kind: tuple[str, str]
    ) -> NDArray[Any]:
        """Return the values (V, K) of an attribute.

        The argument `kind` has the allowed element types and number types.
        """
        unpacked = self.document.packed.get(primitive.pointer, {}).get(name)
        number = self.document.integer(attributes, name, where)
        stored = parse_accessor(self.document, number, kinds=kind[0], components=kind[1], unpacked=unpacked)
        if stored.count != primitive.positions.count:
            text = f"there are {stored.count} elements for {primitive.positions.count} vertices"
            raise self.document.error("MESH_FILE_INVALID", f"{where}/{name}", text)
        return read_numbers(stored)

    def _find_joints(self, skin: Any) -> Floats | None:
        """Return the matrices of a skin, or None if the skin cannot be read. Each skin is read only once."""
        if str(skin) not in self._joints:
            try:
                self._joints[str(skin)] = self._read_joints(skin)
            except MeshFileError as error:
                self.left_out[f"the pose of a skin ({shorten(error.message, 200)})"] = None
                self._joints[str(skin)] = None
        return self._joints[str(skin)]

    def _read_joints(self, skin: Any) -> Floats:
        """Return the matrices (J, 3, 4) of a skin.

        The matrices of a skin map the bind pose to the pose of the joints.
        """
        document = self.document
        entry, where = document.entry("skins", document.integer({"skin": skin}, "skin", ""))
        joints = parse_node_numbers(document, entry, "joints", where)
        outside = [joint for joint in joints if joint not in self.worlds]
        if outside or not joints:
            text = f"joint {outside[0]} is not in the scene" if outside else "the skin has no joints"
            raise document.error("MESH_FILE_INVALID", f"{where}/joints", text)
        placed = np.stack([self.worlds[joint] for joint in joints])
        if "inverseBindMatrices" in entry:
            number = document.integer(entry, "inverseBindMatrices", where)
            stored = parse_accessor(document, number, kinds="MAT4", components="f4")
            document.check_total("the matrices of a skin", stored.count * 64)
            if stored.count < len(joints):
                text = f"there are {stored.count} inverse bind matrices for {len(joints)} joints"
                raise document.error("MESH_FILE_INVALID", f"{where}/inverseBindMatrices", text)
            # Transpose, because glTF stores matrices column by column.
            inverse = stored.read()[: len(joints)].reshape(-1, 4, 4).swapaxes(1, 2).astype(np.float64)
            with np.errstate(over="ignore", invalid="ignore"):
                placed = placed @ inverse
        return placed[:, :3]


def _has_skin(primitive: Primitive, placed: PlacedMesh) -> bool:
    """Return whether a primitive is moved by the joints of a skin, not by its node."""
    attributes = primitive.entry.get("attributes", {})
    return "skin" in placed.node and {"JOINTS_0", "WEIGHTS_0"} <= attributes.keys()

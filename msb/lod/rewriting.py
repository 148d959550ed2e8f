"""Write a glTF document again with other faces, and everything else as it was.

Arrays that nothing uses any more are left out. Images become a part of the file.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.delivery.surface_distance import Floats, Ints
from msb.errors import MeshFileError
from msb.lod.scene import TRIANGLES, Part, Scene
from msb.lod.textures import find_kind, shrink
from msb.meshes.glb_write import INDICES, VERTICES, GlbBuilder, finish
from msb.meshes.gltf import COMPONENTS, Accessor
from msb.meshes.gltf_materials import read_image_bytes
from msb.meshes.gltf_packed import DRACO, MESHOPT
from msb.meshes.gltf_parts import read_numbers

_INSTANCES, _QUANTIZED, _LOD = "EXT_mesh_gpu_instancing", "KHR_mesh_quantization", "MSFT_lod"
_NUMBERS = {kind[1:]: number for number, kind in COMPONENTS.items()}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
# Attributes that are floats in files without quantisation.
_FLOATS = ("POSITION", "NORMAL", "TANGENT", "TEXCOORD_")
# From this number of vertices on, indices are uint32.
_MAX_SHORT = 1 << 16


@dataclass(frozen=True)
class Placing:
    """A scale and then a translation of the whole scene."""

    scale: float = 1.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def apply(self, points: Floats) -> Floats:
        """Return points (n, 3) of the document as they are in the file."""
        placed: Floats = points * self.scale + np.array(self.offset)
        return placed

    def to_node(self, name: str, children: list[int]) -> dict[str, Any]:
        """Return the JSON of a node with this transform."""
        node: dict[str, Any] = {"name": name, "children": children}
        if self.scale != 1:
            node["scale"] = [self.scale] * 3
        return node | ({"translation": list(self.offset)} if any(self.offset) else {})


@dataclass
class Rewriter:
    """A file under construction from a scene. With `plain`, quantised attributes become floats."""

    scene: Scene
    plain: bool = False
    # Width and height of the largest texture, after `shrink_images`; None without a texture.
    texture: tuple[int, int] | None = None
    builder: GlbBuilder = field(init=False)
    _old: dict[str, Any] = field(init=False)
    _moved: dict[tuple[str, int], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        root = copy.deepcopy(self.scene.document.root)
        self._old = {key: root.pop(key, []) for key in ("accessors", "bufferViews", "buffers")}
        root["asset"] = {**root.get("asset", {}), "generator": "MeshSplatBench"}
        self.builder = GlbBuilder(root)
        self._replaced: set[tuple[int, int]] = set()

    @property
    def root(self) -> dict[str, Any]:
        """The JSON."""
        return self.builder.root

    def shrink_images(self, factor: float) -> None:
        """Put all images into the file, with sides times `factor`."""
        maps = self._list_normal_maps()
        for number, image in enumerate(self.root.get("images", [])):
            try:
                data = read_image_bytes(self.scene.document, number)
            except MeshFileError:  # a linked file that is missing stays a link
                continue
            content, size = shrink(data, factor, is_normal=number in maps)
            if self.texture is None or size[0] * size[1] > self.texture[0] * self.texture[1]:
                self.texture = size if all(size) else self.texture
            kind = find_kind(content)
            image.pop("uri", None)
            image["bufferView"] = self.builder.add("bufferViews", self.builder.put(content))
            image["mimeType"] = f"image/{kind}" if kind else image.get("mimeType", "image/ktx2")

    def _list_normal_maps(self) -> set[int]:
        """Return the numbers of the images that are normal maps."""
        textures = self.root.get("textures", [])
        used = [material.get("normalTexture", {}).get("index") for material in self.root.get("materials", [])]
        owners = [textures[n] for n in used if isinstance(n, int) and n < len(textures)]
        sources = [[o, *(e for e in o.get("extensions", {}).values() if isinstance(e, dict))] for o in owners]
        return {entry["source"] for entries in sources for entry in entries if "source" in entry}

    def set_faces(self, faces: Sequence[Ints]) -> None:
        """Give the parts of the scene other faces."""
        for part, rows in zip(self.scene.parts, faces, strict=True):
            self.root["meshes"][part.mesh]["primitives"][part.primitive] = self._make_primitive(part, rows)
            self._replaced.add((part.mesh, part.primitive))

    def add_level(self, faces: Sequence[Ints], ending: str) -> dict[int, int]:
        """Add meshes with other faces beside those of the scene; return old number -> new number.

        The names of these meshes get the ending. Primitives without triangles are left out.
        """
        added: dict[int, int] = {}
        for part, rows in zip(self.scene.parts, faces, strict=True):
            if part.mesh not in added:
                old = copy.deepcopy(self.root["meshes"][part.mesh])
                old |= {"primitives": [], "name": f"{old.get('name', '')}{ending}"}
                added[part.mesh] = self.builder.add("meshes", old)
            primitives = self.root["meshes"][added[part.mesh]]["primitives"]
            self._replaced.add((added[part.mesh], len(primitives)))
            primitives.append(self._make_primitive(part, rows))
        return added

    def _make_primitive(self, part: Part, faces: Ints) -> dict[str, Any]:
        """Add the arrays of a primitive with these faces (F, 3); return its JSON."""
        rows, number = np.unique(faces, return_inverse=True)
        entry = copy.deepcopy(part.entry)
        entry["mode"] = TRIANGLES
        entry["attributes"] = {
            name: self._add_rows(name, stored, rows) for name, stored in part.attributes.items()
        }
        if part.targets:
            entry["targets"] = [
                {name: self._add_rows(name, stored, rows, is_target=True) for name, stored in target.items()}
                for target in part.targets
            ]
        entry["indices"] = self._add_faces(number.reshape(-1), len(rows))
        extensions = entry.get("extensions", {})
        extensions.pop(DRACO, None)
        if not extensions:
            entry.pop("extensions", None)
        return entry

    def _add_rows(self, name: str, stored: Accessor, rows: Ints, *, is_target: bool = False) -> int:
        """Add the selected rows of an attribute; return the number of its accessor."""
        values, normalized = stored.read()[rows], stored.normalized
        if self.plain and name.startswith(_FLOATS) and values.dtype.kind != "f":
            values, normalized = read_numbers(stored)[rows].astype(np.float32), False
            if name in ("NORMAL", "TANGENT") and not is_target:
                values[:, :3] /= np.maximum(np.linalg.norm(values[:, :3], axis=1, keepdims=True), 1e-12)
        return self._add_array(values, normalized, has_bounds=name == "POSITION")

    def _add_array(
        self, values: NDArray[Any], normalized: bool = False, *, has_bounds: bool, is_index: bool = False
    ) -> int:
        """Add an array (n, K); return the number of its accessor. Rows of vertices are aligned to 4 bytes."""
        size = values.dtype.itemsize * values.shape[1]
        padded = values
        if gap := 0 if is_index else -size % 4:
            padded = np.zeros((len(values), values.shape[1] + gap // values.dtype.itemsize), values.dtype)
            padded[:, : values.shape[1]] = values
        view: dict[str, Any] = {**self.builder.put(padded), "target": INDICES if is_index else VERTICES}
        view |= {"byteStride": size + gap} if gap else {}
        entry: dict[str, Any] = {"bufferView": self.builder.add("bufferViews", view), "count": len(values)}
        entry |= {"componentType": _NUMBERS[values.dtype.str[1:]], "type": _KINDS[values.shape[1]]}
        entry |= {"normalized": True} if normalized else {}
        if has_bounds:
            entry |= {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        return self.builder.add("accessors", entry)

    def _add_faces(self, corners: Ints, count: int) -> int:
        kind = "<u2" if count < _MAX_SHORT else "<u4"
        return self._add_array(corners.astype(kind)[:, None], has_bounds=False, is_index=True)

    def add_shapes(self, shapes: Sequence[tuple[str, Floats, Ints]], scene: dict[str, Any]) -> None:
        """Add nodes with meshes without material: name, points (V, 3), faces (F, 3), to `scene`."""
        for name, points, faces in shapes:
            attributes = {"POSITION": self._add_array(points.astype("<f4"), has_bounds=True)}
            indices = self._add_faces(faces.reshape(-1), len(points))
            primitive = {"attributes": attributes, "indices": indices, "mode": TRIANGLES}
            mesh = self.builder.add("meshes", {"name": name, "primitives": [primitive]})
            self._replaced.add((mesh, 0))
            scene.setdefault("nodes", []).append(self.builder.add("nodes", {"name": name, "mesh": mesh}))

    def group_levels(self, name: str, levels: Sequence[dict[int, int]], shares: list[float] | None) -> None:
        """Add a node NAME_LODk for each level k. The node has copies of the scene's nodes with its meshes.

        The argument `shares` has the share of faces of each level. With `shares`, the scene shows the whole
        asset only, and the extension MSFT_lod lists the other levels. Without `shares`, the scene shows all
        levels.
        """
        scene = self.default_scene()
        roots = list(scene.get("nodes", []))
        groups = [self.builder.add("nodes", {"name": f"{name}_LOD0", "children": roots})]
        for number, meshes in enumerate(levels, 1):
            copies = [self._copy_node(node, meshes, f"_LOD{number}") for node in roots]
            children = [node for node in copies if node is not None]
            groups.append(self.builder.add("nodes", {"name": f"{name}_LOD{number}", "children": children}))
        scene["nodes"] = groups
        if shares is not None:
            whole = self.root["nodes"][groups[0]]
            whole["extensions"] = {_LOD: {"ids": groups[1:]}}
            whole["extras"] = {"MSFT_screencoverage": [*shares, 0.0]}
            self.root.setdefault("extensionsUsed", []).append(_LOD)
            scene["nodes"] = groups[:1]

    def _copy_node(self, number: int, meshes: dict[int, int], ending: str) -> int | None:
        """Add a copy of a node and of its descendants that have meshes; None without any."""
        node = copy.deepcopy(self.root["nodes"][number])
        children = [self._copy_node(child, meshes, ending) for child in node.pop("children", [])]
        kept = [child for child in children if child is not None]
        mesh = meshes.get(node.pop("mesh", -1))
        if mesh is None and not kept:
            return None
        node.pop("camera", None)
        node.pop("extensions", None)
        node |= {"children": kept} if kept else {}
        node |= {"mesh": mesh} if mesh is not None else {}
        if "name" in node:
            node["name"] += ending
        return self.builder.add("nodes", node)

    def default_scene(self) -> dict[str, Any]:
        """Return the JSON of the scene that programs show; it is made if the file has none."""
        if not self.root.get("scenes"):
            children = {child for node in self.root["nodes"] for child in node.get("children", [])}
            roots = [number for number in range(len(self.root["nodes"])) if number not in children]
            self.root["scenes"], self.root["scene"] = [{"nodes": roots}], 0
        scene: dict[str, Any] = self.root["scenes"][self.root.get("scene", 0)]
        return scene

    def place_scene(self, name: str, placing: Placing) -> None:
        """Transform the scene by a new root node. A mesh with a skin follows its joints instead."""
        if placing == Placing():
            return
        scene, nodes = self.default_scene(), self.root["nodes"]
        moved = [number for number in scene.get("nodes", []) if "skin" not in nodes[number]]
        others = [number for number in scene.get("nodes", []) if "skin" in nodes[number]]
        scene["nodes"] = [self.builder.add("nodes", placing.to_node(name, moved)), *others]

    def finish(self) -> bytes:
        """Return the file."""
        for mesh, entry in enumerate(self.root.get("meshes", [])):
            for number, primitive in enumerate(entry.get("primitives", [])):
                if (mesh, number) not in self._replaced:
                    self._keep([primitive.get("attributes", {}), *primitive.get("targets", [])])
                    self._keep([primitive], "indices")
        for animation in self.root.get("animations", []):
            self._keep(animation.get("samplers", []), "input", "output")
        self._keep(self.root.get("skins", []), "inverseBindMatrices")
        nodes = self.root.get("nodes", [])
        self._keep(node.get("extensions", {}).get(_INSTANCES, {}).get("attributes", {}) for node in nodes)
        for key, owner in self.root.items():
            if key not in ("accessors", "bufferViews", "images"):
                self._keep_views(owner)
        for key in ("extensionsUsed", "extensionsRequired"):
            gone = {DRACO, *MESHOPT, *((_QUANTIZED,) if self.plain else ())}
            self.root[key] = [name for name in self.root.get(key, []) if name not in gone]
            if not self.root[key]:
                del self.root[key]
        file = BytesIO()
        finish(self.builder, file)
        return file.getvalue()

    def _keep(self, owners: Iterable[dict[str, Any]], *keys: str) -> None:
        """Keep the arrays of the accessors that JSON objects refer to by these keys (default: by any key)."""
        for owner in owners:
            for key in set(keys or owner) & owner.keys():
                owner[key] = self._keep_accessor(owner[key])

    def _keep_accessor(self, number: int) -> int:
        if ("accessors", number) not in self._moved:
            entry = copy.deepcopy(self._old["accessors"][number])
            self._keep_views(entry)
            self._moved["accessors", number] = self.builder.add("accessors", entry)
        return self._moved["accessors", number]

    def _keep_views(self, owner: Any) -> None:
        """Renumber the buffer views that a JSON value refers to at any depth, and keep their bytes."""
        if isinstance(owner, list):
            for entry in owner:
                self._keep_views(entry)
        elif isinstance(owner, dict):
            for key, value in owner.items():
                if key == "bufferView" and type(value) is int:
                    owner[key] = self._keep_view(value)
                elif key != "extras":
                    self._keep_views(value)

    def _keep_view(self, number: int) -> int:
        if ("bufferViews", number) not in self._moved:
            data, view, _ = self.scene.document.view(number)
            kept = ("name", "byteStride", "target", "extras")
            entry: dict[str, Any] = {key: view[key] for key in kept if key in view}
            entry |= self.builder.put(bytes(data))
            self._moved["bufferViews", number] = self.builder.add("bufferViews", entry)
        return self._moved["bufferViews", number]

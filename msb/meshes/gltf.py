"""Parses glTF 2.0: the GLB container, the JSON, the arrays ("accessors") in buffers, and the node tree."""

from __future__ import annotations

import json
import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from msb.base.files import read_file
from msb.errors import InputError, MeshFileError, shorten
from msb.meshes.linked_files import Files, read_uri
from msb.meshes.source import Source

HEADER = struct.Struct("<4sII")
CHUNK = struct.Struct("<I4s")
# Maps component types of glTF 2.0 to NumPy types.
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}

# Maps accessor types to their number of components.
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}

# Largest JSON in bytes: 16 MiB, enough for about 100,000 nodes. Parsing a JSON text of this size needs at
# most about 400 MB.
MAX_JSON_BYTES = 1 << 24

# Deepest nesting of the JSON. glTF needs about ten levels. The `extras` objects may need more.
MAX_JSON_DEPTH = 64

# A long data URI in the JSON.
_DATA_URI = re.compile(rb'"(data:[^"\\]{256,})"')

# Largest buffer in a separate file: 1 TiB, in bytes.
MAX_BUFFER = 1 << 40

IDENTITY = np.eye(4)
# The extension for Gaussian splats. A file that uses this extension is a model of Gaussians, not a mesh.
GAUSSIANS = "KHR_gaussian_splatting"
# Number of bytes at the start of a file in which the name of an extension is searched.
_SEARCHED = 1 << 22
VISIBILITY = "KHR_node_visibility"

# Maximum number of nodes. Real scenes have some thousand nodes. A million nodes take a few seconds.
MAX_NODES = 1 << 20

# Memory limit for the arrays of a file: 64 bytes per byte of the file, plus 256 MiB. For each byte of the
# file, an array needs at most 24 bytes of memory. Vertex indices need this maximum. Only a file whose nodes
# or primitives share arrays can exceed this limit.
MAX_BYTES_PER_BYTE = 64
MAX_EXTRA_BYTES = 1 << 28

# For each byte value, the amount by which the byte changes the nesting depth of the JSON.
_NESTING = np.zeros(256, dtype=np.int8)
_NESTING[list(b"[{")] = 1
_NESTING[list(b"]}")] = -1


@dataclass(frozen=True)
class Document:
    """A parsed glTF file. Buffers and linked files are read on demand and cached.

    Attributes
    ----------
    root : dict
        The JSON object.
    embedded : dict
        Long data URIs. The JSON contains these keys instead: "#0", "#1", ...
    buffers : dict
        The bytes of the buffers. The key is the buffer index.
    files : dict
        The linked files that were read.
    views : dict
        The decoded bytes of compressed buffer views. The key is the index of the buffer view.
    packed : dict
        The decoded arrays (count, width) of compressed primitives. A key is the JSON pointer of the primitive
        and the name of the attribute.
    """

    source: Source
    root: dict[str, Any]
    embedded: dict[str, str]
    buffers: dict[int, memoryview] = field(default_factory=dict)
    files: Files = field(default_factory=dict)
    views: dict[int, memoryview] = field(default_factory=dict)
    packed: dict[str, dict[str, NDArray[Any]]] = field(default_factory=dict)

    @property
    def limit(self) -> int:
        """Memory limit in bytes for the arrays.

        The memory limit depends on the sizes of the file and of all linked files that were read.
        """
        linked = sum(map(len, self.files.values()))
        return MAX_BYTES_PER_BYTE * (len(self.source.data) + linked) + MAX_EXTRA_BYTES

    def check_total(self, what: str, total: int) -> None:
        """Raise MESH_FILE_TOO_LARGE if arrays of `total` bytes exceed the limit.

        The message begins with `what`.
        """
        if total > (limit := self.limit):
            text = f"{what} need {total} bytes; the limit for a file of this size is {limit}"
            raise self.source.error("MESH_FILE_TOO_LARGE", text)

    def error(self, code: str, pointer: str, message: str) -> MeshFileError:
        """Return an error about the JSON value at the JSON pointer `pointer`."""
        return self.source.error(code, message, pointer=pointer)

    def integer(
        self, owner: dict[str, Any], key: str, pointer: str, *, default: int | None = None, below: int = 2**63
    ) -> int:
        """Return the integer `owner[key]`, from 0 to `below` - 1.

        Without `default`, the value is required.
        """
        value = owner.get(key, default)
        if type(value) is not int or not 0 <= value < below:
            text = f"'{key}' is {shorten(str(value))}; it must be an integer from 0 to {below - 1}"
            raise self.error("MESH_FILE_INVALID", f"{pointer}/{key}", text)
        return value

    def numbers(
        self, owner: dict[str, Any], key: str, pointer: str, default: tuple[float, ...]
    ) -> NDArray[np.float64]:
        """Return the finite numbers in the array `owner[key]` (N,).

        The array must have the length of `default`.
        """
        value = owner.get(key, default)
        ok = isinstance(value, list | tuple) and len(value) == len(default)
        if not ok or not all(type(entry) in (int, float) and _is_finite(entry) for entry in value):
            text = f"'{key}' must be an array of {len(default)} finite numbers"
            raise self.error("MESH_FILE_INVALID", f"{pointer}/{key}", text)
        return np.array(value, dtype=np.float64)

    def number(self, owner: dict[str, Any], key: str, pointer: str, default: float) -> float:
        """Return the finite number `owner[key]`."""
        value = owner.get(key, default)
        if type(value) not in (int, float) or not _is_finite(value):
            text = f"'{key}' is {shorten(str(value))}; it must be a finite number"
            raise self.error("MESH_FILE_INVALID", f"{pointer}/{key}", text)
        return float(value)

    def array(self, owner: dict[str, Any], key: str, pointer: str) -> list[Any]:
        """Return the JSON array `owner[key]`, or an empty array if the key is missing."""
        value = owner.get(key, [])
        if not isinstance(value, list):
            raise self.error("MESH_FILE_INVALID", f"{pointer}/{key}", f"'{key}' is not an array")
        return value

    def object(self, owner: dict[str, Any], key: str, pointer: str) -> dict[str, Any]:
        """Return the JSON object `owner[key]`, or an empty object if the key is missing."""
        value = owner.get(key, {})
        if not isinstance(value, dict):
            raise self.error("MESH_FILE_INVALID", f"{pointer}/{key}", f"'{key}' is not an object")
        return value

    def entry(self, table: str, index: int) -> tuple[dict[str, Any], str]:
        """Return entry `index` of a top-level array such as "meshes", and the entry's JSON pointer."""
        pointer = f"/{table}/{index}"
        entries = self.array(self.root, table, "")
        if index >= len(entries) or not isinstance(entries[index], dict):
            text = f"the object does not exist; '{table}' has {len(entries)} entries"
            raise self.error("MESH_FILE_INVALID", pointer, text)
        return entries[index], pointer

    def buffer(self, index: int) -> memoryview:
        """Return the bytes of buffer `index`: the binary chunk, embedded data, or a linked file."""
        if index not in self.buffers:
            entry, pointer = self.entry("buffers", index)
            if "uri" not in entry:
                text = "the buffer has no 'uri'; only the first buffer of a GLB may omit it"
                raise self.error("MESH_FILE_INVALID", pointer, text)
            most = self.integer(entry, "byteLength", pointer, below=MAX_BUFFER)
            # Read the complete file, because several buffers with different lengths may refer to the same
            # file.
            self.buffers[index] = memoryview(self.resource(entry, pointer, None))[:most]
        return self.buffers[index]

    def resource(self, owner: dict[str, Any], pointer: str, most: int | None) -> bytes:
        """Return the bytes that `owner["uri"]` refers to. The number of bytes is limited to `most` as in
        `read_linked_file`.
        """
        uri, where = owner.get("uri"), f"{pointer}/uri"
        if not isinstance(uri, str):
            raise self.error("MESH_FILE_INVALID", where, "'uri' must be a string")
        return read_uri(self.source, self.embedded.get(uri, uri), where, most, self.files)

    def view(self, index: int) -> tuple[memoryview, dict[str, Any], str]:
        """Return the bytes of buffer view `index`, its JSON entry, and its JSON pointer."""
        view, pointer = self.entry("bufferViews", index)
        data = self.views.get(index)
        return self.bytes_of(view, pointer) if data is None else data, view, pointer

    def bytes_of(self, view: dict[str, Any], pointer: str) -> memoryview:
        """Return the part of a buffer that the JSON entry `view` describes."""
        buffer = self.buffer(self.integer(view, "buffer", pointer))
        start = self.integer(view, "byteOffset", pointer, default=0)
        size = self.integer(view, "byteLength", pointer)
        if start + size > len(buffer):
            text = f"the view ends at byte {start + size}, but the buffer has {len(buffer)} bytes"
            raise self.error("MESH_FILE_TRUNCATED", pointer, text)
        return buffer[start : start + size]


@dataclass(frozen=True)
class Accessor:
    """A validated description of an array (count, width). The file contains all bytes of the array.

    The field `data` has the bytes of the buffer view, or is None for an array of zeros. The first element of
    the array begins at byte `start` of `data`. The distance between consecutive elements is `stride` bytes.
    The field `sparse` has two accessors: the indices of elements to replace, and their new values.
    """

    document: Document
    pointer: str
    count: int
    width: int
    dtype: np.dtype[Any]
    normalized: bool
    data: memoryview | None
    start: int
    stride: int
    sparse: tuple[Accessor, Accessor] | None = None

    def read(self) -> NDArray[Any]:
        """Return the values (count, width) with the type `dtype`."""
        values: NDArray[Any]
        if self.data is None or not self.count:
            values = np.zeros((self.count, self.width), dtype=self.dtype)
        else:
            strides = (self.stride, self.dtype.itemsize)
            shape = (self.count, self.width)
            values = np.ndarray(shape, self.dtype, self.data, self.start, strides).copy()
        if self.sparse is not None:
            places = self.sparse[0].read()[:, 0].astype(np.int64)
            if places.size and places.max() >= self.count:
                text = f"the sparse index {places.max()} is out of range; there are {self.count} elements"
                raise self.document.error("MESH_FILE_INVALID", f"{self.pointer}/sparse", text)
            values[places] = self.sparse[1].read()
        return values


def uses_gaussians(path: Path) -> bool:
    """Return whether a GLB or glTF file names the extension for Gaussian splats.

    Only the JSON at the start of a GLB is searched.
    """
    if path.suffix.lower() not in (".glb", ".gltf"):
        return False
    try:
        head = read_file(path, _SEARCHED)
    except InputError:  # The reader reports the error later.
        return False
    end = HEADER.size + CHUNK.size
    is_binary = head.startswith(b"glTF") and len(head) >= end
    length = CHUNK.unpack_from(head, HEADER.size)[0] if is_binary else len(head)
    return GAUSSIANS.encode() in head[: end + length]


def open_document(source: Source) -> Document:
    """Return the document of a GLB file."""
    data = source.data
    if not data.startswith(b"glTF"):
        raise source.not_a("GLB", "the content does not begin with 'glTF'")
    if len(data) < HEADER.size:
        raise source.error("MESH_FILE_TRUNCATED", f"the file ends in its header of {HEADER.size} bytes")
    _, version, length = HEADER.unpack_from(data)
    if version != 2:
        text = f"GLB version {version} is not supported; export version 2"
        raise source.error("MESH_FILE_UNSUPPORTED", text, pointer="byte 4")
    if length > len(data):
        text = f"the header declares {length} bytes, but the file has {len(data)}"
        raise source.error("MESH_FILE_TRUNCATED", text, pointer="byte 8")
    if length < len(data):
        text = f"{len(data) - length} surplus bytes follow after the {length} bytes that the header declares"
        raise source.error("MESH_FILE_INVALID", text, pointer=f"byte {length}")
    chunks = _split_chunks(source)
    if not chunks or chunks[0][0] != b"JSON":
        raise source.error("MESH_FILE_INVALID", "the first chunk is not JSON", pointer="byte 16")
    binary = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == b"BIN\0" else memoryview(b"")
    document = parse_document(source, bytes(chunks[0][1]))
    buffers = document.root.get("buffers")
    if isinstance(buffers, list) and buffers and isinstance(buffers[0], dict) and "uri" not in buffers[0]:
        document.buffers[0] = binary
    return document


def parse_document(source: Source, text: bytes) -> Document:
    """Return the document of a JSON text.

    Replace long data URIs before parsing. The size limit then applies to the remaining JSON only.
    """
    embedded: dict[str, str] = {}

    def replace_uri(match: re.Match[bytes]) -> bytes:
        name = f"#{len(embedded)}"
        embedded[name] = match[1].decode("latin-1")
        return f'"{name}"'.encode("ascii")

    return Document(source, _parse_json(source, _DATA_URI.sub(replace_uri, text)), embedded)


def parse_accessor(
    document: Document, index: int, *, kinds: str, components: str, unpacked: NDArray[Any] | None = None
) -> Accessor:
    """Return accessor `index` after checking that its bytes exist.

    The argument `kinds` has the allowed element types, such as "VEC3 VEC4". The argument `components` has the
    allowed number types, such as "u1 u2 f4". The argument `unpacked` (count, width) contains decompressed
    values that replace the buffer view.
    """
    entry, pointer = document.entry("accessors", index)
    kind = entry.get("type")
    if not isinstance(kind, str) or kind not in kinds.split():
        text = f"'type' is {shorten(str(kind))}; it must be {kinds.replace(' ', ' or ')}"
        raise document.error("MESH_FILE_INVALID", f"{pointer}/type", text)
    width = WIDTHS[kind]
    count = document.integer(entry, "count", pointer)
    dtype = _parse_component(document, entry, pointer, components)
    normalized = entry.get("normalized") is True
    if unpacked is not None:
        # Encoders may store wider integers than the accessor declares. Convert the values to the declared
        # type, and check that the conversion is exact.
        same_kind = (unpacked.dtype.kind == "f") == (dtype.kind == "f")
        values = unpacked.astype(dtype) if same_kind else unpacked[:0]
        if values.shape != (count, width) or not np.array_equal(values, unpacked, equal_nan=True):
            text = f"the accessor declares {count} {kind} of {dtype}, but the compressed data is "
            text += f"{unpacked.shape} {unpacked.dtype}"
            raise document.error("MESH_FILE_INVALID", pointer, text)
        data, size = memoryview(values.tobytes()), dtype.itemsize * width
        return Accessor(document, pointer, count, width, dtype, normalized, data, 0, size)
    sparse = document.object(entry, "sparse", pointer)
    place: tuple[memoryview | None, int, int] = None, 0, 0
    if "bufferView" in entry:
        place = _locate(document, entry, pointer, count, dtype.itemsize * width)
    plain = Accessor(document, pointer, count, width, dtype, normalized, *place)
    return (
        replace(plain, sparse=_parse_sparse(document, sparse, f"{pointer}/sparse", plain))
        if sparse
        else plain
    )


def _parse_sparse(
    document: Document, entry: dict[str, Any], pointer: str, base: Accessor
) -> tuple[Accessor, Accessor]:
    """Return two accessors for the sparse replacements in `base`: the indices and the values."""
    count = document.integer(entry, "count", pointer, below=base.count + 1)
    indices = document.object(entry, "indices", pointer)
    values = document.object(entry, "values", pointer)
    kind = _parse_component(document, indices, f"{pointer}/indices", "u1 u2 u4")
    place = _locate(document, indices, f"{pointer}/indices", count, kind.itemsize)
    first = Accessor(document, f"{pointer}/indices", count, 1, kind, False, *place)
    size = base.dtype.itemsize * base.width
    place = _locate(document, values, f"{pointer}/values", count, size)
    return first, Accessor(document, f"{pointer}/values", count, base.width, base.dtype, False, *place)


def _parse_component(document: Document, owner: dict[str, Any], pointer: str, allowed: str) -> np.dtype[Any]:
    """Return the NumPy type of `owner["componentType"]`, which must be one of `allowed`, such as "u1 u2"."""
    number = document.integer(owner, "componentType", pointer)
    name = COMPONENTS.get(number, "")
    if name[1:] not in allowed.split():
        valid = ", ".join(str(key) for key, kind in COMPONENTS.items() if kind[1:] in allowed.split())
        text = f"'componentType' is {number}; it must be one of {valid}"
        raise document.error("MESH_FILE_INVALID", f"{pointer}/componentType", text)
    return np.dtype(name)


def _locate(
    document: Document, owner: dict[str, Any], pointer: str, count: int, size: int
) -> tuple[memoryview, int, int]:
    """Return the bytes, start and stride of a buffer view with `count` elements of `size` bytes."""
    data, view, view_pointer = document.view(document.integer(owner, "bufferView", pointer))
    stride = document.integer(view, "byteStride", view_pointer, default=size)
    if stride < size:
        text = f"'byteStride' is {stride}, but an element has {size} bytes"
        raise document.error("MESH_FILE_INVALID", f"{view_pointer}/byteStride", text)
    start = document.integer(owner, "byteOffset", pointer, default=0)
    if count and start + stride * (count - 1) + size > len(data):
        text = f"{count} elements of {size} bytes do not fit the {len(data)} bytes of {view_pointer}"
        raise document.error("MESH_FILE_TRUNCATED", pointer, text)
    return data, start, stride


def _split_chunks(source: Source) -> list[tuple[bytes, memoryview]]:
    """Return the types and contents of the first two chunks. Only extensions of GLB use further chunks."""
    chunks: list[tuple[bytes, memoryview]] = []
    at = HEADER.size
    while at < len(source.data) and len(chunks) < 2:
        if at + CHUNK.size > len(source.data):
            text = "the file ends in the header of a chunk"
            raise source.error("MESH_FILE_TRUNCATED", text, pointer=f"byte {at}")
        size, kind = CHUNK.unpack_from(source.data, at)
        begin = at + CHUNK.size
        if begin + size > len(source.data):
            text = f"a chunk declares {size} bytes, but only {len(source.data) - begin} are left"
            raise source.error("MESH_FILE_TRUNCATED", text, pointer=f"byte {at}")
        chunks.append((kind, memoryview(source.data)[begin : begin + size]))
        at = begin + size
    return chunks


def _parse_json(source: Source, text: bytes) -> dict[str, Any]:
    """Return the JSON object in `text`."""
    if len(text) > MAX_JSON_BYTES:
        message = f"the JSON has {len(text)} bytes; at most {MAX_JSON_BYTES} are supported"
        raise source.error("MESH_FILE_TOO_LARGE", message)
    depth = _measure_nesting(text)
    if depth > MAX_JSON_DEPTH:
        message = f"the JSON has {depth} nested levels; at most {MAX_JSON_DEPTH} are supported"
        raise source.error("MESH_FILE_TOO_LARGE", message)
    try:
        root = json.loads(text.decode("utf-8"), parse_constant=_reject_constant)
    except ValueError as error:
        message = f"the JSON cannot be read: {shorten(str(error))}"
        raise source.error("MESH_FILE_INVALID", message) from None
    if not isinstance(root, dict):
        raise source.error("MESH_FILE_INVALID", "the JSON must be an object")
    return root


def _measure_nesting(text: bytes) -> int:
    """Return the nesting depth of objects and arrays in the JSON. Brackets inside strings are ignored.

    This function uses NumPy, because `msb.base.bounded_parsing` would need ten seconds for `MAX_JSON_BYTES`.
    """
    unescaped = text.replace(b"\\\\", b"  ").replace(b'\\"', b"  ")
    marks = np.frombuffer(unescaped, dtype=np.uint8)
    outside = np.cumsum(marks == ord('"'), dtype=np.int32) % 2 == 0
    return int(np.cumsum(_NESTING[marks] * outside, dtype=np.int32).max(initial=0))


def _reject_constant(name: str) -> NoReturn:
    """Reject NaN and Infinity in JSON. Python's parser accepts NaN and Infinity."""
    message = f"{name} is not valid in JSON"
    raise ValueError(message)


def _is_finite(value: float) -> bool:
    """Return whether `value` is finite as float64. The conversion of a long integer to float64 may
    overflow."""
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


@dataclass(frozen=True)
class PlacedMesh:
    """A mesh in the scene: its index, the JSON of its node, and the world transform (4, 4) of the node."""

    mesh: int
    node: dict[str, Any]
    world: NDArray[np.float64]


@dataclass(frozen=True)
class PlacedNodes:
    """The world transforms (4, 4) of the nodes in the scene, and the indices of hidden nodes."""

    worlds: dict[int, NDArray[np.float64]]
    hidden: set[int]


def list_placed_meshes(document: Document, nodes: PlacedNodes) -> Iterator[tuple[PlacedMesh, bool]]:
    """Yield each mesh in the scene in the order of nodes. Also yield whether the mesh is hidden."""
    for index, world in sorted(nodes.worlds.items()):
        node, pointer = document.entry("nodes", index)
        if "mesh" in node:
            placed = PlacedMesh(document.integer(node, "mesh", pointer), node, world)
            yield placed, index in nodes.hidden


def place_nodes(document: Document) -> PlacedNodes:
    """Return the nodes of the scene.

    The scene is the default scene of the file, else the first scene. If the file has no scenes, all nodes are
    used. A node is hidden if the node itself or one of its ancestors is not visible (KHR_node_visibility).
    """
    roots, nodes = _find_roots(document)
    worlds: dict[int, NDArray[np.float64]] = {}
    hidden: set[int] = set()
    waiting = [(roots, IDENTITY, False)]
    while waiting:
        siblings, parent, is_hidden = waiting.pop()
        for index in siblings:
            node, pointer = document.entry("nodes", index)
            if index in worlds:
                text = "the node has two parents or is part of a cycle; nodes must form trees"
                raise document.error("MESH_FILE_INVALID", pointer, text)
            local = _parse_local_transform(document, node, pointer)
            with np.errstate(over="ignore", invalid="ignore"):
                worlds[index] = parent if local is IDENTITY else parent @ local
            is_shown = not is_hidden and _is_visible(document, node, pointer)
            if not is_shown:
                hidden.add(index)
            children = parse_node_numbers(document, node, "children", pointer)
            waiting.append((children, worlds[index], not is_shown))
    if nodes is not None and len(worlds) < nodes:
        text = "some nodes are in a cycle; nodes must form trees"
        raise document.error("MESH_FILE_INVALID", "/nodes", text)
    return PlacedNodes(worlds, hidden)


def _is_visible(document: Document, node: dict[str, Any], pointer: str) -> bool:
    """Return whether a node itself is visible. Ancestors are ignored."""
    extensions = document.object(node, "extensions", pointer)
    entry = document.object(extensions, VISIBILITY, f"{pointer}/extensions")
    return entry.get("visible", True) is not False


def _find_roots(document: Document) -> tuple[list[int], int | None]:
    """Return the root nodes, and the number of nodes that must be reachable.

    The second value is None if the scene lists its root nodes.
    """
    count = len(document.array(document.root, "nodes", ""))
    if count > MAX_NODES:
        text = f"there are {count} nodes; at most {MAX_NODES} are supported"
        raise document.error("MESH_FILE_TOO_LARGE", "/nodes", text)
    if document.array(document.root, "scenes", ""):
        number = document.integer(document.root, "scene", "", default=0)
        scene, pointer = document.entry("scenes", number)
        return parse_node_numbers(document, scene, "nodes", pointer), None
    entries = (document.entry("nodes", index) for index in range(count))
    children = {
        child for node in entries for child in parse_node_numbers(document, node[0], "children", node[1])
    }
    return [index for index in range(count) if index not in children], count


def parse_node_numbers(document: Document, owner: dict[str, Any], key: str, pointer: str) -> list[int]:
    """Return the array of node indices `owner[key]`."""
    numbers = document.array(owner, key, pointer)
    count = len(document.array(document.root, "nodes", ""))
    for number in numbers:
        if type(number) is not int or not 0 <= number < count:
            text = f"'{shorten(str(number))}' is not a node number; there are {count} nodes"
            raise document.error("MESH_FILE_INVALID", f"{pointer}/{key}", text)
    return numbers


def _parse_local_transform(document: Document, node: dict[str, Any], pointer: str) -> NDArray[np.float64]:
    """Return the local transform (4, 4) of a node. The transform is a matrix, or a product of translation,
    rotation and scale."""
    if "matrix" in node:
        return document.numbers(node, "matrix", pointer, tuple(IDENTITY.ravel())).reshape(4, 4).T
    if not node.keys() & {"translation", "rotation", "scale"}:
        return IDENTITY
    # Rotation matrix of the quaternion (x, y, z, w). The factor s normalises the quaternion.
    x, y, z, w = document.numbers(node, "rotation", pointer, (0, 0, 0, 1))
    with np.errstate(all="ignore"):
        s = 2 / (x * x + y * y + z * z + w * w)
        rotation = np.array(
            [
                [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
                [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
                [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
            ]
        )
        if not np.isfinite(rotation).all():
            text = "'rotation' is not a quaternion of length 1"
            raise document.error("MESH_FILE_INVALID", f"{pointer}/rotation", text)
        transform = np.eye(4)
        transform[:3, :3] = rotation * document.numbers(node, "scale", pointer, (1, 1, 1))
    transform[:3, 3] = document.numbers(node, "translation", pointer, (0, 0, 0))
    return transform

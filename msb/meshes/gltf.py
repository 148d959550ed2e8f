"""The container of a GLB, the JSON of glTF 2.0, the arrays ("accessors") in its buffers, and its nodes."""

from __future__ import annotations

import json
import math
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from msb.errors import MeshFileError, shorten
from msb.meshes.beside import Files, read_uri
from msb.meshes.source import Source

HEADER = struct.Struct("<4sII")
CHUNK = struct.Struct("<I4s")
# Component types of glTF 2.0 -> NumPy types.
COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}

# Accessor types -> components an element; matrices hold no geometry.
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}

# Most bytes of the JSON: 16 MiB, which hold a scene of some 100,000 nodes and take at most some 400 MB when
# parsed.
MAX_JSON_BYTES = 1 << 24

# Deepest nesting of the JSON. glTF itself nests about ten deep; extras may add some levels.
MAX_JSON_DEPTH = 64

_DATA_URI = re.compile(rb'"(data:[^"\\]{256,})"')

# Most bytes of a buffer beside the file.
MAX_BUFFER = 1 << 40

IDENTITY = np.eye(4)

# Most nodes of a scene. Real scenes have some thousand; a million take a few seconds.
MAX_NODES = 1 << 20

MAX_BYTES_PER_BYTE = 64
# The memory that a file's arrays may take: 64 bytes per byte of file, and 256 MiB.
#
# One byte of indices gives at most 24 bytes, so only nodes and primitives that share arrays reach the limit.
MAX_EXTRA_BYTES = 1 << 28

_NESTING = np.zeros(256, dtype=np.int8)
_NESTING[list(b"[{")] = 1
_NESTING[list(b"]}")] = -1


@dataclass(frozen=True)
class Document:
    """A glTF file: its JSON object and its buffers by number, of which those that are needed get read.

    `files` are those beside it that were read, each once, whatever the JSON calls it. `embedded` are the long
    data URIs of the JSON, by what stands in their places: "#0", "#1", ... What was compressed is in `views`,
    by number, and in `packed`, by pointer of a primitive and name: (count, width).
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
        """How many bytes its arrays may take, by those of the file and of what was read beside it so far."""
        beside = sum(map(len, self.files.values()))
        return MAX_BYTES_PER_BYTE * (len(self.source.data) + beside) + MAX_EXTRA_BYTES

    def check_total(self, what: str, total: int) -> None:
        """Refuse arrays of `total` bytes if the file is too small for so many."""
        if total > (limit := self.limit):
            text = f"{what} would take {total} bytes; {limit} is the limit for a file of this size"
            raise self.source.error("MESH_FILE_TOO_LARGE", text)

    def error(self, code: str, pointer: str, message: str) -> MeshFileError:
        """Return the error about the place with JSON pointer `pointer`."""
        return self.source.error(code, message, pointer=pointer)

    def integer(
        self, owner: dict[str, Any], key: str, pointer: str, *, default: int | None = None, below: int = 2**63
    ) -> int:
        """Return `owner[key]`, an integer from 0 to `below` - 1; without a default it is required."""
        value = owner.get(key, default)
        if type(value) is not int or not 0 <= value < below:
            text = f"'{key}' is {shorten(str(value))}, not an integer from 0 to {below - 1}"
            raise self.error("MESH_FILE_INVALID", f"{pointer}/{key}", text)
        return value

    def numbers(
        self, owner: dict[str, Any], key: str, pointer: str, default: tuple[float, ...]
    ) -> NDArray[np.float64]:
        """Return `owner[key]`, an array (N,) of as many finite numbers as `default` has."""
        value = owner.get(key, default)
        ok = isinstance(value, list | tuple) and len(value) == len(default)
        if not ok or not all(type(each) in (int, float) and _is_finite(each) for each in value):
            text = f"'{key}' is not an array of {len(default)} finite numbers"
            raise self.error("MESH_FILE_INVALID", f"{pointer}/{key}", text)
        return np.array(value, dtype=np.float64)

    def number(self, owner: dict[str, Any], key: str, pointer: str, default: float) -> float:
        """Return `owner[key]`, a finite number."""
        value = owner.get(key, default)
        if type(value) not in (int, float) or not _is_finite(value):
            text = f"'{key}' is {shorten(str(value))}, not a finite number"
            raise self.error("MESH_FILE_INVALID", f"{pointer}/{key}", text)
        return float(value)

    def array(self, owner: dict[str, Any], key: str, pointer: str) -> list[Any]:
        """Return the JSON array `owner[key]`; absent is empty."""
        value = owner.get(key, [])
        if not isinstance(value, list):
            raise self.error("MESH_FILE_INVALID", f"{pointer}/{key}", f"'{key}' is not an array")
        return value

    def object(self, owner: dict[str, Any], key: str, pointer: str) -> dict[str, Any]:
        """Return the JSON object `owner[key]`; absent is empty."""
        value = owner.get(key, {})
        if not isinstance(value, dict):
            raise self.error("MESH_FILE_INVALID", f"{pointer}/{key}", f"'{key}' is not an object")
        return value

    def entry(self, table: str, index: int) -> tuple[dict[str, Any], str]:
        """Return entry `index` of a top-level array such as "meshes", and its JSON pointer."""
        pointer = f"/{table}/{index}"
        entries = self.array(self.root, table, "")
        if index >= len(entries) or not isinstance(entries[index], dict):
            text = f"there is no such object; '{table}' has {len(entries)} entries"
            raise self.error("MESH_FILE_INVALID", pointer, text)
        return entries[index], pointer

    def buffer(self, index: int) -> memoryview:
        """Return buffer `index`: the binary chunk, embedded data or a file beside."""
        if index not in self.buffers:
            entry, pointer = self.entry("buffers", index)
            if "uri" not in entry:
                text = "only the first buffer can lie in the binary chunk, and this one names no other place"
                raise self.error("MESH_FILE_INVALID", pointer, text)
            most = self.integer(entry, "byteLength", pointer, below=MAX_BUFFER)
            # Read whole: of several buffers that lie in it each may say another length.
            self.buffers[index] = memoryview(self.resource(entry, pointer, None))[:most]
        return self.buffers[index]

    def resource(self, owner: dict[str, Any], pointer: str, most: int | None) -> bytes:
        """Return the bytes that `owner["uri"]` means; of a longer file the first `most` or one more."""
        uri, where = owner.get("uri"), f"{pointer}/uri"
        if not isinstance(uri, str):
            raise self.error("MESH_FILE_INVALID", where, "'uri' is no text")
        return read_uri(self.source, self.embedded.get(uri, uri), where, most, self.files)

    def view(self, index: int) -> tuple[memoryview, dict[str, Any], str]:
        """Return the bytes of buffer view `index`, its entry and its JSON pointer."""
        view, pointer = self.entry("bufferViews", index)
        data = self.views.get(index)
        return self.bytes_of(view, pointer) if data is None else data, view, pointer

    def bytes_of(self, view: dict[str, Any], pointer: str) -> memoryview:
        """Return the bytes of a buffer that `view` names."""
        buffer = self.buffer(self.integer(view, "buffer", pointer))
        start = self.integer(view, "byteOffset", pointer, default=0)
        size = self.integer(view, "byteLength", pointer)
        if start + size > len(buffer):
            text = f"it ends at byte {start + size} of a buffer of {len(buffer)} bytes"
            raise self.error("MESH_FILE_TRUNCATED", pointer, text)
        return buffer[start : start + size]


@dataclass(frozen=True)
class Accessor:
    """A checked description of an array: reading it cannot fail for want of bytes.

    `data` are the bytes of its view, in which it begins at byte `start`, None for zeros; `stride` the bytes
    from one element to the next; `sparse` the accessors of the positions and values that replace some.
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
        """Return the values: (count, width), of `dtype`."""
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
                text = f"a sparse index is {places.max()}, but the accessor has {self.count} elements"
                raise self.document.error("MESH_FILE_INVALID", f"{self.pointer}/sparse", text)
            values[places] = self.sparse[1].read()
        return values


def open_document(source: Source) -> Document:
    """Take a GLB file apart and parse its JSON."""
    data = source.data
    if not data.startswith(b"glTF"):
        raise source.not_a("GLB", "it does not begin with 'glTF'")
    if len(data) < HEADER.size:
        raise source.error("MESH_FILE_TRUNCATED", f"the file ends within its header of {HEADER.size} bytes")
    _, version, length = HEADER.unpack_from(data)
    if version != 2:
        text = f"version {version} is not read; 2 is"
        raise source.error("MESH_FILE_UNSUPPORTED", text, pointer="byte 4")
    if length > len(data):
        text = f"the header says {length} bytes, the file has {len(data)}"
        raise source.error("MESH_FILE_TRUNCATED", text, pointer="byte 8")
    if length < len(data):
        text = f"{len(data) - length} bytes follow the {length} bytes the header announces"
        raise source.error("MESH_FILE_INVALID", text, pointer=f"byte {length}")
    chunks = _chunks(source)
    if not chunks or chunks[0][0] != b"JSON":
        raise source.error("MESH_FILE_INVALID", "the first chunk is not JSON", pointer="byte 16")
    binary = chunks[1][1] if len(chunks) > 1 and chunks[1][0] == b"BIN\0" else memoryview(b"")
    document = document_of(source, bytes(chunks[0][1]))
    buffers = document.root.get("buffers")
    if isinstance(buffers, list) and buffers and isinstance(buffers[0], dict) and "uri" not in buffers[0]:
        document.buffers[0] = binary
    return document


def document_of(source: Source, text: bytes) -> Document:
    """Parse the JSON of a file. Long data URIs are taken out before: they cost a parser next to nothing."""
    embedded: dict[str, str] = {}

    def placed(match: re.Match[bytes]) -> bytes:
        name = f"#{len(embedded)}"
        embedded[name] = match[1].decode("latin-1")
        return f'"{name}"'.encode("ascii")

    return Document(source, _parse_json(source, _DATA_URI.sub(placed, text)), embedded)


def accessor(
    document: Document, index: int, *, kinds: str, components: str, unpacked: NDArray[Any] | None = None
) -> Accessor:
    """Describe accessor `index` after checking that its bytes are there.

    `kinds` are the allowed types, such as "VEC3 VEC4", `components` those of the numbers, such as "u1 u2
    f4". What was `unpacked` for it, (count, width), stands for the bytes of its view.
    """
    entry, pointer = document.entry("accessors", index)
    kind = entry.get("type")
    if not isinstance(kind, str) or kind not in kinds.split():
        text = f"'type' is {shorten(str(kind))}; {kinds.replace(' ', ' or ')} is right here"
        raise document.error("MESH_FILE_INVALID", f"{pointer}/type", text)
    width = WIDTHS[kind]
    count = document.integer(entry, "count", pointer)
    dtype = _component(document, entry, pointer, components)
    normalized = entry.get("normalized") is True
    if unpacked is not None:
        same = (unpacked.dtype.kind == "f") == (dtype.kind == "f")
        # Encoders store integers wider than they are.
        values = unpacked.astype(dtype) if same else unpacked[:0]
        if values.shape != (count, width) or not np.array_equal(values, unpacked, equal_nan=True):
            text = f"{count} {kind} of {dtype} are stored as {unpacked.shape} {unpacked.dtype}, compressed"
            raise document.error("MESH_FILE_INVALID", pointer, text)
        data, size = memoryview(values.tobytes()), dtype.itemsize * width
        return Accessor(document, pointer, count, width, dtype, normalized, data, 0, size)
    sparse = document.object(entry, "sparse", pointer)
    place: tuple[memoryview | None, int, int] = None, 0, 0
    if "bufferView" in entry:
        place = _placed(document, entry, pointer, count, dtype.itemsize * width)
    elif not sparse:
        text = "the accessor has no 'bufferView', so it has no values"
        raise document.error("MESH_FILE_INVALID", pointer, text)
    plain = Accessor(document, pointer, count, width, dtype, normalized, *place)
    return replace(plain, sparse=_sparse(document, sparse, f"{pointer}/sparse", plain)) if sparse else plain


def _sparse(
    document: Document, entry: dict[str, Any], pointer: str, base: Accessor
) -> tuple[Accessor, Accessor]:
    """Return the accessors of the indices and the values that `entry` puts into `base`."""
    count = document.integer(entry, "count", pointer, below=base.count + 1)
    indices = document.object(entry, "indices", pointer)
    values = document.object(entry, "values", pointer)
    kind = _component(document, indices, f"{pointer}/indices", "u1 u2 u4")
    place = _placed(document, indices, f"{pointer}/indices", count, kind.itemsize)
    first = Accessor(document, f"{pointer}/indices", count, 1, kind, False, *place)
    size = base.dtype.itemsize * base.width
    place = _placed(document, values, f"{pointer}/values", count, size)
    return first, Accessor(document, f"{pointer}/values", count, base.width, base.dtype, False, *place)


def _component(document: Document, owner: dict[str, Any], pointer: str, allowed: str) -> np.dtype[Any]:
    """Return the type of `owner["componentType"]`, one of the NumPy types `allowed`."""
    number = document.integer(owner, "componentType", pointer)
    name = COMPONENTS.get(number, "")
    if name[1:] not in allowed.split():
        right = ", ".join(str(key) for key, each in COMPONENTS.items() if each[1:] in allowed.split())
        text = f"'componentType' {number} is not allowed here; one of {right} is"
        raise document.error("MESH_FILE_INVALID", f"{pointer}/componentType", text)
    return np.dtype(name)


def _placed(
    document: Document, owner: dict[str, Any], pointer: str, count: int, size: int
) -> tuple[memoryview, int, int]:
    """Return the view's bytes that hold `count` elements of `size` bytes each, their start and stride."""
    data, view, view_pointer = document.view(document.integer(owner, "bufferView", pointer))
    stride = document.integer(view, "byteStride", view_pointer, default=size)
    if stride < size:
        text = f"'byteStride' is {stride}, less than the {size} bytes of an element"
        raise document.error("MESH_FILE_INVALID", f"{view_pointer}/byteStride", text)
    start = document.integer(owner, "byteOffset", pointer, default=0)
    if count and start + stride * (count - 1) + size > len(data):
        text = f"{count} elements of {size} bytes do not fit the {len(data)} bytes of {view_pointer}"
        raise document.error("MESH_FILE_TRUNCATED", pointer, text)
    return data, start, stride


def _chunks(source: Source) -> list[tuple[bytes, memoryview]]:
    """Return type and content of the first two chunks; later ones are of extensions."""
    chunks: list[tuple[bytes, memoryview]] = []
    at = HEADER.size
    while at < len(source.data) and len(chunks) < 2:
        if at + CHUNK.size > len(source.data):
            text = "the file ends within the header of a chunk"
            raise source.error("MESH_FILE_TRUNCATED", text, pointer=f"byte {at}")
        size, kind = CHUNK.unpack_from(source.data, at)
        begin = at + CHUNK.size
        if begin + size > len(source.data):
            text = f"a chunk declares {size} bytes, but {len(source.data) - begin} are left"
            raise source.error("MESH_FILE_TRUNCATED", text, pointer=f"byte {at}")
        chunks.append((kind, memoryview(source.data)[begin : begin + size]))
        at = begin + size
    return chunks


def _parse_json(source: Source, text: bytes) -> dict[str, Any]:
    """Return the JSON object in `text`."""
    if len(text) > MAX_JSON_BYTES:
        message = f"the JSON has {len(text)} bytes, more than {MAX_JSON_BYTES}"
        raise source.error("MESH_FILE_TOO_LARGE", message)
    depth = _nesting(text)
    if depth > MAX_JSON_DEPTH:
        message = f"the JSON nests {depth} deep, more than {MAX_JSON_DEPTH}"
        raise source.error("MESH_FILE_TOO_LARGE", message)
    try:
        root = json.loads(text.decode("utf-8"), parse_constant=_refuse_constant)
    except ValueError as error:
        message = f"the JSON cannot be read: {shorten(str(error))}"
        raise source.error("MESH_FILE_INVALID", message) from None
    if not isinstance(root, dict):
        raise source.error("MESH_FILE_INVALID", "the JSON is not an object")
    return root


def _nesting(text: bytes) -> int:
    """Return how deep objects and arrays nest in JSON; brackets within strings do not count.

    `msb.base.bounded_parsing` takes ten seconds for the most bytes there may be.
    """
    unescaped = text.replace(b"\\\\", b"  ").replace(b'\\"', b"  ")
    marks = np.frombuffer(unescaped, dtype=np.uint8)
    outside = np.cumsum(marks == ord('"'), dtype=np.int32) % 2 == 0
    return int(np.cumsum(_NESTING[marks] * outside, dtype=np.int32).max(initial=0))


def _refuse_constant(name: str) -> NoReturn:
    message = f"{name} is not JSON"
    raise ValueError(message)


def _is_finite(value: float) -> bool:
    """Return whether `value` is finite as float64; a long integer may not be."""
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def placed_meshes(document: Document) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield number and world transform (4, 4) of each mesh the scene shows, in ascending order of nodes.

    The scene is the one the file names, else its first; without scenes all nodes are shown.
    """
    worlds = _world_transforms(document)
    for index in sorted(worlds):
        node, pointer = document.entry("nodes", index)
        if "mesh" in node:
            yield document.integer(node, "mesh", pointer), worlds[index]


def _world_transforms(document: Document) -> dict[int, NDArray[np.float64]]:
    """Return the world transform (4, 4) of every node reached from the scene."""
    roots, nodes = _roots(document)
    worlds: dict[int, NDArray[np.float64]] = {}
    waiting = [(roots, IDENTITY)]
    while waiting:
        siblings, parent = waiting.pop()
        for index in siblings:
            node, pointer = document.entry("nodes", index)
            if index in worlds:
                text = "the node is reached twice; nodes form trees, without cycles and with one parent each"
                raise document.error("MESH_FILE_INVALID", pointer, text)
            local = _local_transform(document, node, pointer)
            with np.errstate(over="ignore", invalid="ignore"):
                worlds[index] = parent if local is IDENTITY else parent @ local
            waiting.append((_node_numbers(document, node, "children", pointer), worlds[index]))
    if nodes is not None and len(worlds) < nodes:
        text = "some nodes are reached from no root; nodes form trees, without cycles"
        raise document.error("MESH_FILE_INVALID", "/nodes", text)
    return worlds


def _roots(document: Document) -> tuple[list[int], int | None]:
    """Return the root nodes, and how many nodes they must reach: None where a scene chose them."""
    count = len(document.array(document.root, "nodes", ""))
    if count > MAX_NODES:
        text = f"there are {count} nodes, more than {MAX_NODES}"
        raise document.error("MESH_FILE_TOO_LARGE", "/nodes", text)
    if document.array(document.root, "scenes", ""):
        number = document.integer(document.root, "scene", "", default=0)
        scene, pointer = document.entry("scenes", number)
        return _node_numbers(document, scene, "nodes", pointer), None
    entries = (document.entry("nodes", index) for index in range(count))
    children = {child for node in entries for child in _node_numbers(document, node[0], "children", node[1])}
    return [index for index in range(count) if index not in children], count


def _node_numbers(document: Document, owner: dict[str, Any], key: str, pointer: str) -> list[int]:
    """Return `owner[key]`, an array of node numbers."""
    numbers = document.array(owner, key, pointer)
    count = len(document.array(document.root, "nodes", ""))
    for number in numbers:
        if type(number) is not int or not 0 <= number < count:
            text = f"'{shorten(str(number))}' is not the number of one of the {count} nodes"
            raise document.error("MESH_FILE_INVALID", f"{pointer}/{key}", text)
    return numbers


def _local_transform(document: Document, node: dict[str, Any], pointer: str) -> NDArray[np.float64]:
    """Return the node's own transform (4, 4): its matrix, or translation times rotation times scale."""
    if "matrix" in node:
        return document.numbers(node, "matrix", pointer, tuple(IDENTITY.ravel())).reshape(4, 4).T
    if not node.keys() & {"translation", "rotation", "scale"}:
        return IDENTITY
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
            text = "'rotation' is no rotation; a quaternion of length 1 is right"
            raise document.error("MESH_FILE_INVALID", f"{pointer}/rotation", text)
        transform = np.eye(4)
        transform[:3, :3] = rotation * document.numbers(node, "scale", pointer, (1, 1, 1))
    transform[:3, 3] = document.numbers(node, "translation", pointer, (0, 0, 0))
    return transform

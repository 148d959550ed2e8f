"""Build small mesh files in memory, in every format. Most of them contain a square."""

import base64
import io
import json
import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from PIL import Image

from msb.meshes import MESH_SUFFIXES, Mesh

Read = Callable[[bytes, str], Mesh]
"""The type of the fixture `read`: a function of content and suffix that returns the mesh."""

SQUARE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]
"""The vertices of a square; `SQUARE_FACES` are its two triangles."""

SQUARE_FACES = [[0, 1, 2], [0, 2, 3]]

XYZ = ("property float x", "property float y", "property float z")
CORNERS = "property list uchar int vertex_indices"
OBJ_SQUARE = b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
OBJ_TEXTURED = b"mtllib a.mtl\n" + OBJ_SQUARE + b"vt 0 0\nvt 1 0 0\nvt 1 1\nvt 0.25 0.75\n"
OBJ_TEXTURED += b"usemtl one\nf 1/1 2/2 3/3/1\nf -4/-1 -2/-2 -1/-3\n"
"""The square with the material "one" of a.mtl. One vertex has two texture coordinates."""
OFF_SQUARE = b"0 0 0\n1 0 0\n1 1 0\n0 1 0\n"


def assert_colors(colors: np.ndarray | None, expected: np.ndarray | None) -> None:
    """Assert that colours have the expected type and values, or that both are None."""
    assert (colors is None) == (expected is None)
    if colors is not None and expected is not None:
        assert colors.dtype == expected.dtype
        np.testing.assert_allclose(colors, expected, rtol=0, atol=1e-6)


def ply(form: str, lines: Iterable[str], body: bytes) -> bytes:
    """Return a PLY file with the header `lines` between "format" and "end_header"."""
    head = ["ply", f"format {form} 1.0", *lines, "end_header", ""]
    return "\n".join(head).encode("latin-1") + body


def ply_floats(rows: Sequence[Sequence[float]], order: str = "<") -> bytes:
    """Return rows of float32 as bytes."""
    return np.array(rows, dtype=f"{order}f4").tobytes()


def ply_faces(faces: Iterable[Sequence[int]], order: str = "<") -> bytes:
    """Return lists of int with uchar counts as bytes."""
    return b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in faces)


def ply_square(faces: Sequence[Sequence[int]] = SQUARE_FACES, order: str = "<") -> bytes:
    """Return the square as binary PLY, optionally with other faces."""
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    lines = ["element vertex 4", *XYZ, f"element face {len(faces)}", CORNERS]
    return ply(name, lines, ply_floats(SQUARE, order) + ply_faces(faces, order))


def ply_text(body: bytes, faces: int = 2, vertices: int = 4) -> bytes:
    """Return a PLY file with a text body."""
    return ply("ascii", [f"element vertex {vertices}", *XYZ, f"element face {faces}", CORNERS], body)


def off(header: bytes, *blocks: bytes) -> bytes:
    """Return an OFF file."""
    return header + b"\n" + b"".join(blocks)


def stl_binary(
    triangles: Sequence[Any], count: int | None = None, header: bytes = b"made by a test"
) -> bytes:
    """Return binary STL. `count` is the number of faces in the header."""
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *np.ravel(rows).tolist(), 0) for rows in triangles)
    declared = len(triangles) if count is None else count
    return header.ljust(80, b"\0") + struct.pack("<I", declared) + body


def stl_facet(corners: Sequence[str] = ("0 0 0", "1 0 0", "0 1 0")) -> bytes:
    """Return one face of a text STL."""
    lines = ["facet normal 0 0 1", "outer loop", *(f"vertex {corner}" for corner in corners)]
    return ("\n".join([*lines, "endloop", "endfacet", ""])).encode("ascii")


def stl_text(*facets: bytes, name: bytes = b"part") -> bytes:
    """Return a text STL of one solid."""
    return b"solid " + name + b"\n" + b"".join(facets) + b"endsolid " + name + b"\n"


class Glb:
    """A GLB under construction. Tests may change its JSON, `root`, before they call `bytes`."""

    def __init__(self) -> None:
        self.binary = b""
        self.root: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": []}],
            "accessors": [],
            "bufferViews": [],
            "buffers": [{}],
        }

    def view(self, data: bytes, **more: Any) -> int:
        """Append bytes to the binary chunk, and return the number of their buffer view."""
        entry = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data), **more}
        self.root["bufferViews"].append(entry)
        self.binary += data + b"\0" * (-len(data) % 4)
        self.root["buffers"][0]["byteLength"] = len(self.binary)
        return len(self.root["bufferViews"]) - 1

    def accessor(self, values: Any, dtype: str, kind: str, **more: Any) -> int:
        """Append an array, and return the number of its accessor."""
        component = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}[dtype]
        array = np.array(values, dtype=f"<{dtype}")
        entry = {"bufferView": self.view(array.tobytes()), "componentType": component, "type": kind}
        self.root["accessors"].append({**entry, "count": len(array), **more})
        return len(self.root["accessors"]) - 1

    def primitive(self, position: int, indices: int | None = None, mesh: int = 0, **more: Any) -> None:
        """Append a primitive to a mesh."""
        attributes = {"POSITION": position, **more.pop("attributes", {})}
        entry = {"attributes": attributes, **more}
        if indices is not None:
            entry["indices"] = indices
        meshes = self.root["meshes"]
        meshes.extend({"primitives": []} for _ in range(mesh + 1 - len(meshes)))
        meshes[mesh]["primitives"].append(entry)

    def material(self, image: bytes | str | None = None, primitive: int = 0, **more: Any) -> dict[str, Any]:
        """Add a material with a texture to a primitive of mesh 0, and return it. The image is bytes or a URI.

        `more` are further properties. Tests may change the base colour of the returned object.
        """
        surface: dict[str, Any] = {}
        material = {"pbrMetallicRoughness": surface, **more}
        if image is not None:
            entry = {"bufferView": self.view(image)} if isinstance(image, bytes) else {"uri": image}
            surface["baseColorTexture"] = {"index": self.add("textures", source=self.add("images", **entry))}
        entry = self.root["meshes"][0]["primitives"][primitive]
        entry["material"] = len(self.root.setdefault("materials", []))
        self.root["materials"].append(material)
        return material

    def add(self, table: str, **entry: Any) -> int:
        """Append an entry to an array of the JSON, and return its number."""
        self.root.setdefault(table, []).append(entry)
        return len(self.root[table]) - 1

    def text(self, uri: str | None = None) -> bytes:
        """Return the file as .gltf. Its buffer is embedded, or in the linked file `uri`."""
        data = "data:application/octet-stream;base64," + base64.b64encode(self.binary).decode()
        buffers = [self.root["buffers"][0] | {"uri": uri or data}, *self.root["buffers"][1:]]
        return json.dumps(self.root | {"buffers": buffers}).encode()

    def bytes(self) -> bytes:
        """Return the file."""
        return glb_file(json.dumps(self.root).encode("utf-8"), self.binary)


def glb_square(
    mode: int | None = None, indices: Sequence[int] = (0, 1, 2, 0, 2, 3), dtype: str = "u2"
) -> Glb:
    """Return the square as one primitive."""
    glb = Glb()
    position = glb.accessor(SQUARE, "f4", "VEC3")
    glb.primitive(
        position, glb.accessor(indices, dtype, "SCALAR"), **({} if mode is None else {"mode": mode})
    )
    return glb


UVS = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]]
"""Texture coordinates of the square. The first vertex is at the lower left corner of the image."""
TEXELS = np.uint8([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [9, 90, 200]]])


def picture(texels: Any = TEXELS, kind: str = "PNG", **more: Any) -> bytes:
    """Return texels as an image file."""
    stream = io.BytesIO()
    Image.fromarray(np.asarray(texels)).save(stream, kind, **more)
    return stream.getvalue()


def glb_textured(image: bytes | str | None = None, **material: Any) -> Glb:
    """Return the square with texture coordinates and a textured material."""
    glb = glb_square()
    glb.root["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = glb.accessor(UVS, "f4", "VEC2")
    glb.material(picture() if image is None else image, **material)
    return glb


def glb_file(text: bytes, binary: bytes = b"", version: int = 2) -> bytes:
    """Return a GLB with a JSON chunk and a binary chunk."""
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", version, 12 + len(chunks)) + chunks


SMALL = {
    ".ply": ply_square(),
    ".PLY": ply_text(OFF_SQUARE + b"3 0 1 2\n4 0 1 2 3\n"),
    ".obj": OBJ_SQUARE + b"vt 0 0\nf 1/1 2/1 3/1\nf -4 -2 -1\n",
    ".OBJ": OBJ_TEXTURED,
    ".off": off(
        b"COFF", b"4 2 0\n", OFF_SQUARE.replace(b"\n", b" 255 0 0 255\n"), b"3 0 1 2\n3 0 2 3 0.5 0 0\n"
    ),
    ".stl": stl_binary([SQUARE[:3], SQUARE[1:]]),
    ".STL": stl_text(stl_facet(), stl_facet()),
    ".glb": glb_square().bytes(),
    ".GLB": glb_textured().bytes(),
    ".gltf": glb_textured().text(),
}
"""A small valid file for each reader.

A suffix in capitals marks a variant of the file: text instead of binary, or with a texture.
"""
SUFFIXES = [suffix for suffix in MESH_SUFFIXES if not suffix.startswith(".usd")]
"""The formats with a reader in Python. USD formats are tested in `test_usd.py`."""

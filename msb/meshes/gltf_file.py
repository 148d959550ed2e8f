"""glTF 2.0: GLB, all in one binary file, and JSON, whose buffers and images lie beside it or in its text.

JSON is only read.
"""

from __future__ import annotations

import re

from msb.errors import shorten
from msb.meshes.formats import Format
from msb.meshes.glb_write import write
from msb.meshes.gltf import document_of, open_document
from msb.meshes.gltf_scene import read_scene
from msb.meshes.mesh import Mesh
from msb.meshes.source import Source

_BEGINS = re.compile(rb"\s*\{")


def _read_glb(source: Source) -> Mesh:
    """Read what a binary file shows."""
    return read_scene(open_document(source))


def _read_gltf(source: Source) -> Mesh:
    """Read what a file of JSON shows."""
    if _BEGINS.match(source.data) is None:
        raise source.not_a("glTF", "it does not begin with '{'")
    document = document_of(source, source.data)
    version = str(document.object(document.root, "asset", "").get("version", "2.0"))
    if not version.startswith("2."):
        text = f"version {shorten(version)} is not read; 2.0 is"
        raise document.error("MESH_FILE_UNSUPPORTED", "/asset/version", text)
    return read_scene(document)


FORMATS = (
    Format(
        "glTF",
        (".gltf",),
        _read_gltf,
        begins=_BEGINS,
        keeps=("vertex_colors", "vertex_uvs"),
        is_single=True,
        up="+y",
    ),
    Format(
        "GLB",
        (".glb",),
        _read_glb,
        write,
        begins=re.compile(rb"glTF"),
        keeps=("vertex_colors", "vertex_uvs", "textures"),
        is_single=True,
        is_linear=True,
        up="+y",
    ),
)

"""GLB: glTF 2.0 in one binary file."""

from __future__ import annotations

import re

from msb.meshes.formats import Format
from msb.meshes.glb_write import write
from msb.meshes.gltf import open_document
from msb.meshes.gltf_scene import read_scene
from msb.meshes.mesh import Mesh
from msb.meshes.source import Source


def read(source: Source) -> Mesh:
    """Read what the file shows."""
    return read_scene(open_document(source))


FORMAT = Format(
    "GLB",
    (".glb",),
    read,
    write,
    begins=re.compile(rb"glTF"),
    keeps=("vertex_colors", "vertex_uvs", "textures"),
    is_single=True,
    is_linear=True,
    up="+y",
)

"""Open any mesh file as a glTF document. glTF files stay as they are, all others are written as GLB first."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

from msb.adapters.locate import is_mesh_file
from msb.api.opening import open as open_asset
from msb.base.files import read_file
from msb.errors import MeshError, MeshFileError
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import fit_to_format, mesh_from_asset, without_bad_faces
from msb.meshes.formats import Style
from msb.meshes.glb_write import write
from msb.meshes.gltf import Document, open_document
from msb.meshes.gltf_scene import open_text_document
from msb.meshes.normals import with_smooth_normals
from msb.meshes.source import Source


def open_as_gltf(path: Path) -> tuple[Document, list[str]]:
    """Return a mesh file, checkpoint or asset as a glTF document, and notes on what was not read.

    Meshes of other formats get smooth normals, with creases, and lit materials. Assets stay unlit, because
    their colours contain the light.
    """
    if path.suffix.lower() in (".glb", ".gltf") and is_mesh_file(path):
        try:
            source = Source(str(path), read_file(path))
            if not source.data:
                raise source.error("MESH_FILE_INVALID", "the file is empty")
            is_binary = path.suffix.lower() == ".glb"
            return (open_document if is_binary else open_text_document)(source), []
        except MemoryError:
            text = "not enough memory to read the file"
            raise MeshFileError("MESH_FILE_TOO_LARGE", text, file=str(path)) from None
    notes: list[str] = []
    if is_mesh_file(path):
        mesh, bad = without_bad_faces(read_mesh(path))
        notes += [f"{bad:,} faces have coordinates that are not finite; they are left out"] if bad else []
        notes += [f"not read: {', '.join(mesh.left_out)}"] if mesh.left_out else []
        return open_mesh(mesh, is_lit=True), notes
    return open_mesh(mesh_from_asset(open_asset(path)), is_lit=False), notes


def open_mesh(mesh: Mesh, *, is_lit: bool) -> Document:
    """Return a mesh as a glTF document."""
    if not len(mesh.faces):
        raise MeshError("MESH_ARRAY", "the file has no triangles, so there is nothing to reduce")
    shaped = with_smooth_normals(mesh) if is_lit else mesh
    file = io.BytesIO()
    write(fit_to_format(replace(shaped, left_out=()), ".glb"), file, Style(is_lit=is_lit))
    return open_document(Source("mesh.glb", file.getvalue()))

"""Meshes written as Wavefront OBJ, with materials and images in files beside it."""

from __future__ import annotations

from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.meshes.formats import Style
from msb.meshes.image_files import images_of, plain_stem
from msb.meshes.mesh import Mesh
from msb.meshes.writing import write_rows


def write(mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write `v`, `vt` and `f` lines; float32 and float64 coordinates read back as exactly the same number.

    Colours are written after the coordinates, as 0..1 with nine digits. A textured mesh names its materials
    if the style says what files beside it are called.
    """
    columns, form = mesh.vertices, "v %r %r %r"
    if mesh.vertex_colors is not None:
        colors: NDArray[Any] = mesh.vertex_colors
        if colors.dtype == np.uint8:
            colors = colors / 255
        columns = np.column_stack((columns, colors))
        form += " %.9g" * colors.shape[1]
    has_materials = bool(mesh.textures) and style.stem is not None
    if has_materials:
        stream.write(f"mtllib {plain_stem(style)}.mtl\n".encode())
    write_rows(stream, form, columns)
    faces, form = mesh.faces + 1, "f %d %d %d"
    if mesh.vertex_uvs is not None or mesh.corner_uvs is not None:
        rows, numbers = _coordinates(mesh)
        write_rows(stream, "vt %r %r", np.column_stack((rows[:, 0], 1 - rows[:, 1].astype(np.float64))))
        faces = np.stack((faces, numbers + 1), axis=2).reshape(-1, 6)
        form = "f %d/%d %d/%d %d/%d"
    if not has_materials:
        write_rows(stream, form, faces)
        return
    shown = np.zeros(len(faces), np.uint32) if mesh.face_textures is None else mesh.face_textures
    starts = np.flatnonzero(np.diff(shown, prepend=-1)) if len(faces) else np.zeros(0, np.intp)
    for start, end in zip(starts, [*starts[1:], len(faces)], strict=True):
        stream.write(b"usemtl texture_%d\n" % shown[start])
        write_rows(stream, form, faces[start:end])


def _coordinates(mesh: Mesh) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the different texture coordinates (N, 2), and which of them each corner (F, 3) has."""
    if mesh.corner_uvs is None:
        assert mesh.vertex_uvs is not None
        return mesh.vertex_uvs, mesh.faces
    bits = np.ascontiguousarray(mesh.corner_uvs).view(np.uint64)[:, 0]
    _, first, numbers = np.unique(bits, return_index=True, return_inverse=True)
    return mesh.corner_uvs[first], numbers.reshape(-1, 3)


def beside(mesh: Mesh, style: Style) -> dict[str, bytes]:
    """Return the files that an OBJ of `mesh` needs beside it, by name: its materials and their images."""
    if not mesh.textures:
        return {}
    images, materials = images_of(mesh, style), []
    for number, name in enumerate(images):
        cut_off = f"map_d {name}\n" if mesh.sampler.alpha_cutoff is not None else ""
        # Constant colour, which asks for no light.
        materials.append(f"newmtl texture_{number}\nKd 1 1 1\nKs 0 0 0\nillum 0\nmap_Kd {name}\n{cut_off}")
    return images | {f"{plain_stem(style)}.mtl": "\n".join(materials).encode()}

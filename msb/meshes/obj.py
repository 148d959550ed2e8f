"""Wavefront OBJ: polygon meshes as text, with materials and images in additional files."""

from dataclasses import dataclass, field, replace
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.meshes.colors import stored_colors
from msb.meshes.formats import Format, Style
from msb.meshes.image_files import encode_images, name_images, simplify_stem
from msb.meshes.mesh import Mesh
from msb.meshes.obj_colors import choose_materials, list_lost, list_stored
from msb.meshes.obj_keys import read_corner_keys
from msb.meshes.obj_materials import (
    CUTOFF,
    names_materials,
    select_face_lines,
    with_coordinates,
    with_materials,
)
from msb.meshes.polygons import find_wrong_polygon, triangulate
from msb.meshes.source import Source
from msb.meshes.text import Words, word_blocks
from msb.meshes.writing import write_rows

# Number of colour channels in a `v` line. The key is the number of values in the line.
_COLOR_WIDTHS = {6: 3, 7: 4}

# Names of data that is not read, by the first word of the line.
_LEFT_OUT = {b"vn": "normals", b"vt": "UVs", b"usemtl": "materials and their textures", b"l": "lines"}

# First words of lines that are rejected. Such lines contain free-form surfaces, other files or shell
# commands.
_UNSUPPORTED = (b"surf", b"call", b"csh")


@dataclass
class _Parts:
    """The arrays of all blocks that have been read so far."""

    vertex_count: int = 0
    vertices: list[NDArray[np.float64]] = field(default_factory=list)
    colors: list[NDArray[np.float64]] = field(default_factory=list)
    color_widths: set[int] = field(default_factory=set)
    corners: list[NDArray[np.int64]] = field(default_factory=list)
    counts: list[NDArray[np.int64]] = field(default_factory=list)
    left_out: set[bytes] = field(default_factory=set)


def read(source: Source) -> Mesh:
    """Read `v` and `f` lines, and also `vt` and `usemtl` lines if materials have images or colours.

    Vertices are float64. Colours are read from `v x y z r g b [a]` lines if all `v` lines have colours.
    """
    # Join lines that end with a backslash. Spaces replace the joined line ends, so that byte offsets stay
    # valid.
    text = source.as_text("OBJ")
    if b"\\" in text.data:
        joined = text.data.replace(b"\\\r\n", b"   ").replace(b"\\\n", b"  ")
        text = replace(text, data=joined, lines=text.data)
    parts = _Parts()
    for words in word_blocks(text, comments=True):
        _reject_unsupported(words)
        is_vertex = words.lines_beginning(b"v")
        _add_faces(parts, words, is_vertex)
        _add_vertices(parts, words, is_vertex)
        parts.left_out |= {
            word for word in _LEFT_OUT.keys() - parts.left_out if words.lines_beginning(word).any()
        }
    if not parts.vertex_count:
        raise source.not_a("OBJ", "there is no 'v x y z' line")
    vertices, corners = np.concatenate(parts.vertices), np.concatenate(parts.corners)
    cut = triangulate(vertices, corners, np.concatenate(parts.counts))
    faces = corners[cut.order]
    wrong = find_wrong_polygon(faces, cut.polygon, parts.vertex_count)
    wrong_face = None if wrong is None else _describe_wrong_face(text, *wrong, parts.vertex_count)
    colors = None
    if parts.color_widths in ({3}, {4}):
        colors = stored_colors(np.concatenate(parts.colors))
    mesh = Mesh(vertices, faces, colors, wrong_face=wrong_face)
    more: dict[str, None] = {}
    if names_materials(text):
        if source.images:
            mesh, more = with_materials(mesh, text, cut)
        elif b"vt" in parts.left_out:
            mesh = with_coordinates(mesh, text, cut)
        parts.left_out -= {b"usemtl", b"vt"} if mesh.textures or not source.images else {b"usemtl"}
    if wrong is None and parts.left_out & {b"vn", b"vt"}:
        mesh = replace(mesh, corner_keys=read_corner_keys(mesh, text, cut))
    left_out = [what for word, what in _LEFT_OUT.items() if word in parts.left_out]
    return replace(mesh, left_out=(*left_out, *more, *cut.left_out))


def _reject_unsupported(words: Words) -> None:
    """Raise MESH_FILE_UNSUPPORTED for the first line that begins with a word of `_UNSUPPORTED`."""
    for keyword in _UNSUPPORTED:
        lines = np.flatnonzero(words.lines_beginning(keyword))
        if lines.size:
            name = keyword.decode()
            text = f"'{name}' is not supported; only polygons ('f' lines) in a single file can be read"
            raise words.line_error("MESH_FILE_UNSUPPORTED", int(lines[0]), text)


def _add_vertices(parts: _Parts, words: Words, is_vertex: NDArray[np.bool_]) -> None:
    """Append the vertices of the lines selected by `is_vertex` (L,)."""
    widths = words.count[is_vertex] - 1
    wrong = np.flatnonzero((widths < 3) | (widths > 7) | (widths == 5))
    if wrong.size:
        line = int(np.flatnonzero(is_vertex)[wrong[0]])
        text = f"'v' has {widths[wrong[0]]} numbers; write x y z, x y z w, x y z r g b or x y z r g b a"
        raise words.line_error("MESH_FILE_INVALID", line, text)
    values = words.numbers(words.arguments(is_vertex))
    first = np.cumsum(widths) - widths
    parts.vertices.append(values[first[:, None] + np.arange(3)])
    parts.vertex_count += len(widths)
    # Keep the colours of a block if its lines have equal numbers of channels. The colours are used if all
    # blocks have this number of channels.
    widths_here = {_COLOR_WIDTHS.get(width, 0) for width in np.unique(widths).tolist()}
    parts.color_widths |= widths_here
    if widths_here in ({3}, {4}):
        parts.colors.append(values.reshape(len(widths), -1)[:, 3:])


def _add_faces(parts: _Parts, words: Words, is_vertex: NDArray[np.bool_]) -> None:
    """Append the polygons of the `f` and `fo` lines.

    The argument `is_vertex` (L,) selects the `v` lines. Negative indices count backwards from the last
    preceding `v` line.
    """
    is_face = select_face_lines(words)
    chosen = words.arguments(is_face)
    above = parts.vertex_count + np.cumsum(is_vertex)
    parts.corners.append(words.without_suffix(b"/").indices(chosen, above, "vertex"))
    parts.counts.append(words.count[is_face] - 1)


def _describe_wrong_face(text: Source, polygon: int, index: int, vertices: int) -> str:
    """Parse the file again to find a polygon with an invalid index. Return the text for `Mesh.wrong_face`."""
    for words in word_blocks(text, comments=True):
        lines = np.flatnonzero(select_face_lines(words))
        if polygon < len(lines):
            byte = words.base + int(words.start[words.first[lines[polygon]]])
            return text.wrong_index(byte, index, vertices, first=1)
        polygon -= len(lines)
    raise AssertionError


def write(mesh: Mesh, stream: BinaryIO, style: Style) -> None:
    """Write `v`, `vt` and `f` lines. Coordinates are exact when the file is read again.

    Colours follow the coordinates as numbers from 0 to 1 with nine digits. A textured mesh refers to its
    materials if the style has a stem for additional files.
    """
    if mesh.placement is not None:
        stream.write(f"# {mesh.placement.comment}\n".encode())
    has_materials = bool(mesh.textures) and style.stem is not None
    if has_materials:
        stream.write(f"mtllib {simplify_stem(style)}.mtl\n".encode())
        mesh, _, of_face = choose_materials(mesh)
    columns, form = mesh.vertices, "v %r %r %r"
    if mesh.vertex_colors is not None:
        colors: NDArray[Any] = mesh.vertex_colors
        if colors.dtype == np.uint8:
            colors = colors / 255
        columns = np.column_stack((columns, colors))
        form += " %.9g" * colors.shape[1]
    write_rows(stream, form, columns)
    # Collect the indices (F, 3) of vertices, texture coordinates and normals.
    indices, corner = [mesh.faces + 1], "%d"
    if mesh.vertex_uvs is not None or mesh.corner_uvs is not None:
        rows, numbers = _index_coordinates(mesh)
        write_rows(stream, "vt %r %r", np.column_stack((rows[:, 0], 1 - rows[:, 1].astype(np.float64))))
        indices.append(numbers + 1)
        corner = "%d/%d"
    if mesh.corner_normals is not None:
        normals, numbers = np.unique(mesh.corner_normals, axis=0, return_inverse=True)
        write_rows(stream, "vn %.6g %.6g %.6g", normals)
        indices.append(numbers.reshape(-1, 3) + 1)
        corner += "/%d" if len(indices) == 3 else "//%d"
    faces, form = np.stack(indices, axis=2).reshape(-1, 3 * len(indices)), " ".join(["f", *[corner] * 3])
    if not has_materials:
        write_rows(stream, form, faces)
        return
    # Write a `usemtl` line if the material differs from the material of the previous face.
    starts = np.flatnonzero(np.diff(of_face, prepend=-1)) if len(faces) else np.zeros(0, np.intp)
    for start, end in zip(starts, [*starts[1:], len(faces)], strict=True):
        stream.write(b"usemtl material_%d\n" % of_face[start])
        write_rows(stream, form, faces[start:end])


def _index_coordinates(mesh: Mesh) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return the distinct texture coordinates (N, 2), and the index (F, 3) of the coordinates of each
    corner.
    """
    if mesh.corner_uvs is None:
        assert mesh.vertex_uvs is not None
        return mesh.vertex_uvs, mesh.faces
    bits = np.ascontiguousarray(mesh.corner_uvs).view(np.uint64)[:, 0]
    _, first, numbers = np.unique(bits, return_index=True, return_inverse=True)
    return mesh.corner_uvs[first], numbers.reshape(-1, 3)


def companions(mesh: Mesh, style: Style) -> dict[str, bytes]:
    """Return the additional files of an OBJ file, as a mapping from name to content. These are the MTL file
    and its images."""
    if not mesh.textures:
        return {}
    _, chosen, _ = choose_materials(mesh)
    names = name_images(mesh, style)
    images = encode_images(mesh, style, {part.texture for part in chosen if part.texture is not None})
    materials = []
    for number, material in enumerate(chosen):
        # In MTL, illum 0 is a constant colour without lighting, and illum 1 is diffuse light without
        # highlights.
        lines = [f"newmtl material_{number}", "Kd {:.6g} {:.6g} {:.6g}".format(*material.color)]
        lines += ["Ks 0 0 0", f"illum {int(style.is_lit)}"]
        if material.texture is not None:
            name, image = names[material.texture], mesh.textures[material.texture]
            lines += [f"map_Kd {name}"]
            if mesh.sampler.alpha_cutoff is not None and image.shape[2] == 4:
                lines += [f"# {CUTOFF} {mesh.sampler.alpha_cutoff!r}", f"map_d {name}"]
        materials.append("\n".join(lines) + "\n")
    return images | {f"{simplify_stem(style)}.mtl": "\n".join(materials).encode()}


FORMAT = Format(
    "OBJ",
    (".obj",),
    read,
    write,
    companions=companions,
    keeps=("vertex_colors", "normals", "textures"),
    list_stored=list_stored,
    list_lost=list_lost,
)

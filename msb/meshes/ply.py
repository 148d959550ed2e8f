"""The Stanford polygon format PLY, as text and as binary in both byte orders."""

import re
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.base.seam_keys import hash_attributes
from msb.errors import shorten
from msb.meshes.colors import stored_colors
from msb.meshes.formats import Format, Style
from msb.meshes.mesh import Mesh
from msb.meshes.ply_body import Body, Rows, open_body
from msb.meshes.ply_header import TYPES, Element, Header, read_header
from msb.meshes.ply_textures import list_read_properties, with_textures
from msb.meshes.polygons import find_wrong_polygon, triangulate
from msb.meshes.source import Source
from msb.meshes.writing import ROWS_AT_A_TIME

_INDEX_NAMES = ("vertex_indices", "vertex_index")
_COLOR_NAMES = (
    ("red", "green", "blue", "alpha"),
    ("diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"),
)
_READ = {"x", "y", "z", *_INDEX_NAMES, *(name for names in _COLOR_NAMES for name in names)}
_MAX_INT = 2**31 - 1
_UVS = ("s", "t", "u", "v", "texture_u", "texture_v", "texcoord", "texnumber")
# Names of unread data, by the properties that belong to them.
_KNOWN = {"nx": "normals", "ny": "normals", "nz": "normals", **dict.fromkeys(_UVS, "UVs")}


def read(source: Source) -> Mesh:
    """Read the vertex and face elements. Other elements and properties are skipped.

    Vertices are float32 if a binary file stores x, y and z as float. Otherwise, vertices are float64. Text is
    always read as float64 and keeps all digits, independent of the declared type.
    """
    header = read_header(source)
    _check_elements(source, header)
    body = open_body(source, header)
    rows = {element.name: body.next_rows(element) for element in header.elements}
    body.finish()
    vertices = rows["vertex"]
    vertex_colors = _read_colors(vertices, body)
    read = _READ | list_read_properties(header)
    left_out = _list_left_out(header, read)
    if "face" not in rows or not rows["face"].element.count:
        no_faces = np.zeros((0, 3), dtype=np.int64)
        return Mesh(_read_positions(vertices, body), no_faces, vertex_colors, left_out=left_out)
    faces = rows["face"]
    counts, corners = body.indices(faces, _find_index_list(faces.element))
    positions = _read_positions(vertices, body)
    cut = triangulate(positions, corners, counts)
    triangles = corners[cut.order]
    wrong = find_wrong_polygon(triangles, cut.polygon, vertices.element.count)
    wrong_face = None if wrong is None else body.wrong_face(faces, *wrong, vertices.element.count)
    face_colors = _read_colors(faces, body)
    if face_colors is not None:
        face_colors = face_colors[cut.polygon]
    left_out = (*left_out, *cut.left_out)
    keys = _hash_unread(vertices, body, read)
    mesh = Mesh(
        positions,
        triangles,
        vertex_colors,
        face_colors,
        vertex_keys=keys,
        left_out=left_out,
        wrong_face=wrong_face,
    )
    if not header.images:
        return mesh
    return with_textures(mesh, source, header.images, body, (vertices, faces), counts, cut)


def write(mesh: Mesh, stream: BinaryIO, _style: Style) -> None:
    """Write binary little-endian PLY. Vertices and colours keep their number types.

    Indices are `int`, which every reader supports. If there are too many vertices, indices are `uint`.
    """
    coordinate = "double" if mesh.vertices.dtype == np.float64 else "float"
    index = "int" if len(mesh.vertices) <= _MAX_INT else "uint"
    lines = ["ply", "format binary_little_endian 1.0", "comment written by MeshSplatBench"]
    lines += [f"comment {mesh.placement.comment}"] if mesh.placement is not None else []
    lines += [f"element vertex {len(mesh.vertices)}"]
    lines += [f"property {coordinate} {axis}" for axis in "xyz"]
    lines += _declare_colors(mesh.vertex_colors)
    lines += [f"element face {len(mesh.faces)}", f"property list uchar {index} vertex_indices"]
    lines += _declare_colors(mesh.face_colors)
    lines += ["end_header\n"]
    stream.write("\n".join(lines).encode("ascii"))
    _write_records(stream, None, mesh.vertices, "<" + TYPES[coordinate], mesh.vertex_colors)
    _write_records(stream, 3, mesh.faces, "<" + TYPES[index], mesh.face_colors)


def _declare_colors(colors: NDArray[Any] | None) -> list[str]:
    """Return the header lines for colours (N, 3 | 4)."""
    if colors is None:
        return []
    kind = "uchar" if colors.dtype == np.uint8 else "float"
    return [f"property {kind} {name}" for name in _COLOR_NAMES[0][: colors.shape[1]]]


def _write_records(
    stream: BinaryIO, count: int | None, values: NDArray[Any], kind: str, colors: NDArray[Any] | None
) -> None:
    """Write all rows in binary form.

    A row contains the list count, then `values` (N, 3), then `colors` (N, 3 | 4). If the count is None, rows
    have no list count.
    """
    fields: list[tuple[Any, ...]] = [("values", kind, 3)]
    if count is not None:
        fields.insert(0, ("count", "u1"))
    if colors is not None:
        fields.append(("colors", colors.dtype.newbyteorder("<"), colors.shape[1]))
    for start in range(0, len(values), ROWS_AT_A_TIME):
        part = slice(start, start + ROWS_AT_A_TIME)
        records = np.zeros(len(values[part]), dtype=fields)
        records["values"] = values[part]
        if count is not None:
            records["count"] = count
        if colors is not None:
            records["colors"] = colors[part]
        stream.write(records.tobytes())


def _hash_unread(vertices: Rows, body: Body, read: set[str]) -> NDArray[np.uint32] | None:
    """Return the seam keys (V,). The keys are computed from the vertex properties that are not in `read`.

    Return None if all properties are in `read`.
    """
    names = [
        entry.name for entry in vertices.element.properties if entry.name not in read and not entry.count_type
    ]
    return hash_attributes(body.column(vertices, name) for name in names) if names else None


def _list_left_out(header: Header, read: set[str]) -> tuple[str, ...]:
    """Return the names of skipped vertex and face properties and of skipped elements."""
    parts: dict[str, None] = {}
    for element in (candidate for candidate in header.elements if candidate.count):
        if element.name not in ("vertex", "face"):
            parts[f"element {shorten(element.name, 30)}"] = None
            continue
        for name in (entry.name for entry in element.properties if entry.name not in read):
            parts[_KNOWN.get(name, f"property {shorten(name, 30)}")] = None
    return tuple(parts)


def _check_elements(source: Source, header: Header) -> None:
    """Raise an error unless the header declares a triangle or polygon mesh."""
    elements = {element.name: element for element in header.elements}
    strips = elements.get("tristrips")
    if strips is not None and strips.count:
        text = "triangle strips (element 'tristrips') are not supported; save triangles instead"
        raise source.error("MESH_FILE_UNSUPPORTED", text)
    if "vertex" not in elements:
        raise source.error("MESH_FILE_INVALID", "the header has no element 'vertex'")
    for axis in "xyz":
        property_ = elements["vertex"].find(axis)
        if property_ is None or property_.count_type:
            text = f"element 'vertex' has no scalar property '{axis}'"
            raise source.error("MESH_FILE_INVALID", text)
    face = elements.get("face")
    if face is not None and face.count and not _find_index_list(face):
        text = "element 'face' has no integer list 'vertex_indices' or 'vertex_index'"
        raise source.error("MESH_FILE_INVALID", text)


def _find_index_list(face: Element) -> str:
    """Return the name of the list of vertex indices. Return "" if there is no such list."""
    for name in _INDEX_NAMES:
        property_ = face.find(name)
        if property_ is not None and property_.count_type and np.dtype(property_.type).kind in "iu":
            return name
    return ""


def _read_positions(rows: Rows, body: Body) -> NDArray[Any]:
    """Return the coordinates (V, 3) in the precision of the file."""
    columns = [body.column(rows, axis) for axis in "xyz"]
    single = all(column.dtype == np.float32 for column in columns)
    return np.stack(columns, axis=1, dtype=np.float32 if single else np.float64)


def _read_colors(rows: Rows, body: Body) -> NDArray[Any] | None:
    """Return the colours (N, 3 | 4) of the rows, or None if the element has no colours."""
    for names in _COLOR_NAMES:
        channels = [rows.element.find(name) for name in names]
        if any(channel is None or channel.count_type for channel in channels[:3]):
            continue
        width = 3 if channels[3] is None or channels[3].count_type else 4
        values = np.stack([body.column(rows, name) for name in names[:width]], axis=1)
        # Numbers in text were parsed as float64. Convert the numbers to the declared integer type.
        declared = np.result_type(*(channel.type for channel in channels[:width] if channel))
        if values.dtype.kind == "f" and declared.kind != "f":
            values = np.clip(np.nan_to_num(values), 0, np.iinfo(declared).max).astype(declared)
        return stored_colors(values)
    return None


FORMAT = Format(
    "PLY", (".ply",), read, write, begins=re.compile(rb"ply[\r\n]"), keeps=("vertex_colors", "face_colors")
)

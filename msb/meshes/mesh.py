"""The arrays of a mesh file in memory."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.frame import Frame
from msb.asset.texture import Sampler
from msb.base.origin import describe_origin, find_origin, round_coordinates
from msb.base.seam_keys import SEAM_KEY, TRIANGLE_LIST
from msb.errors import Finding, MeshError, finding

if TYPE_CHECKING:
    from msb.meshes.placement import Placement

# Rounding is measured at this number of faces, which are evenly spread over all faces.
_SAMPLED_FACES = 200_000
# Limit for reporting a rounding error, relative to the size of a typical face. At this limit, rounding turns
# normals by 0.1 degrees.
_SEEN = 1e-3


@dataclass(frozen=True, eq=False)
class Mesh:
    """The triangles of one file, with all vertices and faces in the order of the file.

    Parameters
    ----------
    vertices : (V, 3) float32 or float64
        Positions in the precision of the file. Positions are in metres if the file states its unit.
        Otherwise, positions are in the unit of the file. Unused vertices and non-finite coordinates are
        included.
    faces : (F, 3) int64
        Vertex indices as stored. Indices may be out of range (negative, or V and more), which an audit
        reports.
    vertex_colors : (V, 3) or (V, 4) uint8 or float32 in [0, 1], optional
        The value is None if the file has no vertex colours.
    face_colors : (F, 3) or (F, 4) uint8 or float32 in [0, 1], optional
        One row per triangle.
    vertex_uvs : (V, 2) float32, optional
        Texture coordinates, v downwards as in glTF.
    corner_uvs : (3F, 2) float32, optional
        Texture coordinates per face corner, for formats that store them per corner. A mesh has either
        `corner_uvs` or `vertex_uvs`.
    vertex_keys, corner_keys : (V,), (3F,) uint32, optional
        For each vertex or corner, a hash of the attributes that the reader ignores, such as normals and
        tangents (`msb.base.seam_keys.hash_attributes`). Seam keys explain duplicated vertices, and are not
        written.
    corner_normals : (3F, 3) float32, optional
        Unit normals per face corner, for writing only (`msb.meshes.normals`).
    textures : tuple of (H, W, 3) or (H, W, 4) uint8
        sRGB images. The images are multiplied with the colours in linear light.
    face_textures : (F,) uint32, optional
        The texture index of each face. The value is None if there are fewer than two textures.
    sampler : Sampler
        Filter, wrap modes and alpha cut-off of the textures.
    left_out : tuple of str
        Parts of the file that were not read, such as "normals", "UVs" or "2 textures".
    up : str, optional
        The axis that points up, such as "+y". The value is None if the axis is unknown.
    meters_per_unit : float, optional
        The length of the file's unit in metres. The positions were multiplied by this length. The value is
        None if the unit is unknown.
    frame : Frame, optional
        The precise up direction, the unit and the floor of the capture that the positions belong to. The
        value is None if only `up` is known.
    placement : Placement, optional
        The rotation and scale of the positions for a file (`msb.meshes.placement`).
    wrong_face : str, optional
        For text files: a text about the first face with an invalid vertex index, with its line number.

    Raises
    ------
    MeshError
        MESH_ARRAY: an array has the wrong shape or type.
    """

    vertices: NDArray[Any]
    faces: NDArray[np.int64]
    vertex_colors: NDArray[Any] | None = None
    face_colors: NDArray[Any] | None = None
    vertex_uvs: NDArray[np.float32] | None = None
    corner_uvs: NDArray[np.float32] | None = None
    vertex_keys: NDArray[np.uint32] | None = None
    corner_keys: NDArray[np.uint32] | None = None
    corner_normals: NDArray[np.float32] | None = None
    textures: tuple[NDArray[np.uint8], ...] = ()
    face_textures: NDArray[np.uint32] | None = None
    sampler: Sampler = field(default_factory=Sampler)
    left_out: tuple[str, ...] = ()
    up: str | None = None
    meters_per_unit: float | None = None
    frame: Frame | None = None
    placement: Placement | None = None
    wrong_face: str | None = None

    def __post_init__(self) -> None:
        _check("vertices", self.vertices, None, (3,), (np.float32, np.float64))
        _check("faces", self.faces, None, (3,), (np.int64,))
        vertices, faces, colors = len(self.vertices), len(self.faces), (np.uint8, np.float32)
        _check("vertex_colors", self.vertex_colors, vertices, (3, 4), colors)
        _check("face_colors", self.face_colors, faces, (3, 4), colors)
        _check("vertex_uvs", self.vertex_uvs, vertices, (2,), (np.float32,))
        _check("corner_uvs", self.corner_uvs, 3 * faces, (2,), (np.float32,))
        _check("corner_normals", self.corner_normals, 3 * faces, (3,), (np.float32,))
        for name, keys, rows in (
            ("vertex_keys", self.vertex_keys, vertices),
            ("corner_keys", self.corner_keys, 3 * faces),
        ):
            _check(name, None if keys is None else keys[:, None], rows, (1,), (np.uint32,))

    def select(self, vertices: Any, faces: Any, numbers: NDArray[np.int64]) -> Mesh:
        """Return the mesh with the selected vertices and faces, which are given as masks or row indices.

        `numbers` (F', 3) becomes the new `faces`. The new faces contain indices of the selected vertices.
        """
        rows: dict[str, Any] = {"faces": numbers}
        by_face = ("face_colors", "face_textures")
        for name in ("vertices", "vertex_colors", "vertex_uvs", "vertex_keys", *by_face):
            if (values := getattr(self, name)) is not None:
                rows[name] = values[faces if name in by_face else vertices]
        for name in ("corner_uvs", "corner_keys", "corner_normals"):
            if (values := getattr(self, name)) is not None:
                width = values.shape[1:]
                rows[name] = values.reshape(-1, 3, *width)[faces].reshape(-1, *width)
        return replace(self, **rows)

    @property
    def attributes(self) -> dict[str, NDArray[Any]]:
        """Maps names of `msb.topology.seams` to arrays. Vertices are split at seams where the values of an
        array differ."""
        stored = {"uv": self.vertex_uvs, "corner_uv": self.corner_uvs, "color": self.vertex_colors}
        stored |= {SEAM_KEY: self.vertex_keys, f"corner_{SEAM_KEY}": self.corner_keys}
        stored["face_texture"] = self.face_textures
        named = {name: values for name, values in stored.items() if values is not None}
        return {**named, TRIANGLE_LIST: np.zeros(0)}


def report_left_out(mesh: Mesh) -> tuple[Finding, ...]:
    """If the file has unread parts, return the finding that lists these parts."""
    if not mesh.left_out:
        return ()
    text = f"Ignored: {', '.join(mesh.left_out)}. Only triangles, their colours and textures are read"
    return (finding("MESH_FILE_LEFT_OUT", text, severity="info", value=list(mesh.left_out)),)


def report_origin(mesh: Mesh) -> tuple[Finding, ...]:
    """Return findings about coordinates that are too precise for float32. The findings state the origin and
    rounding errors."""
    origin = find_origin(mesh.vertices)
    findings = []
    if any(origin):
        text = (
            "Coordinates are far from zero, so they are kept as float32 relative to "
            f"{describe_origin(origin)}"
        )
        findings.append(finding("MESH_ORIGIN", text, severity="info", value=list(origin)))
    if (loss := describe_rounding(mesh, round_coordinates(mesh.vertices, origin))) is not None:
        text = f"{loss}. Split the mesh into parts that are closer together, or move it closer to zero"
        findings.append(finding("MESH_ROUNDED", text, severity="warning"))
    return tuple(findings)


def describe_rounding(mesh: Mesh, rounded: NDArray[Any]) -> str | None:
    """Return the largest move of a vertex from `mesh` to `rounded` (V, 3) as text, or None if the move is too
    small."""
    if rounded is mesh.vertices:
        return None
    faces = mesh.faces[:: max(1, len(mesh.faces) // _SAMPLED_FACES)]
    inside = ((faces >= 0) & (faces < len(mesh.vertices))).all(axis=1)
    with np.errstate(over="ignore", invalid="ignore"):
        corners = mesh.vertices[faces[inside]].astype(np.float64)
        moved = np.abs(corners - rounded[faces[inside]])
        edges = np.ptp(corners, axis=1).max(axis=1)
    # Compare the moves with the typical size of a face.
    known = np.isfinite(moved).all(axis=(1, 2)) & (edges > 0)
    if not known.any():
        return None
    largest, size = float(moved[known].max()), float(np.median(edges[known]))
    if largest <= _SEEN * size:
        return None
    return f"float32 moves vertices by up to {largest:.2g}, {100 * largest / size:.2g} % of a typical face"


def _check(
    name: str, array: NDArray[Any] | None, rows: int | None, widths: tuple[int, ...], types: tuple[type, ...]
) -> None:
    """Raise MESH_ARRAY unless `array` is valid. The valid shapes are (`rows`, one of `widths`), and the valid
    types are `types`.

    If `rows` is None, the array must exist and may have any number of rows. If `rows` is given, the array may
    be None.
    """
    if array is None and rows is not None:
        return
    if not isinstance(array, np.ndarray):
        text = f"{name} is a {type(array).__name__}; it must be a NumPy array"
        raise MeshError("MESH_ARRAY", text)
    ok = array.ndim == 2 and array.shape[1] in widths and array.dtype in types and rows in (None, len(array))
    if not ok:
        shape = f"({'N' if rows is None else rows}, {' or '.join(map(str, widths))})"
        kinds = " or ".join(np.dtype(kind).name for kind in types)
        text = f"{name} has shape {array.shape} and type {array.dtype}; it must be {shape} {kinds}"
        raise MeshError("MESH_ARRAY", text)

"""What a mesh file holds, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import Sampler
from msb.errors import Finding, MeshError, finding


@dataclass(frozen=True, eq=False)
class Mesh:
    """The triangles of one file: every vertex row and every face, in the file's order.

    Parameters
    ----------
    vertices : (V, 3) float32 or float64
        Positions in the file's units and precision; unreferenced and non-finite rows included.
    faces : (F, 3) int64
        Vertex numbers. They may be negative or at least V if the file says so: the audit reports that.
    vertex_colors : (V, 3) or (V, 4) uint8 or float32 in [0, 1], optional
        None where the file has none.
    face_colors : (F, 3) or (F, 4) uint8 or float32 in [0, 1], optional
        One row per triangle, that is per row of `faces`.
    vertex_uvs : (V, 2) float32, optional
        Texture coordinates, v downwards as in glTF.
    corner_uvs : (3F, 2) float32, optional
        The same by corner, for a format that has them so; a mesh has one of the two.
    textures : tuple of (H, W, 3) or (H, W, 4) uint8
        sRGB images that the texture coordinates are about; colours are multiplied with them in linear light.
    face_textures : (F,) uint32, optional
        Which texture a face shows; None where there are fewer than two.
    sampler : Sampler
        How the textures are read.
    left_out : tuple of str
        What else the file holds, which no reader keeps: "normals", "UVs", "2 textures".
    up : str, optional
        The axis that points up, such as "+y"; None where that is not known.
    wrong_face : str, optional
        Of a text file, the line of the first face that uses a vertex which is not there.

    Raises
    ------
    MeshError
        MESH_ARRAY: an array has another shape or type.
    """

    vertices: NDArray[Any]
    faces: NDArray[np.int64]
    vertex_colors: NDArray[Any] | None = None
    face_colors: NDArray[Any] | None = None
    vertex_uvs: NDArray[np.float32] | None = None
    corner_uvs: NDArray[np.float32] | None = None
    textures: tuple[NDArray[np.uint8], ...] = ()
    face_textures: NDArray[np.uint32] | None = None
    sampler: Sampler = field(default_factory=Sampler)
    left_out: tuple[str, ...] = ()
    up: str | None = None
    wrong_face: str | None = None

    def __post_init__(self) -> None:
        _check("vertices", self.vertices, None, (3,), (np.float32, np.float64))
        _check("faces", self.faces, None, (3,), (np.int64,))
        vertices, faces, colors = len(self.vertices), len(self.faces), (np.uint8, np.float32)
        _check("vertex_colors", self.vertex_colors, vertices, (3, 4), colors)
        _check("face_colors", self.face_colors, faces, (3, 4), colors)
        _check("vertex_uvs", self.vertex_uvs, vertices, (2,), (np.float32,))
        _check("corner_uvs", self.corner_uvs, 3 * faces, (2,), (np.float32,))

    def taken(self, vertices: Any, faces: Any, numbers: NDArray[np.int64]) -> Mesh:
        """Return rows `vertices` and `faces` of it, each a mask or numbers of rows; corners go with faces.

        `numbers` (F, 3) are the vertices of these faces among those that are taken.
        """
        rows: dict[str, Any] = {"faces": numbers}
        by_face = ("face_colors", "face_textures")
        for name in ("vertices", "vertex_colors", "vertex_uvs", *by_face):
            if (values := getattr(self, name)) is not None:
                rows[name] = values[faces if name in by_face else vertices]
        if self.corner_uvs is not None:
            rows["corner_uvs"] = self.corner_uvs.reshape(-1, 3, 2)[faces].reshape(-1, 2)
        return replace(self, **rows)

    @property
    def attributes(self) -> dict[str, NDArray[Any]]:
        """What its vertices may be doubled for at seams, by an asset's names."""
        held = {"uv": self.vertex_uvs, "corner_uv": self.corner_uvs, "color": self.vertex_colors}
        held["face_texture"] = self.face_textures
        return {name: values for name, values in held.items() if values is not None}


def left_out_finding(mesh: Mesh) -> tuple[Finding, ...]:
    """Return a warning of what else the file of `mesh` holds, or none if that is nothing."""
    if not mesh.left_out:
        return ()
    text = f"only triangles, their colours and textures are read, not its {', '.join(mesh.left_out)}"
    return (finding("MESH_FILE_LEFT_OUT", text, severity="info", value=list(mesh.left_out)),)


def _check(
    name: str, array: NDArray[Any] | None, rows: int | None, widths: tuple[int, ...], types: tuple[type, ...]
) -> None:
    """Raise MESH_ARRAY unless `array` is (rows, one of widths) of one of `types`; rows None is any number.

    An array that may be left out, of which the rows are known, may be None.
    """
    if array is None and rows is not None:
        return
    if not isinstance(array, np.ndarray):
        text = f"{name} is of type {type(array).__name__}; it must be a NumPy array"
        raise MeshError("MESH_ARRAY", text)
    ok = array.ndim == 2 and array.shape[1] in widths and array.dtype in types and rows in (None, len(array))
    if not ok:
        shape = f"({'N' if rows is None else rows}, {' or '.join(map(str, widths))})"
        kinds = " or ".join(np.dtype(kind).name for kind in types)
        text = f"{name} is {array.shape} {array.dtype}, not {shape} {kinds}"
        raise MeshError("MESH_ARRAY", text)

"""The mesh that tasks are tried on, as arrays with vertex colours."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.api.opening import stored_mesh
from msb.asset import Asset
from msb.asset.drawable import check_drawable
from msb.asset.look import colors_of, stored_threshold, visible_faces
from msb.errors import about
from msb.meshes import Mesh
from msb.meshes.colors import as_floats
from msb.topology import audit_arrays
from msb.topology.seams import find_seams
from msb.topology.verdict import Verdict, judge
from msb.topology.weld import Weld, weld_vertices


@dataclass(frozen=True, eq=False)
class TrialMesh:
    """A triangle mesh with vertex colours (V, 3) in [0, 1] and optional texture coordinates (V, 2).

    Vertices (V, 3) are float32, or float64 for libraries. All indices in `faces` (F, 3) are valid.
    """

    vertices: NDArray[np.floating[Any]]
    faces: NDArray[np.int64]
    colors: NDArray[np.float32]
    uv: NDArray[np.float32] | None = None

    @property
    def diagonal(self) -> float:
        """The length of the bounding-box diagonal, without unused vertices."""
        used = self.vertices[np.unique(self.faces)].astype(np.float64)
        return float(np.linalg.norm(np.ptp(used, axis=0))) if len(used) else 0.0

    @cached_property
    def verdict(self) -> Verdict:
        """The audit's verdict on the mesh. Vertices that are split at UV seams are merged first."""
        attributes = {} if self.uv is None else {"uv": self.uv}
        return judge(audit_arrays(self.vertices, self.faces, attributes=attributes, check_crossings=False)[0])

    @property
    def sha256(self) -> str:
        """The SHA-256 hash of the coordinates (little-endian float32) and the faces (little-endian int64)."""
        digest = hashlib.sha256(self.vertices.astype("<f4").tobytes())
        digest.update(self.faces.astype("<i8").tobytes())
        return digest.hexdigest()

    def to_mesh(self) -> Mesh:
        """Return the mesh as a `Mesh` for mesh files."""
        return Mesh(self.vertices, self.faces, self.colors, vertex_uvs=self.uv)

    def unshared(self, colors: NDArray[np.float32]) -> TrialMesh:
        """Return a triangle soup with three vertices per face.

        The argument `colors` (3F, 3) contains the vertex colours of the soup.
        """
        corners = self.faces.reshape(-1)
        faces = np.arange(len(corners), dtype=np.int64).reshape(-1, 3)
        return TrialMesh(self.vertices[corners], faces, colors)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays of the mesh by name."""
        arrays = {"vertices": self.vertices, "faces": self.faces, "colors": self.colors}
        return arrays if self.uv is None else {**arrays, "uv": self.uv}

    @classmethod
    def of(cls, name: str, arrays: Mapping[str, NDArray[Any]]) -> TrialMesh:
        """Check the types and shapes of arrays from a library, and return them as a mesh.

        Raise ValueError if the arrays are invalid. The error message calls the mesh `name`.
        """
        checked: dict[str, Any] = {}
        for key, width, kind in (
            ("vertices", 3, "f"),
            ("faces", 3, "iu"),
            ("colors", 3, "f"),
            ("uv", 2, "f"),
        ):
            if key == "uv" and key not in arrays:
                continue
            array = arrays[key]
            if array.ndim != 2 or array.shape[1] != width or array.dtype.kind not in kind:
                raise ValueError(f"{key} of the mesh {name} has shape {array.shape} and type {array.dtype}")
            if not np.isfinite(array).all():
                raise ValueError(f"{key} of the mesh {name} are not all finite")
            checked[key] = (
                array if key == "vertices" else array.astype(np.int64 if key == "faces" else np.float32)
            )
        faces = checked["faces"]
        if faces.size and not 0 <= faces.min() <= faces.max() < len(checked["vertices"]):
            raise ValueError(f"the mesh {name} has a vertex index out of range")
        return cls(**checked)


def prepare_mesh(asset: Asset, weld: Weld | None = None) -> TrialMesh:
    """Return the mesh of `asset` for trials. Seams are merged, and faces below the STE threshold are removed.

    The coordinates are float32, relative to the origin of the asset. Face and corner colours are averaged at
    each vertex, so that no vertex needs to be split. A mesh without colours is white. Vertices are merged at
    seams and by `weld`. A merged vertex gets the average of the old colours.
    """
    check_drawable(asset, ("positions", "color", "f_dc"))
    vertices = np.asarray(asset.buffers["positions"], np.float32)
    faces = asset.buffers["indices"].astype(np.int64)
    colors = _average_colors(asset, faces)
    visible = visible_faces(asset, stored_threshold(asset))
    seams = find_seams(vertices, faces, stored_mesh(asset).attributes)
    # Merge vertices at seams, then coincident vertices.
    corners = faces if visible is None else faces[visible]
    merged, faces = vertices, corners
    if seams is not None:
        merged, faces = vertices[seams.first], seams.merged(faces)
    if weld is not None:
        with about(asset.path):
            merged, faces = weld_vertices(merged, faces, weld)
    if merged is not vertices:
        # Average the colours over the corners of each merged vertex. Unused vertices have no influence.
        colors = _average_groups(faces.reshape(-1), colors[corners.reshape(-1)], len(merged))
    return TrialMesh(merged, faces, colors)


def _average_colors(asset: Asset, faces: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the colours (V, 3) of the vertices. Face and corner colours are averaged."""
    stored = colors_of(asset)
    if stored is None:
        return np.ones((asset.manifest.vertex_count, 3), np.float32)
    values = as_floats(stored.values[:, :3])
    if stored.domain == "vertex":
        return values
    corners = np.repeat(values, 3, axis=0) if stored.domain == "face" else values
    return _average_groups(faces.reshape(-1), corners, asset.manifest.vertex_count)


def _average_groups(group: NDArray[np.int64], values: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """Return the average value (`count`, 3) of each group.

    Row i of `values` (n, 3) belongs to the group group[i]. An empty group is white.
    """
    size = np.bincount(group, minlength=count)
    sums = np.stack([np.bincount(group, values[:, k], count) for k in range(3)], axis=1)
    averages = sums / np.maximum(size, 1)[:, None]
    return np.where(size[:, None] > 0, averages, 1.0).astype(np.float32)

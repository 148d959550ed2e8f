"""The mesh that tasks are tried on: arrays with a colour at every vertex."""

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
class TriedMesh:
    """A triangle mesh with a colour (V, 3) in [0, 1] at every vertex.

    Vertices are float32, and float64 between us and a library; vertex numbers of faces are all in range.
    """

    vertices: NDArray[np.floating[Any]]
    faces: NDArray[np.int64]
    colors: NDArray[np.float32]
    uv: NDArray[np.float32] | None = None

    @property
    def diagonal(self) -> float:
        """The length of the bounding box's diagonal, of the vertices that faces use."""
        used = self.vertices[np.unique(self.faces)].astype(np.float64)
        return float(np.linalg.norm(np.ptp(used, axis=0))) if len(used) else 0.0

    @cached_property
    def verdict(self) -> Verdict:
        """What an audit says: seams of UVs, which double vertices, are no fault of the surface."""
        attributes = {} if self.uv is None else {"uv": self.uv}
        return judge(audit_arrays(self.vertices, self.faces, attributes=attributes)[0])

    @property
    def sha256(self) -> str:
        """The SHA-256 of the coordinates (little-endian float32) and the faces (little-endian int64)."""
        digest = hashlib.sha256(self.vertices.astype("<f4").tobytes())
        digest.update(self.faces.astype("<i8").tobytes())
        return digest.hexdigest()

    def to_mesh(self) -> Mesh:
        """Return it as what mesh files hold."""
        return Mesh(self.vertices, self.faces, self.colors, vertex_uvs=self.uv)

    def unshared(self, colors: NDArray[np.float32]) -> TriedMesh:
        """Return the faces with three vertices each and `colors` (3F, 3) at these."""
        corners = self.faces.reshape(-1)
        faces = np.arange(len(corners), dtype=np.int64).reshape(-1, 3)
        return TriedMesh(self.vertices[corners], faces, colors)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return its arrays by their names."""
        own = {"vertices": self.vertices, "faces": self.faces, "colors": self.colors}
        return own if self.uv is None else {**own, "uv": self.uv}

    @classmethod
    def of(cls, name: str, arrays: Mapping[str, NDArray[Any]]) -> TriedMesh:
        """Return the mesh of `arrays`; what a library made of it may be of other types and shapes.

        ValueError says what is wrong with the mesh of this name.
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
                raise ValueError(f"{key} of the mesh {name} is {array.shape} {array.dtype}")
            if not np.isfinite(array).all():
                raise ValueError(f"{key} of the mesh {name} are not all finite")
            checked[key] = (
                array if key == "vertices" else array.astype(np.int64 if key == "faces" else np.float32)
            )
        faces = checked["faces"]
        if faces.size and not 0 <= faces.min() <= faces.max() < len(checked["vertices"]):
            raise ValueError(f"a face of the mesh {name} uses a vertex that it does not have")
        return cls(**checked)


def mesh_to_try(asset: Asset, weld: Weld | None = None) -> TriedMesh:
    """Return the mesh of `asset` as it is stored, without its seams and the faces its STE threshold hides.

    Colours of faces and corners become the means of the faces at each vertex, so that the mesh keeps its
    vertices as they are; without any colours it is white. Vertices that were doubled at seams, or that `weld`
    merges first, have the mean colour, too.
    """
    check_drawable(asset, ("positions", "color", "f_dc"))
    vertices = np.asarray(asset.buffers["positions"], np.float32)
    faces = asset.buffers["indices"].astype(np.int64)
    colors = _vertex_colors(asset, faces)
    shown = visible_faces(asset, stored_threshold(asset))
    seams = find_seams(vertices, faces, stored_mesh(asset).attributes)
    corners = faces if shown is None else faces[shown]
    merged, faces = vertices, corners
    if seams is not None:
        merged, faces = vertices[seams.first], seams.merged(faces)
    if weld is not None:
        with about(asset.path):
            merged, faces = weld_vertices(merged, faces, weld)
    if merged is not vertices:
        # A vertex that no face uses merges with none that is seen, so corners tell all that matters.
        colors = _means(faces.reshape(-1), colors[corners.reshape(-1)], len(merged))
    return TriedMesh(merged, faces, colors)


def _vertex_colors(asset: Asset, faces: NDArray[np.int64]) -> NDArray[np.float32]:
    stored = colors_of(asset)
    if stored is None:
        return np.ones((asset.manifest.vertex_count, 3), np.float32)
    values = as_floats(stored.values[:, :3])
    if stored.domain == "vertex":
        return values
    corners = np.repeat(values, 3, axis=0) if stored.domain == "face" else values
    return _means(faces.reshape(-1), corners, asset.manifest.vertex_count)


def _means(group: NDArray[np.int64], values: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """Return the mean of the values (n, 3) of each of `count` groups; white where a group has none."""
    size = np.bincount(group, minlength=count)
    sums = np.stack([np.bincount(group, values[:, k], count) for k in range(3)], axis=1)
    means = sums / np.maximum(size, 1)[:, None]
    return np.where(size[:, None] > 0, means, 1.0).astype(np.float32)

"""The mesh of a viewer: the stored mesh with its colours and textures."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.api.opening import StoredMesh
from msb.asset.look import StaticColors
from msb.asset.texture import ROUNDING, Textured
from msb.topology.analysis import Analysis
from msb.topology.arrays import mesh_arrays
from msb.topology.seams import Attributes, Seams, find_seams

Domain = Literal["vertex", "face", "corner"]
NO_COLOR = "the colours depend on the view direction, so the mesh is grey"


@dataclass(frozen=True, eq=False)
class Colors:
    """Colours (V | F | 3F, 3) as sRGB bytes, which are drawn unlit."""

    values: NDArray[np.uint8]
    domain: Domain


@dataclass(frozen=True, eq=False)
class Skin:
    """The textures of a mesh, and the colours `tint` (3F, 4) of its corners as sRGB bytes with alpha.

    Texture and colours are multiplied in linear light.
    """

    textured: Textured
    tint: NDArray[np.uint8] | None

    @property
    def cutoff(self) -> float:
        """If the product of the two alpha values is below this cutoff, nothing is drawn."""
        return (self.textured.sampler.alpha_cutoff or 0.0) - ROUNDING

    def by_texture(self, rows: NDArray[Any]) -> list[tuple[int, NDArray[Any]]]:
        """For each texture that the faces `rows` use, return its index and its faces (n,)."""
        numbers = self.textured.face_texture
        if numbers is None:
            return [(0, rows)]
        return [(int(number), rows[numbers[rows] == number]) for number in np.unique(numbers[rows])]


@dataclass(frozen=True, eq=False)
class ViewedMesh:
    """A stored mesh, whose values are not checked.

    If the mesh has a `skin`, `colors` contains the texture colours at the corners. The corner colours are
    used for drawing without textures. `up` is an axis such as "+y", or "unknown". `notes` are messages about
    the drawing. `attributes` are vertex attributes that can have seams, where vertices are duplicated.
    `seams` describes the merged seams. If no seams were merged, it is None.
    """

    name: str
    path: Path | None
    vertices: NDArray[Any]
    faces: NDArray[Any]
    colors: Colors | None = None
    method: str | None = None
    up: str = "unknown"
    notes: tuple[str, ...] = ()
    attributes: Attributes = field(default_factory=dict)
    skin: Skin | None = None
    seams: Seams | None = None


def read_viewed_mesh(path: Path) -> ViewedMesh:
    """Return the mesh at `path`: a `.triasset`, a mesh file or a checkpoint."""
    from msb.api.opening import read_stored

    return viewed_mesh(read_stored(path, images=True), path)


def viewed_mesh(mesh: StoredMesh, path: Path) -> ViewedMesh:
    """Return a mesh from the file `path` with the colours of the standard tier (opaque rendering).

    The mesh has all stored faces, because the audit counts them. This includes faces that an STE threshold
    hides.
    """
    from msb.asset.look import static_colors
    from msb.errors import AssetError

    skin, static = None, static_colors(mesh.buffers, mesh.domains)
    notes = []
    try:
        skin, static = _skin(mesh, static)
    except AssetError as error:  # draw this mesh without textures
        notes.append(f"{error.code}: {error.message}; its textures are not drawn")
    colors = None if static is None else Colors(color_bytes(static.values), static.domain)
    if colors is None and mesh.method not in (None, "mesh"):
        notes.append(NO_COLOR)
    notes += [f"{warning.code}: {warning.message}" for warning in mesh.warnings]
    place = (path.name, path, mesh.vertices, mesh.faces)
    return ViewedMesh(*place, colors, mesh.method, mesh.up, tuple(notes), mesh.attributes, skin)


def merge_seams(mesh: ViewedMesh) -> tuple[ViewedMesh, Analysis]:
    """Merge the seams of `mesh` in the same way as for the verdict. Return the mesh and its analysis.

    Colours of vertices become corner colours, so that the drawn mesh does not change.
    """
    points, faces = mesh_arrays(mesh.vertices, mesh.faces)
    seams = find_seams(points, faces, mesh.attributes)
    if seams is None:
        return mesh, Analysis(points, faces)
    colors = mesh.colors
    if colors is not None and colors.domain == "vertex":
        colors = Colors(colors.values[faces.reshape(-1)], "corner")
    points, merged = points[seams.first], seams.merged(faces)
    return replace(mesh, vertices=points, faces=merged, colors=colors, seams=seams), Analysis(points, merged)


def find_seam_edges(seams: Seams, stored: Analysis, merged: Analysis) -> NDArray[Any]:
    """Return the edges (n,) of the `merged` mesh that are boundary edges only in the `stored` mesh."""
    torn = np.sort(seams.number[stored.mesh.edge_vertices[stored.boundary.edges]], axis=1)
    count = len(merged.vertices)
    edges = merged.mesh.edge_vertices.astype(np.int64)
    inside = np.isin(edges[:, 0] * count + edges[:, 1], torn[:, 0].astype(np.int64) * count + torn[:, 1])
    inside[merged.boundary.edges] = False
    return np.flatnonzero(inside)


def _skin(mesh: StoredMesh, tint: StaticColors | None) -> tuple[Skin | None, StaticColors | None]:
    """Return the textures of `mesh` or None. Also return colours for drawing without textures."""
    from msb.asset.look import corner_colors, corner_tint
    from msb.asset.texture import encode_texels, textures_in

    faces = mesh.faces
    inside = faces.size and 0 <= faces.min() <= faces.max() < len(mesh.vertices)
    if mesh.sampler is None or not inside:  # the audit will report an invalid index
        return None, tint
    textured = textures_in(mesh.buffers, mesh.domains["uv"], mesh.sampler)
    colors = corner_colors(textured, tint, faces)
    if tint is None:
        return Skin(textured, None), colors
    light = np.nan_to_num(corner_tint(tint, faces), nan=0.0)
    texels = encode_texels(light, 4)
    # Round the cutoff up. Without rounding up, alpha could be below the cutoff because of a rounding error.
    texels[:, 3] = np.ceil(light[:, 3] * 255)
    return Skin(textured, texels), colors


def color_bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return colours (n, 3 | 4) as bytes (n, 3): floor(255 c + 0.5), without alpha. NaN becomes 0."""
    rgb = values[:, :3]
    if rgb.dtype == np.uint8:
        return np.ascontiguousarray(rgb)
    clean = np.clip(np.nan_to_num(np.asarray(rgb, np.float32), nan=0.0), 0, 1)
    return np.asarray(np.floor(clean * 255 + np.float32(0.5)).astype(np.uint8))

"""The mesh that a viewer shows: exactly as it is audited, with its own colours."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from msb.api.opening import StoredMesh
from msb.asset.look import StaticColors
from msb.asset.texture import ROUNDING, Textured
from msb.topology.seams import Attributes

Domain = Literal["vertex", "face", "corner"]
NO_COLOR = "its colours depend on the view and have no static part: drawn in grey"


@dataclass(frozen=True, eq=False)
class Colors:
    """Colours (V | F | 3F, 3) as sRGB bytes, which are shown unlit and unchanged."""

    values: NDArray[np.uint8]
    domain: Domain


@dataclass(frozen=True, eq=False)
class Skin:
    """The textures of a mesh, and colours (3F, 4) of its corners, sRGB bytes and alpha.

    Both are multiplied in linear light.
    """

    textured: Textured
    tint: NDArray[np.uint8] | None

    @property
    def cutoff(self) -> float:
        """The alpha of both together below which nothing is drawn."""
        return (self.textured.sampler.alpha_cutoff or 0.0) - ROUNDING

    def by_texture(self, rows: NDArray[Any]) -> list[tuple[int, NDArray[Any]]]:
        """Return the textures that faces `rows` show, each with those that show it, in their order."""
        shown = self.textured.face_texture
        if shown is None:
            return [(0, rows)]
        return [(int(number), rows[shown[rows] == number]) for number in np.unique(shown[rows])]


@dataclass(frozen=True, eq=False)
class ViewedMesh:
    """A mesh to look at: as stored, nothing is checked yet.

    `colors` of a mesh with a `skin` are what that shows at the corners, for what draws no textures. `up` is
    an axis such as "+y", or "unknown"; `notes` are what the viewer has to say about how it is drawn;
    `attributes` is what vertices may be doubled for at seams.
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


def read_viewed_mesh(path: Path) -> ViewedMesh:
    """Return the mesh at `path`: a `.triasset`, a mesh file or a checkpoint."""
    from msb.api.opening import read_stored

    return viewed_mesh(read_stored(path, images=True), path)


def viewed_mesh(mesh: StoredMesh, path: Path) -> ViewedMesh:
    """Return a mesh that was read from `path` in the colours the standard tier draws it in.

    It has all stored faces, even those that an STE threshold hides, because the audit counts them.
    """
    from msb.asset.look import static_colors
    from msb.errors import AssetError

    skin, found = None, static_colors(mesh.buffers, mesh.domains)
    notes = []
    try:
        skin, found = _skin(mesh, found)
    except AssetError as error:  # what is wrong with the surface is to be seen all the same
        notes.append(f"{error.code}: {error.message}; its textures are not drawn")
    colors = None if found is None else Colors(color_bytes(found.values), found.domain)
    if colors is None and mesh.method not in (None, "mesh"):
        notes.append(NO_COLOR)
    notes += [f"{each.code}: {each.message}" for each in mesh.warnings]
    place = (path.name, path, mesh.vertices, mesh.faces)
    return ViewedMesh(*place, colors, mesh.method, mesh.up, tuple(notes), mesh.attributes, skin)


def _skin(mesh: StoredMesh, tint: StaticColors | None) -> tuple[Skin | None, StaticColors | None]:
    """Return the textures of `mesh`, if it has any, and the colours it has without them."""
    from msb.asset.look import corner_colors, corner_tint
    from msb.asset.texture import encoded, textures_in

    faces = mesh.faces
    inside = faces.size and 0 <= faces.min() <= faces.max() < len(mesh.vertices)
    if mesh.sampler is None or not inside:  # the audit will say which vertex there is not
        return None, tint
    textured = textures_in(mesh.buffers, mesh.domains["uv"], mesh.sampler)
    colors = corner_colors(textured, tint, faces)
    if tint is None:
        return Skin(textured, None), colors
    light = np.nan_to_num(corner_tint(tint, faces), nan=0.0)
    made = encoded(light, 4)
    made[:, 3] = np.ceil(light[:, 3] * 255)  # what is drawn with the alpha as stored is not cut off
    return Skin(textured, made), colors


def color_bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return colours (n, 3 | 4) as bytes (n, 3): floor(255 c + 0.5); alpha is left out, NaN becomes 0."""
    rgb = values[:, :3]
    if rgb.dtype == np.uint8:
        return np.ascontiguousarray(rgb)
    clean = np.clip(np.nan_to_num(np.asarray(rgb, np.float32), nan=0.0), 0, 1)
    return np.asarray(np.floor(clean * 255 + np.float32(0.5)).astype(np.uint8))

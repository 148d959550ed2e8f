"""The mesh that a viewer shows: exactly as it is audited, with its own colours."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from msb.api.opening import StoredMesh
    from msb.topology.seams import Attributes

Domain = Literal["vertex", "face", "corner"]
NO_COLOR = "its colours depend on the view and have no static part: drawn in grey"


@dataclass(frozen=True, eq=False)
class Colors:
    """Colours (V | F | 3F, 3) as sRGB bytes, which are shown unlit and unchanged."""

    values: NDArray[np.uint8]
    domain: Domain


@dataclass(frozen=True, eq=False)
class ViewedMesh:
    """A mesh to look at: as stored, nothing is checked yet.

    `up` is an axis such as "+y", or "unknown"; `notes` are what the viewer has to say about how it is drawn;
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


def read_viewed_mesh(path: Path) -> ViewedMesh:
    """Return the mesh at `path`: a `.triasset`, a mesh file or a checkpoint."""
    from msb.api.opening import read_stored

    return viewed_mesh(read_stored(path), path)


def viewed_mesh(mesh: StoredMesh, path: Path) -> ViewedMesh:
    """Return a mesh that was read from `path` in the colours the standard tier draws it in.

    It has all stored faces, even those that an STE threshold hides, because the audit counts them.
    """
    from msb.asset.look import static_colors

    found = static_colors(mesh.buffers, mesh.domains)
    colors = None if found is None else Colors(color_bytes(found.values), found.domain)
    notes: tuple[str, ...] = () if colors is not None or mesh.method in (None, "mesh") else (NO_COLOR,)
    notes += tuple(f"{each.code}: {each.message}" for each in mesh.warnings)
    place = (path.name, path, mesh.vertices, mesh.faces)
    return ViewedMesh(*place, colors, mesh.method, mesh.up, notes, mesh.attributes)


def color_bytes(values: NDArray[Any]) -> NDArray[np.uint8]:
    """Return colours (n, 3 | 4) as bytes (n, 3): floor(255 c + 0.5); alpha is left out, NaN becomes 0."""
    rgb = values[:, :3]
    if rgb.dtype == np.uint8:
        return np.ascontiguousarray(rgb)
    clean = np.clip(np.nan_to_num(np.asarray(rgb, np.float32), nan=0.0), 0, 1)
    return np.asarray(np.floor(clean * 255 + np.float32(0.5)).astype(np.uint8))

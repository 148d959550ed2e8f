"""The mesh an engine is given: the same triangles and colours as our own standard tier draws."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.drawable import check_drawable
from msb.asset.look import drawn_colors, shown_faces
from msb.asset.settings import effective_settings
from msb.meshes import Mesh, write_mesh

if TYPE_CHECKING:
    from msb.asset import Asset


@dataclass(frozen=True)
class EngineMesh:
    """Triangles with colours at their vertices.

    Attributes
    ----------
    positions : (V, 3) float32
    indices : (F, 3) uint32
    colors : (V, 3) uint8 or float32
        Opaque colours; floats are in [0, 1]. A fourth channel of the asset's colours is left out, as in our
        renderer.
    numbers : (F,) uint32, optional
        The asset's numbers of the faces; None if they are 0, 1, 2, ...
    """

    positions: NDArray[np.float32]
    indices: NDArray[np.uint32]
    colors: NDArray[Any]
    numbers: NDArray[np.uint32] | None

    def encoded(self, suffix: str) -> bytes:
        """Return the file that `msb convert` writes of the asset, in the format of `suffix`."""
        file = BytesIO()
        write_mesh(Mesh(self.positions, self.indices.astype(np.int64), self.colors), file, suffix=suffix)
        return file.getvalue()

    def depth_range(self, world_to_camera: NDArray[np.float64]) -> tuple[float, float]:
        """Return bounds of the vertices' depths, from the corners of their box."""
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        corners = np.stack(np.meshgrid(*zip(low, high, strict=True)), axis=-1).reshape(-1, 3)
        depths = corners.astype(np.float64) @ world_to_camera[2, :3] + world_to_camera[2, 3]
        return float(depths.min()), float(depths.max())


def engine_mesh(asset: Asset, settings: Mapping[str, Any] | None) -> EngineMesh:
    """Return what an engine draws of `asset`.

    If colours belong to faces or corners, every face gets vertices of its own. If no face is shown, the mesh
    has one face without area, because no format for engines has a mesh without faces.
    """
    values = effective_settings(asset.manifest, settings)
    check_drawable(asset, ("positions", "color", "f_dc"))
    positions = np.asarray(asset.buffers["positions"], np.float32)
    indices = np.asarray(asset.buffers["indices"], np.uint32)
    found = drawn_colors(asset)
    colors = found.values[:, :3]
    numbers = shown_faces(asset, values.get("ste_threshold"))
    if numbers is not None and not len(numbers):
        return EngineMesh(positions[:1], np.zeros((1, 3), np.uint32), np.zeros((1, 3), np.uint8), None)
    shown = slice(None) if numbers is None else numbers
    if found.domain == "vertex":
        return EngineMesh(positions, indices[shown], np.ascontiguousarray(colors), numbers)
    colors = colors.reshape(-1, 3, 3) if found.domain == "corner" else np.repeat(colors[:, None], 3, axis=1)
    corners = positions[indices[shown]].reshape(-1, 3)
    own = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    return EngineMesh(corners, own, np.ascontiguousarray(colors[shown].reshape(-1, 3)), numbers)

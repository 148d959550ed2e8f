"""Vertex colours of a mesh, fitted to images."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.bake.arrays import Ints
from msb.bake.images import ViewImages
from msb.bake.soup import Soup, find_color_seams
from msb.bake.soup_renderer import SoupRenderer
from msb.cl import Device
from msb.meshes.mesh import Mesh


def fit_vertex_colors(mesh: Mesh, images: ViewImages, device: str | Device | None) -> Mesh:
    """Return `mesh` with the vertex colours that fit the images best. Unseen vertices keep their colours.

    A cut edge stores a vertex twice, as two copies. If two copies have the same colour, their fitted colours
    must be equal as well.
    """
    soup = Soup.from_mesh(mesh, share_colors=True)
    if soup.shared is not None and mesh.vertex_colors is not None:
        soup.shared = _merge_equal_colors(mesh, mesh.vertex_colors)[mesh.faces]
    with closing(SoupRenderer(soup.corners, soup.colors, images, device)) as renderer:
        soup.refit_colors(renderer)
    return soup.to_mesh() if soup.shared is None else soup.apply_to(mesh)


def _merge_equal_colors(mesh: Mesh, colors: NDArray[Any]) -> Ints:
    """For each vertex (V,), return the index of its first copy with the same colour."""
    first = np.arange(len(mesh.vertices))
    seams = find_color_seams(mesh.vertices, mesh.faces)
    if seams is not None:
        # Row indices of the vertices that have copies at a cut edge. Copies with the same colour form a
        # group.
        rows = np.flatnonzero(np.bincount(seams.number)[seams.number] > 1)
        kinds = np.column_stack([seams.number[rows], colors[rows]])
        _, lowest, kind = np.unique(kinds, axis=0, return_index=True, return_inverse=True)
        first[rows] = rows[lowest[kind.reshape(-1)]]
    return first

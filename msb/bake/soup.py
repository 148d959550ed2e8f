"""A triangle soup whose corners, colours and face selection are changed by a search.

A triangle soup is a set of triangles that share no vertices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from msb.bake import color_fit
from msb.bake.arrays import Ints, Mask, Singles
from msb.base.soup import is_unindexed
from msb.meshes.assets import with_faces
from msb.meshes.mesh import Mesh
from msb.topology.seams import find_seams

if TYPE_CHECKING:
    from typing import Any

    from scipy.sparse import csr_matrix

    from msb.bake.soup_renderer import FaceSums, SoupRenderer
    from msb.topology.seams import Seams


def find_color_seams(points: NDArray[Any], faces: NDArray[Any]) -> Seams | None:
    """Return the cut edges of a mesh, or None if it has no cut.

    Any attribute may differ across a cut edge.
    """
    return find_seams(points, faces, {"color": np.arange(len(points))[:, None]})


def merge_seams(mesh: Mesh) -> Mesh:
    """Merge the vertices that a cut edge stores twice. Return `mesh` itself if it has no cut."""
    seams = find_color_seams(mesh.vertices, mesh.faces)
    if seams is None:
        return mesh
    return replace(
        mesh,
        vertices=mesh.vertices[seams.first],
        faces=seams.merged(mesh.faces),
        vertex_colors=None if mesh.vertex_colors is None else mesh.vertex_colors[seams.first],
        vertex_uvs=None if mesh.vertex_uvs is None else mesh.vertex_uvs[seams.first],
    )


def is_uncut_soup(points: NDArray[Any], faces: NDArray[Any]) -> bool:
    """Return whether the faces form a triangle soup.

    A surface that was cut along all its edges is not a soup.

    Assets store the vertices of a soup one after the other. Faces that use the vertices in this order are a
    soup, even if some corners coincide.
    """
    if not is_unindexed(faces, len(points)):
        return False
    return np.array_equal(faces.reshape(-1), np.arange(faces.size)) or find_color_seams(points, faces) is None


@dataclass
class Soup:
    """Opaque faces that a search moves, colours and selects.

    Attributes
    ----------
    corners : (F, 3, 3) float32
        The position of each corner.
    colors : (F, 3, 3) float32
        RGB of each corner in [0, 1].
    selected : (F,) bool
        The faces that are drawn.
    shared : (F, 3) int64, optional
        The vertex index of each corner, if all corners at a vertex have the same colour. If `shared` is None,
        the corners have independent colours.
    """

    corners: Singles
    colors: Singles
    selected: Mask
    shared: Ints | None = None

    @classmethod
    def from_mesh(cls, mesh: Mesh, *, share_colors: bool) -> Self:
        """Return the faces of `mesh` as a soup, grey if the mesh has no vertex colours.

        With `share_colors`, all corners at a vertex have the same colour, unless `mesh` is a soup.
        """
        corners = np.ascontiguousarray(mesh.vertices[mesh.faces], np.float32)
        colors = np.full(corners.shape, 0.5, np.float32)
        if mesh.vertex_colors is not None:
            stored = mesh.vertex_colors[:, :3]
            scale = np.float32(255 if stored.dtype == np.uint8 else 1)
            colors = np.ascontiguousarray(stored[mesh.faces] / scale, np.float32)
        is_shared = share_colors and not is_uncut_soup(mesh.vertices, mesh.faces)
        return cls(corners, colors, np.ones(len(corners), bool), mesh.faces if is_shared else None)

    @property
    def selected_count(self) -> int:
        """The number of selected faces."""
        return int(self.selected.sum())

    def copy(self) -> Self:
        """Return an independent copy of the soup."""
        corners, colors, selected = self.corners.copy(), self.colors.copy(), self.selected.copy()
        return replace(self, corners=corners, colors=colors, selected=selected)

    def upload(self, renderer: SoupRenderer) -> None:
        """Make `renderer` draw this state of the soup."""
        renderer.update(self.corners, self.colors, self.selected)

    def fit_colors(self, sums: FaceSums) -> None:
        """Fit the colours of the selected faces by least squares, from the sums over their pixels."""
        if self.shared is None:
            self.colors = color_fit.fit_soup_colors(sums, self.colors, self.selected)
            return
        # One colour per vertex (V, 3). Each corner copies the colour of its vertex.
        count = int(self.shared.max()) + 1
        before = np.full((count, 3), 0.5, np.float32)
        before[self.shared.reshape(-1)] = self.colors.reshape(-1, 3)
        fitted = color_fit.fit_mesh_colors(sums, self.shared, before, self._laplacian)[self.shared]
        self.colors[self.selected] = fitted[self.selected]

    @cached_property
    def _laplacian(self) -> csr_matrix:
        """The Laplacian of the edges between shared vertices."""
        assert self.shared is not None
        return color_fit.make_edge_laplacian(self.shared, int(self.shared.max()) + 1)

    def refit_colors(self, renderer: SoupRenderer, step: int = 1) -> FaceSums:
        """Fit the colours to every `step`-th view of `renderer`. Return the sums over the pixels."""
        self.upload(renderer)
        sums = renderer.sum_faces(range(0, len(renderer.images), step), gradients=False)
        self.fit_colors(sums)
        return sums

    def measure_error(self, renderer: SoupRenderer) -> float:
        """Return the mean squared error over the views of `renderer`."""
        self.upload(renderer)
        return renderer.measure_error()

    def apply_to(self, mesh: Mesh) -> Mesh:
        """Return the original mesh with the given vertex colours, and only with the selected faces."""
        colors = np.full((len(mesh.vertices), 3), 0.5, np.float32)
        colors[mesh.faces.reshape(-1)] = self.colors.reshape(-1, 3)
        return with_faces(replace(mesh, vertex_colors=colors), self.selected)

    def drop_hidden(self) -> Self:
        """Return a soup that consists of the selected faces only."""
        selected = self.selected
        return type(self)(self.corners[selected], self.colors[selected], np.ones(int(selected.sum()), bool))

    def quarter(self) -> Self:
        """Return the selected faces, each divided into four at the middles of its sides."""
        whole = self.drop_hidden()
        corners, colors = _quarter(whole.corners), _quarter(whole.colors)
        return type(self)(corners, colors, np.ones(len(corners), bool))

    def halve(self, times: Ints) -> Self:
        """Return the selected faces, each divided into 2^times pieces.

        The argument `times` has one value for each selected face. A cut halves a piece at the middle of its
        longest side.
        """
        soup = self.drop_hidden()
        while times.any():
            cut = times > 0
            # Rotate the corners (n, 3) of the faces to divide, so that the longest side comes first.
            longest = np.linalg.norm(soup.corners - np.roll(soup.corners, -1, axis=1), axis=2).argmax(axis=1)
            turned = (np.flatnonzero(cut)[:, None], (longest[cut, None] + np.arange(3)) % 3)
            corners, colors = (
                np.concatenate([values[~cut], *_halve(values[turned])])
                for values in (soup.corners, soup.colors)
            )
            soup = type(self)(corners, colors, np.ones(len(corners), bool))
            times = np.concatenate([times[~cut], times[cut] - 1, times[cut] - 1])
        return soup

    def to_mesh(self) -> Mesh:
        """Return the selected faces as a mesh without shared vertices."""
        count = self.selected_count
        faces = np.arange(3 * count, dtype=np.int64).reshape(-1, 3)
        vertices, colors = (values[self.selected].reshape(-1, 3) for values in (self.corners, self.colors))
        return Mesh(vertices, faces, vertex_colors=colors)


def _quarter(values: Singles) -> Singles:
    """Divide faces into quarters. Return the interpolated values (4F, 3, 3) at the new corners."""
    a, b, c = values.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(piece, axis=1) for piece in quarters], axis=1).reshape(-1, 3, 3)


def _halve(values: Singles) -> tuple[Singles, Singles]:
    """Divide faces at the middle of their first side. Return both halves (F, 3, 3)."""
    a, b, c = values.transpose(1, 0, 2)
    middle = (a + b) / 2
    return np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)

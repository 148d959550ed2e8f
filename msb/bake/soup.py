"""The opaque soup that is being taught: its faces, which of them are shown, and in which colours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from msb.bake import colors as fit
from msb.bake.arrays import Ints, Mask, Singles
from msb.base.soup import is_unindexed
from msb.meshes.assets import with_faces
from msb.meshes.mesh import Mesh
from msb.topology.seams import find_seams

if TYPE_CHECKING:
    from typing import Any

    from scipy.sparse import csr_matrix

    from msb.bake.raster import Raster, Seen
    from msb.topology.seams import Seams


def seams_of(points: NDArray[Any], faces: NDArray[Any]) -> Seams | None:
    """Return where a mesh was cut along edges, whatever its vertices differ in there; None if nowhere."""
    return find_seams(points, faces, {"color": np.arange(len(points))[:, None]})


def without_seams(mesh: Mesh) -> Mesh:
    """Return `mesh` with one vertex where it was cut along edges for its colours; `mesh` if it was not."""
    seams = seams_of(mesh.vertices, mesh.faces)
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
    """Return whether the faces are a soup that was not made by cutting a surface along all its edges.

    Faces that name the vertices one after the other are a soup as assets store it, where corners may coincide
    by chance.
    """
    if not is_unindexed(faces, len(points)):
        return False
    return np.array_equal(faces.reshape(-1), np.arange(faces.size)) or seams_of(points, faces) is None


@dataclass
class Soup:
    """Faces that change while they are taught.

    Attributes
    ----------
    corners : (F, 3, 3) float32
    colors : (F, 3, 3) float32
        RGB of each corner, in [0, 1].
    keep : (F,) bool
        Which faces are shown.
    shared : (F, 3) int64, optional
        The vertices of the corners, where these share colours; None: every corner has its own.
    """

    corners: Singles
    colors: Singles
    keep: Mask
    shared: Ints | None = None

    @classmethod
    def of(cls, mesh: Mesh, *, shares: bool) -> Self:
        """Return the faces of `mesh`, whose corners share colours if `shares`; without colours they are
        grey."""
        corners = np.ascontiguousarray(mesh.vertices[mesh.faces], np.float32)
        colors = np.full(corners.shape, 0.5, np.float32)
        if mesh.vertex_colors is not None:
            held = mesh.vertex_colors[:, :3]
            scale = np.float32(255 if held.dtype == np.uint8 else 1)
            colors = np.ascontiguousarray(held[mesh.faces] / scale, np.float32)
        is_shared = shares and not is_uncut_soup(mesh.vertices, mesh.faces)
        return cls(corners, colors, np.ones(len(corners), bool), mesh.faces if is_shared else None)

    @property
    def count(self) -> int:
        """How many faces are shown."""
        return int(self.keep.sum())

    def copy(self) -> Self:
        """Return one that changes by itself."""
        return replace(self, corners=self.corners.copy(), colors=self.colors.copy(), keep=self.keep.copy())

    def put_on(self, raster: Raster) -> None:
        """Have `raster` draw it."""
        raster.change(self.corners, self.colors, self.keep)

    def recolor(self, seen: Seen) -> None:
        """Give the faces that are shown the colours that fit best to what was seen of them."""
        if self.shared is None:
            self.colors = fit.of_soup(seen, self.colors, self.keep)
            return
        count = int(self.shared.max()) + 1
        now = np.full((count, 3), 0.5, np.float32)
        now[self.shared.reshape(-1)] = self.colors.reshape(-1, 3)
        fitted = fit.of_mesh(seen, self.shared, now, self._edges)[self.shared]
        self.colors[self.keep] = fitted[self.keep]

    @cached_property
    def _edges(self) -> csr_matrix:
        """The Laplacian of what is shared, which stays as it is while faces are taught."""
        assert self.shared is not None
        return fit.laplacian(self.shared, int(self.shared.max()) + 1)

    def refit(self, raster: Raster, every: int = 1) -> Seen:
        """Give the faces the colours that fit best over `every` so manieth view of `raster`; return what was
        seen."""
        self.put_on(raster)
        seen = raster.seen(range(0, len(raster.lessons), every), slopes=False)
        self.recolor(seen)
        return seen

    def error(self, raster: Raster) -> float:
        """Return its mean squared error in the views of `raster`."""
        self.put_on(raster)
        return raster.error()

    def on(self, mesh: Mesh) -> Mesh:
        """Return `mesh`, which it was made of, in its colours and without the faces that are not shown."""
        colors = np.full((len(mesh.vertices), 3), 0.5, np.float32)
        colors[mesh.faces.reshape(-1)] = self.colors.reshape(-1, 3)
        return with_faces(replace(mesh, vertex_colors=colors), self.keep)

    def shown(self) -> Self:
        """Return the faces that are shown, with vertices of their own."""
        return type(self)(
            self.corners[self.keep], self.colors[self.keep], np.ones(int(self.keep.sum()), bool)
        )

    def cut(self) -> Self:
        """Return the faces that are shown, each cut into four by the middles of its sides."""
        shown = self.shown()
        corners, colors = _quartered(shown.corners), _quartered(shown.colors)
        return type(self)(corners, colors, np.ones(len(corners), bool))

    def halved(self, often: Ints) -> Self:
        """Return the faces that are shown, the pieces of each halved so `often` (of each face that is shown)
        across their longest sides."""
        soup = self.shown()
        while often.any():
            cut = often > 0
            longest = np.linalg.norm(soup.corners - np.roll(soup.corners, -1, axis=1), axis=2).argmax(axis=1)
            turned = (np.flatnonzero(cut)[:, None], (longest[cut, None] + np.arange(3)) % 3)
            corners, colors = (
                np.concatenate([whole[~cut], *_halves(whole[turned])])
                for whole in (soup.corners, soup.colors)
            )
            soup = type(self)(corners, colors, np.ones(len(corners), bool))
            often = np.concatenate([often[~cut], often[cut] - 1, often[cut] - 1])
        return soup

    def mesh(self) -> Mesh:
        """Return the faces that are shown, with vertices of their own."""
        count = self.count
        faces = np.arange(3 * count, dtype=np.int64).reshape(-1, 3)
        return Mesh(
            self.corners[self.keep].reshape(-1, 3), faces, vertex_colors=self.colors[self.keep].reshape(-1, 3)
        )


def _quartered(corners: Singles) -> Singles:
    """Return values at corners (F, 3, 3) at those of the quarters, (4 F, 3, 3); the quarters of a face
    follow it."""
    a, b, c = corners.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    quarters = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(each, axis=1) for each in quarters], axis=1).reshape(-1, 3, 3)


def _halves(corners: Singles) -> tuple[Singles, Singles]:
    """Return values at corners (F, 3, 3) at those of the halves beside the middle of the first two."""
    a, b, c = corners.transpose(1, 0, 2)
    middle = (a + b) / 2
    return np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)

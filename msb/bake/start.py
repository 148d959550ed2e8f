"""Where teaching starts: the model's triangles as an opaque soup, and the best of it that was seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.look import stored_threshold, visible_faces
from msb.asset.tiers import why_not
from msb.bake.arrays import Ints
from msb.bake.colors import pixels
from msb.bake.lessons import Lessons
from msb.bake.raster import Raster
from msb.bake.shares import Shares
from msb.bake.soup import Soup, seams_of
from msb.cl import Device
from msb.meshes.assets import mesh_from_asset, with_vertex_colors
from msb.meshes.charts import with_sampled_colors
from msb.meshes.mesh import Mesh

# Is told the stage, how much of it is done, of how much; says whether to end with the best so far.
Watch = Callable[[str, int, int], bool]
# Shares of its covered pixels that a face must own, tried in this order. Faces below are dropped, as
# those behind may be better. The validation views decide where to stop.
LIMITS = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35)
_EVERY = 2  # every second view measures what faces own


def nobody(_stage: str, _done: int, _total: int) -> bool:
    """Watch nothing, and end nothing."""
    return False


class Best:
    """The best state of a soup so far, by its error in views that teach nothing."""

    def __init__(self, judge: Raster) -> None:
        self._judge = judge
        self._error = np.inf
        self.since = 0
        """Looks since the best one."""
        self._soup: Soup | None = None

    @property
    def soup(self) -> Soup:
        """A copy of the best state."""
        assert self._soup is not None, "nothing was looked at"
        return self._soup.copy()

    def look(self, soup: Soup) -> None:
        """Look at `soup` as it is now, which may be the best so far."""
        error = soup.error(self._judge)
        self.since += 1
        if error < self._error:
            self._error, self._soup, self.since = error, soup.copy(), 0


@dataclass(frozen=True, eq=False)
class Guide:
    """What guides a search.

    Attributes
    ----------
    lessons, aside : Lessons
        Pictures that teach, and pictures that teach nothing and say what is best.
    seed : int
        Where chance begins.
    device : str or Device, optional
    watch : callable
        Is told how far the search is, and may end it.
    has_look : bool
        Whether the pictures are those of the model's own triangles as they are, of which each is right.
    """

    lessons: Lessons
    aside: Lessons
    seed: int = 0
    device: str | Device | None = None
    watch: Watch = nobody
    has_look: bool = False

    def within(self, pixels: int) -> Guide:
        """Return the same with pictures of so many pixels at most."""
        return replace(self, lessons=self.lessons.within(pixels), aside=self.aside.within(pixels))

    def random(self) -> np.random.Generator:
        """Return chance, which is the same each time."""
        return np.random.default_rng(self.seed)

    @contextmanager
    def rasters(self, soup: Soup) -> Iterator[tuple[Raster, Raster]]:
        """Yield what draws a soup as the lessons see it, and as what is aside does."""
        with closing(Raster(soup.corners, soup.colors, self.lessons, self.device)) as raster:
            yield raster, raster.beside(self.aside)


def colored(mesh: Mesh, lessons: Lessons, device: str | Device | None) -> Mesh:
    """Return `mesh` with the colours at vertices that fit the lessons best; what they do not show keeps its
    own.

    Where a mesh was cut along an edge, vertices of one colour go on having one: with two it has a seam there.
    """
    soup = Soup.of(mesh, shares=True)
    if soup.shared is not None and mesh.vertex_colors is not None:
        soup.shared = _first_alike(mesh, mesh.vertex_colors)[mesh.faces]
    with closing(Raster(soup.corners, soup.colors, lessons, device)) as raster:
        soup.refit(raster)
    return soup.mesh() if soup.shared is None else soup.on(mesh)


def _first_alike(mesh: Mesh, colors: NDArray[Any]) -> Ints:
    """Return for each vertex (V,) the first one of its colour beyond a cut, or itself."""
    first = np.arange(len(mesh.vertices))
    seams = seams_of(mesh.vertices, mesh.faces)
    if seams is not None:
        rows = np.flatnonzero(np.bincount(seams.number)[seams.number] > 1)
        kinds = np.column_stack([seams.number[rows], colors[rows]])
        _, lowest, kind = np.unique(kinds, axis=0, return_index=True, return_inverse=True)
        first[rows] = rows[lowest[kind.reshape(-1)]]
    return first


def plain_mesh(asset: Asset) -> Mesh:
    """Return the triangles of `asset` with colours at vertices, grey where its method has no static ones."""
    if why_not(asset.manifest, "standard") is not None:
        faces = asset.buffers["indices"].astype(np.int64)
        return Mesh(np.array(asset.buffers["positions"]), faces)
    return with_vertex_colors(with_sampled_colors(mesh_from_asset(asset)))


def choose(soup: Soup, asset: Asset, raster: Raster, best: Best, shares: Shares | None) -> None:
    """Leave out the faces that own far more pixels than they deserve, if views aside look better for it.

    What a face deserves is its share in the blending of the model's own look; its colour, until it is
    fitted, is what the lessons show in its place. Without `shares` all faces stay.
    """
    if shares is not None:
        views = len(raster.lessons)
        part = -(-views // _EVERY) / views
        shown = visible_faces(asset, stored_threshold(asset))
        weight, color = (each if shown is None else each[shown] for each in (shares.weight, shares.color))
        weight = weight * (part * raster.pixels / max(shares.pixels, 1))
        if soup.shared is None:
            soup.colors[weight > 0] = color[weight > 0, None].astype(np.float32)
    owned = pixels(soup.refit(raster, _EVERY))
    best.look(soup)
    for limit in LIMITS if shares is not None else ():
        soup.keep &= weight >= limit * owned
        owned = pixels(soup.refit(raster, _EVERY))
        best.look(soup)

"""One closed surface of an opaque soup: what its depths say is solid, with few faces that look right."""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from msb.bake import settle
from msb.bake.arrays import Floats, Ints
from msb.bake.descent import Schedule
from msb.bake.fitted import PIXELS_TO_MOVE
from msb.bake.fusion import REACH, Depths, Grid, drawn_in
from msb.bake.fusion import solid as solid_of
from msb.bake.options import FEWEST_FACES
from msb.bake.shares import pixels_shown
from msb.bake.solid import (
    boundary,
    coarser_unseen,
    compacted,
    crossing_faces,
    parted,
    that_matter,
    uncrossed,
    with_fewer_faces,
    without_detail,
)
from msb.bake.soup import Soup
from msb.bake.space import Space
from msb.bake.start import Best, Guide
from msb.cl import Device
from msb.errors import AssetError
from msb.meshes.mesh import Mesh
from msb.scenes import Camera

OBJECT_FACES = 8_000
# Default face budget of a scene: a face per `_PIXELS_A_FACE` of a view, within these bounds.
SCENE_FACES = 20_000, 50_000
_PIXELS_A_FACE = 2
CELLS = 144  # cells along the longest side, first; then half as many, or twice, if these are better
_COARSEST = 18  # fewest cells that are tried
# Double the grid while the ratio of errors stays below this. Otherwise a finer grid follows the noise of
# the soup, which moving vertices does not remove.
_WORTH = 0.75
_TIME_TO_CHOOSE = 2.0  # seconds below which only one grid is tried; on a scene it takes many times as long
_ABOUT = 1.25  # a face count within this factor of the budget is not reported
# With up to this many faces a two-step simplification is tried as well; beyond it is rarely better.
_FEW = 4_000
LEAST_PART = 1e-4  # share of the pixels of all views below which a part is left out


class Solid(NamedTuple):
    """A closed surface: points (V, 3) inside a space, and faces (F, 3)."""

    points: Floats
    faces: Ints
    space: Space


class Fewer(NamedTuple):
    """A closed surface with about as many faces as were `asked` for, made of one of so many as `whole`.

    Its `error`, in the colours that fit best, is that in views that teach nothing."""

    solid: Solid
    asked: int
    whole: int
    error: float


def surface(
    soup: Mesh, guide: Guide, *, faces: int | None = None, pixels: int = 0, seconds: float = math.inf
) -> tuple[Mesh, list[str]]:
    """Return a closed, manifold, consistently wound mesh that looks like `soup`, coloured at vertices, and
    what should be known of it.

    What the cameras of the lessons see of the soup, which is opaque, says what is solid. That has about so
    many `faces`, else as many as views of so many `pixels` are worth, which then move for so many `seconds`
    at most where pictures that teach nothing look better for it.

    An object is enclosed from outside. A scene, which reaches beyond its cameras, encloses these: its faces
    look inward, and a shell far out shows the sky.

    Raises
    ------
    AssetError
        TRIASSET_EMPTY: no view sees anything that has a volume.
    DeviceError
    """
    guide = guide.within(PIXELS_TO_MOVE)

    def of_cells(cells: int) -> Fewer:
        guide.watch("solid", 0, 1)
        solid = enclosed(soup, guide.lessons.cameras, (cells, cells), device=guide.device)
        guide.watch("fewer faces", 0, 1)
        least, most = SCENE_FACES if solid.space.contracted else (OBJECT_FACES, OBJECT_FACES)
        count = min(max(pixels // _PIXELS_A_FACE, least), most) if faces is None else faces
        return _fewer(solid, count, guide)

    fewer = _best(of_cells) if seconds >= _TIME_TO_CHOOSE else of_cells(CELLS)
    return _settled(fewer, guide, seconds)


def _best(of_cells: Callable[[int], Fewer]) -> Fewer:
    """Return the surface of as many cells as look best: a few of a soup that views hardly know, many of
    leaves."""
    best, coarse = of_cells(CELLS), of_cells(CELLS // 2)
    if best.error < _WORTH * coarse.error:
        return min(best, of_cells(2 * CELLS), key=lambda fewer: fewer.error)
    cells = CELLS // 2
    while coarse.error < best.error:
        best, cells = coarse, cells // 2
        if cells >= _COARSEST:
            coarse = of_cells(cells)
    return best


def enclosed(
    soup: Mesh,
    cameras: Sequence[Camera],
    cells: tuple[int, int],
    margin: float = REACH,
    *,
    device: str | Device | None = None,
) -> Solid:
    """Return the surface of what cameras see of a soup, closed.

    So many `cells` lie along the longest side of an object, and of a scene, and `margin` around an object:
    what no camera looks at is closed that far away.

    Raises
    ------
    AssetError
        TRIASSET_EMPTY: no camera sees anything that has a volume.
    DeviceError
    """
    with closing(Depths(soup, device)) as depths:
        points = depths.points(cameras)
        if not len(points):
            raise AssetError("TRIASSET_EMPTY", "no view sees anything opaque; a surface is made of what is")
        space = Space.of(points, cameras)
        scene = space.contracted
        grid = Grid.over(space, cells[scene], margin)
        votes = depths.votes(cameras, space, grid)
    values = solid_of(votes, space, grid)
    if not values.min() < 0 < values.max():
        raise AssetError("TRIASSET_EMPTY", "what the views see encloses nothing; a surface needs a volume")
    places, made = boundary(values, grid, -1.0 if scene else 1.0)
    places = drawn_in(places, values, grid)
    return _parts_seen(Solid(places, made, space), cameras, device)


def _parts_seen(solid: Solid, cameras: Sequence[Camera], device: str | Device | None) -> Solid:
    """Return the parts of a surface that cameras see enough of, and the largest one."""
    points, faces, space = solid
    if not len(faces):
        return solid
    least = LEAST_PART * sum(camera.width * camera.height for camera in cameras)
    matters = that_matter(points, faces, _pixels(solid, cameras, device), least)
    return Solid(*compacted(points, faces[matters]), space)


def _pixels(solid: Solid, cameras: Sequence[Camera], device: str | Device | None) -> Ints:
    """Return how many pixels (F,) of all cameras show each face."""
    return sum(pixels_shown(_mesh(solid), cameras, device), np.zeros(len(solid.faces), np.int64))


def _mesh(solid: Solid) -> Mesh:
    return Mesh(solid.space.outward(solid.points).astype(np.float32), solid.faces)


def taught(
    solid: Solid,
    count: int,
    guide: Guide,
    seconds: float = math.inf,
    steps: int | None = None,
    *,
    like: Mesh | None = None,
) -> tuple[Mesh, list[str]]:
    """Return a surface like `solid` with about `count` faces that look right, and what should be known of it.

    They take so many `steps`, if there are so many `seconds`. What no view sees has the colours of `like`.

    Raises
    ------
    AssetError
        TRIASSET_EMPTY: of so few faces nothing is left.
    DeviceError
    """
    return _settled(_fewer(solid, count, guide), guide, seconds, steps, like)


def with_colors_of(mesh: Mesh, fewer: Mesh) -> Mesh:
    """Return `fewer` in the colours that the vertices of `mesh` next to its own have: what no view sees keeps
    these."""
    from scipy.spatial import cKDTree

    if mesh.vertex_colors is None:
        return fewer
    nearest = cKDTree(mesh.vertices.astype(np.float64)).query(fewer.vertices.astype(np.float64))[1]
    return replace(fewer, vertex_colors=mesh.vertex_colors[nearest])


def _settled(
    fewer: Fewer, guide: Guide, seconds: float, steps: int | None = None, like: Mesh | None = None
) -> tuple[Mesh, list[str]]:
    """Return a surface with its vertices where pictures want them, and what should be known of it."""
    (points, made, space), count, whole, _ = fewer
    if not len(made):
        raise AssetError("TRIASSET_EMPTY", f"no closed surface is left of {count} faces; ask for more")
    mesh = _mesh(fewer.solid)
    soup = Soup.of(mesh if like is None else with_colors_of(like, mesh), shares=True)
    with guide.rasters(soup) as (raster, judge):
        soup.refit(raster)
        best = Best(judge)
        best.look(soup)
        schedule = Schedule(steps or settle.STEPS, time.monotonic() + seconds)
        settle.settle(points, soup, raster, best, space, guide, schedule)
        soup = best.soup
    mesh = parted(soup.on(_moved(mesh, soup)))
    notes = schedule.lacks("its vertices")
    if len(made) > _ABOUT * count:
        notes.append(f"it has {len(made):,} faces, not {count:,}: with fewer it did not stay closed")
    elif len(made) * _ABOUT < min(count, whole):
        notes.append(f"it has {len(made):,} faces, not {count:,}: the others were of what nobody sees")
    if crossing := len(crossing_faces(space.inward(mesh.vertices.astype(np.float64)), made, space)):
        notes.append(f"{crossing:,} faces of the surface cross others: what mends that did not help")
    return mesh, notes


def _fewer(solid: Solid, count: int, guide: Guide) -> Fewer:
    """Return a surface with about `count` faces of which none cross.

    The best of some: hardly any of its faces lie where nothing is seen, which is best unless something so
    coarse went through what is seen; or they lie everywhere; or, if they are few, they are made of twice as
    many, so that what is thin is mended on the way."""
    count, whole = max(count, FEWEST_FACES), len(solid.faces)
    cameras = guide.lessons.cameras
    solid = Solid(*without_detail(*solid[:2], count, solid.space), solid.space)
    pixels = _pixels(solid, cameras, guide.device) / len(cameras)
    spared = Solid(*coarser_unseen(*solid[:2], pixels, count, solid.space), solid.space)
    begun = [spared, solid]
    if count <= _FEW:
        begun.append(_collapsed(spared, 2 * count, guide))
    made = (_collapsed(each, count, guide) for each in begun)
    return min(
        (Fewer(each, count, whole, _error(each, guide)) for each in made), key=lambda fewer: fewer.error
    )


def _collapsed(solid: Solid, count: int, guide: Guide) -> Solid:
    """Return a surface with about `count` faces, none of which cross, by quadric error."""
    points, faces, space = solid
    fewer = uncrossed(*with_fewer_faces(points, faces, count, space), space)
    # With fewer faces what is thin comes apart, and leaves specks that nobody sees.
    return _parts_seen(Solid(*fewer, space), guide.lessons.cameras, guide.device)


def _error(solid: Solid, guide: Guide) -> float:
    """Return the error of a surface, in the colours that fit best, in views that teach nothing."""
    if not len(solid.faces):
        return math.inf
    soup = Soup.of(_mesh(solid), shares=True)
    with guide.rasters(soup) as (raster, judge):
        soup.refit(raster)
        return soup.error(judge)


def _moved(mesh: Mesh, soup: Soup) -> Mesh:
    """Return `mesh` with its vertices where the corners of `soup` are."""
    vertices = mesh.vertices.copy()
    vertices[mesh.faces.reshape(-1)] = soup.corners.reshape(-1, 3)
    return Mesh(vertices, mesh.faces)

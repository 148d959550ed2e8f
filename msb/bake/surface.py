"""One closed surface of an opaque soup: what its depths say is solid, with few faces that look right."""

from __future__ import annotations

import math
import time
from contextlib import closing
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.bake import settle
from msb.bake.descent import Schedule
from msb.bake.fitted import PIXELS_TO_MOVE
from msb.bake.fusion import REACH, Depths, Grid, drawn_in, solid
from msb.bake.shares import pixels_shown
from msb.bake.solid import (
    FEWEST_FACES,
    boundary,
    coarser_unseen,
    compacted,
    crossing_faces,
    parted,
    that_matter,
    uncrossed,
    with_fewer_faces,
)
from msb.bake.soup import Soup
from msb.bake.space import Space
from msb.bake.start import Best, Guide
from msb.base.extras import need_extra
from msb.errors import AssetError
from msb.meshes.mesh import Mesh

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msb.cl import Device
    from msb.scenes import Camera

FACES = 8_000, 20_000
"""Faces of an object and of a scene, where it is not said how many."""
CELLS = 288, 288
"""Cells along the longest side of an object, whose thin parts need as many, and of a scene."""
_ABOUT = 1.25
"""How many times the faces asked for are about as many."""
_PATIENCE = 1.5
"""How many times the steps of a whole surface a level takes, whose faces have to make up for others."""
LEAST_PART = 1e-4
"""Share of the pixels of all views below which a part is left out."""


def surface(
    soup: Mesh, guide: Guide, *, faces: int | None = None, seconds: float = math.inf
) -> tuple[Mesh, list[str]]:
    """Return a closed, manifold, consistently wound mesh that looks like `soup`, coloured at vertices, and
    what should be known of it.

    What the cameras of the lessons see of the soup, which is opaque, says what is solid. That has about so
    many `faces`, which then move for so many `seconds` at most where pictures that teach nothing look
    better for it.

    An object is enclosed from outside. A scene, which reaches beyond its cameras, encloses these: its faces
    look inward, and a shell far out shows the sky.

    Raises
    ------
    UsageError
        EXTRA_MISSING.
    AssetError
        TRIASSET_EMPTY: no view sees anything that has a volume.
    DeviceError
    """
    need_extra("bench", "skimage", what="a closed surface")
    need_extra("trial", "fast_simplification", what="a closed surface")
    guide = guide.within(PIXELS_TO_MOVE)
    guide.watch("solid", 0, 1)
    places, made, space = enclosed(soup, guide.lessons.cameras, CELLS, device=guide.device)
    guide.watch("fewer faces", 0, 1)
    count = FACES[space.contracted] if faces is None else faces
    return taught(places, made, count, space, guide, seconds)


def enclosed(
    soup: Mesh,
    cameras: Sequence[Camera],
    cells: tuple[int, int],
    margin: float = REACH,
    *,
    device: str | Device | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.int64], Space]:
    """Return the surface of what cameras see of a soup, closed: places inside a space, faces, the space.

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
    values = solid(votes, space, grid)
    if not values.min() < 0 < values.max():
        raise AssetError("TRIASSET_EMPTY", "what the views see encloses nothing; a surface needs a volume")
    places, made = boundary(values, grid, -1.0 if scene else 1.0)
    places = drawn_in(places, values, grid)
    return *_parts_seen(places, made, space, cameras, device), space


def _parts_seen(
    places: NDArray[np.float64],
    faces: NDArray[np.int64],
    space: Space,
    cameras: Sequence[Camera],
    device: str | Device | None,
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the parts of a surface that cameras see enough of, and the largest one."""
    least = LEAST_PART * sum(camera.width * camera.height for camera in cameras)
    pixels = _pixels(places, faces, space, cameras, device)
    return compacted(places, faces[that_matter(places, faces, pixels, least)])


def _pixels(
    places: NDArray[np.float64],
    faces: NDArray[np.int64],
    space: Space,
    cameras: Sequence[Camera],
    device: str | Device | None,
) -> NDArray[np.int64]:
    """Return how many pixels (F,) of all cameras show each face."""
    mesh = Mesh(space.outward(places).astype(np.float32), faces)
    return sum(pixels_shown(mesh, cameras, device), np.zeros(len(faces), np.int64))


def taught(
    places: NDArray[np.float64],
    faces: NDArray[np.int64],
    count: int,
    space: Space,
    guide: Guide,
    seconds: float = math.inf,
    *,
    is_level: bool = False,
) -> tuple[Mesh, list[str]]:
    """Return a closed surface, with places inside `space`, with about `count` faces that look right, and what
    should be known of it.

    One that is a level of detail of another has no faces to spare where nothing is seen, and takes half as
    many steps again, if there are so many `seconds`.

    Raises
    ------
    AssetError
        TRIASSET_EMPTY: of so few faces nothing is left.
    DeviceError
    """
    count = max(count, FEWEST_FACES)
    if is_level:
        placed, made = uncrossed(*with_fewer_faces(places, faces, count, space), space)
    else:
        placed, made = _spared(places, faces, count, space, guide)
    if not len(made):
        raise AssetError("TRIASSET_EMPTY", f"no closed surface is left of {count} faces; ask for more")
    # With fewer faces what is thin comes apart, and leaves specks that nobody sees.
    places, made = _parts_seen(placed, made, space, guide.lessons.cameras, guide.device)
    mesh = Mesh(space.outward(places).astype(np.float32), made)
    soup = Soup.of(mesh, shares=True)
    with guide.rasters(soup) as (raster, judge):
        soup.refit(raster)
        best = Best(judge)
        best.look(soup)
        schedule = Schedule(round((_PATIENCE if is_level else 1) * settle.STEPS), time.monotonic() + seconds)
        settle.settle(places, soup, raster, best, space, guide, schedule)
        soup = best.soup
    mesh = parted(soup.on(_moved(mesh, soup)))
    notes = schedule.lacks("its vertices")
    if len(made) > _ABOUT * count:
        notes.append(f"it has {len(made):,} faces, not {count:,}: with fewer it did not stay closed")
    elif len(made) * _ABOUT < min(count, len(faces)):
        notes.append(f"it has {len(made):,} faces, not {count:,}: the others were of what nobody sees")
    if crossing := len(crossing_faces(space.inward(mesh.vertices.astype(np.float64)), made, space)):
        notes.append(f"{crossing:,} faces of the surface cross others: what mends that did not help")
    return mesh, notes


def _spared(
    places: NDArray[np.float64], faces: NDArray[np.int64], count: int, space: Space, guide: Guide
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return a surface with about `count` faces: none cross, and hardly any lie where nothing is seen.

    Where something so coarse went through what is seen, and was cut out with it, it is held against one with
    faces everywhere, and the better one is taken."""
    cameras = guide.lessons.cameras
    pixels = _pixels(places, faces, space, cameras, guide.device) / len(cameras)
    fewer = with_fewer_faces(*coarser_unseen(places, faces, pixels, count, space), count, space)
    spared = uncrossed(*fewer, space)
    if len(spared[1]) == len(fewer[1]):
        return spared
    even = uncrossed(*with_fewer_faces(places, faces, count, space), space)
    return min(spared, even, key=lambda made: _error(made, space, guide))


def _error(made: tuple[NDArray[np.float64], NDArray[np.int64]], space: Space, guide: Guide) -> float:
    """Return the error of a surface, in the colours that fit best, in views that teach nothing."""
    places, faces = made
    if not len(faces):
        return math.inf
    soup = Soup.of(Mesh(space.outward(places).astype(np.float32), faces), shares=True)
    with guide.rasters(soup) as (raster, judge):
        soup.refit(raster)
        return soup.error(judge)


def _moved(mesh: Mesh, soup: Soup) -> Mesh:
    """Return `mesh` with its vertices where the corners of `soup` are."""
    vertices = mesh.vertices.copy()
    vertices[mesh.faces.reshape(-1)] = soup.corners.reshape(-1, 3)
    return Mesh(vertices, mesh.faces)

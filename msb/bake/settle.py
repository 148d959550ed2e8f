"""Where the vertices of a closed surface should be: descent on the error of its pictures, without crossings.

The slopes of the error (`msb.bake.raster`) are summed at vertices that faces share, and smoothed over the
surface before they move it, so that a step bends it instead of folding it (Nicolet et al. 2021). Steps are
taken inside the surface's space, where faces are of similar size. Every few steps vertices of faces that
cross go back to where they did not."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msb.bake import colors
from msb.bake.arrays import Floats, Ints
from msb.bake.descent import LOOK, MEMORY, RECOLOR, Adam, Schedule
from msb.bake.search import some_views
from msb.bake.solid import put_back

if TYPE_CHECKING:
    from msb.bake.raster import Raster
    from msb.bake.soup import Soup
    from msb.bake.space import Space
    from msb.bake.start import Best, Guide


STIFF = 0.5  # smoothing of the slopes: squared width, in edges
STEPS = 200
RATES = 0.12, 0.01  # mean step of a vertex in edge lengths, at the start and at the end
_FARTHEST = 4.0  # largest move of a vertex in a step, in rates


def settle(
    points: Floats,
    soup: Soup,
    raster: Raster,
    best: Best,
    space: Space,
    guide: Guide,
    schedule: Schedule,
) -> None:
    """Move the vertices at `points` (V, 3) inside `space` where `soup`, whose faces share them, looks better
    for it; no more faces cross than did. `best` looks every few steps.

    There are as many steps as `schedule` has and the guide's watch allows."""
    from scipy.sparse import identity
    from scipy.sparse.linalg import splu

    assert soup.shared is not None
    faces, count = soup.shared, len(points)
    bending = identity(count, format="csr") + STIFF * colors.laplacian(faces, count)
    smooth = splu(bending.tocsc()).solve
    good, moved = points, bending @ points
    adam = Adam(_FARTHEST)
    memory = None
    random = guide.random()
    step, share = 0, 0.0
    while share < 1:
        step += 1
        seen = raster.seen(some_views(raster, random))
        new = _at_vertices(seen.slopes.astype(np.float64), faces, count)
        new = smooth(space.pulled(points, new))
        move = adam.move(new, float(np.square(new[new.any(axis=1)]).sum(axis=1).mean()))
        first, last = RATES
        rate = first + (last - first) * share
        moved -= rate * _edge(points, faces) * move
        points = space.held(smooth(moved))
        memory = seen.sums if memory is None else MEMORY * memory + seen.sums
        share = schedule.share(step, enough=guide.watch("moving vertices", step, schedule.steps))
        looks = step % LOOK == 0 or share >= 1
        if looks:
            good = put_back(points, good, faces, space)
            points, moved = good, bending @ good
        soup.corners[:] = space.outward(points)[faces]
        soup.put_on(raster)
        if looks:
            soup.refit(raster)
            best.look(soup)
        elif step % RECOLOR == 0:
            soup.recolor(seen._replace(sums=memory))


def _at_vertices(values: Floats, faces: Ints, count: int) -> Floats:
    """Return the sums (V, 3) at vertices of values at corners (F, 3, 3)."""
    corners = faces.reshape(-1)
    sums = [np.bincount(corners, values[:, :, axis].reshape(-1), minlength=count) for axis in range(3)]
    return np.stack(sums, axis=1)


def _edge(points: Floats, faces: Ints) -> float:
    """Return the usual length of an edge."""
    return float(np.median(np.linalg.norm(points[faces[:, 0]] - points[faces[:, 1]], axis=1)))

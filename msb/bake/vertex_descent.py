"""Move the vertices of a closed surface by gradient descent, and prevent crossing faces.

The gradients of the error (`msb.bake.soup_renderer`) are added up at shared vertices. The gradients are then
smoothed over the surface, so that a step bends the surface instead of folding it (Nicolet et al. 2021). Steps
are taken in the contracted coordinates of the surface, where faces have similar sizes. Every few steps, the
vertices of crossing faces are moved back to places without crossings.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msb.bake import color_fit
from msb.bake.arrays import Floats, Ints
from msb.bake.closed_mesh import revert_crossings
from msb.bake.descent import COLOR_DECAY, COLOR_STEPS, VALIDATION_STEPS, Adam, StepSchedule
from msb.bake.face_selection import sample_views
from msb.bake.fairing import Neighbours, filter_normals, find_neighbours, follow_normals

if TYPE_CHECKING:
    from msb.bake.context import BestState
    from msb.bake.soup import Soup
    from msb.bake.soup_renderer import SoupRenderer
    from msb.bake.space import Space

# Smoothing of the gradients: the squared width of the filter in edge lengths. More smoothing of the gradients
# prevents folds but loses detail.
SMOOTHING = 0.5
# Number of descent steps without a time limit. With this number of steps, a surface of a demo model takes
# about 45 s on two cores.
STEPS = 200
# Average move of a vertex per step in edge lengths. The two values are for the first and the last step.
STEP_LENGTHS = 0.12, 0.01
# Largest move of a vertex per step, relative to the average move. Some gradients of the error are much larger
# than the average.
_MAX_MOVE = 4.0
# Share by which vertices follow the filtered normals after each step. The second value is the number of
# filter rounds. Without fairing, the search brings dents back. A larger share of fairing loses detail.
FAIR_SHARE, _FAIR_ROUNDS = 0.1, 2


def move_vertices(
    points: Floats,
    soup: Soup,
    renderer: SoupRenderer,
    best: BestState,
    space: Space,
    random: np.random.Generator,
    schedule: StepSchedule,
) -> None:
    """Move the vertices of `soup` to reduce the error.

    The argument `points` (V, 3) contains the vertices in the coordinates of `space`. The moves cause no
    further crossing faces. The object `best` evaluates the state of the soup every few steps.
    """
    from scipy.sparse import identity
    from scipy.sparse.linalg import splu

    assert soup.shared is not None
    faces, count = soup.shared, len(points)
    # `smooth` solves the system (I + SMOOTHING * Laplacian) x = b. The descent changes `variables`, the right
    # side b of this system. The solution x gives the points.
    bending = identity(count, format="csr") + SMOOTHING * color_fit.make_edge_laplacian(faces, count)
    smooth = splu(bending.tocsc()).solve
    good, variables = points, bending @ points
    neighbours = find_neighbours(faces, count)
    adam = Adam(_MAX_MOVE)
    sums = None
    step, share = 0, 0.0
    while share < 1:
        step += 1
        # Compute the gradients (V, 3) of the error in the views of this step, with respect to the smoothed
        # variables.
        seen = renderer.sum_faces(sample_views(renderer, random))
        gradients = _sum_at_vertices(seen.gradients.astype(np.float64), faces, count)
        gradients = smooth(space.pull_back(points, gradients))
        moving = gradients[gradients.any(axis=1)]
        square = float(np.square(moving).sum(axis=1).mean()) if len(moving) else 0.0
        move = adam.compute_move(gradients, square)
        # Change the variables by one step, and compute the points from the variables.
        first, last = STEP_LENGTHS
        length = first + (last - first) * share
        variables -= length * _measure_median_edge(points, faces) * move
        points = space.clamp(smooth(variables))
        points = _fair(points, faces, neighbours, space)
        variables = bending @ points
        sums = seen.sums if sums is None else COLOR_DECAY * sums + seen.sums
        share = schedule.finish_step(step)
        # Before each validation and at the end, move vertices of crossing faces back.
        is_validated = step % VALIDATION_STEPS == 0 or share >= 1
        if is_validated:
            good = revert_crossings(points, good, faces, space)
            points, variables = good, bending @ good
        soup.corners[:] = space.to_world(points)[faces]
        soup.upload(renderer)
        if is_validated:
            soup.refit_colors(renderer)
            best.evaluate(soup)
        elif step % COLOR_STEPS == 0:
            soup.fit_colors(seen._replace(sums=sums))


def _fair(points: Floats, faces: Ints, neighbours: Neighbours, space: Space) -> Floats:
    """Make a small step of fairing in world coordinates. Return the points (V, 3) in the coordinates of
    `space`."""
    world = space.to_world(points)
    normals = filter_normals(world, faces, neighbours, _FAIR_ROUNDS)
    return space.clamp(space.from_world(follow_normals(world, faces, normals, FAIR_SHARE)))


def _sum_at_vertices(values: Floats, faces: Ints, count: int) -> Floats:
    """Add up the values at the corners (F, 3, 3) of each vertex. Return sums (V, 3)."""
    corners = faces.reshape(-1)
    sums = [np.bincount(corners, values[:, :, axis].reshape(-1), minlength=count) for axis in range(3)]
    return np.stack(sums, axis=1)


def _measure_median_edge(points: Floats, faces: Ints) -> float:
    """Return the median length of the first edges of the faces."""
    return float(np.median(np.linalg.norm(points[faces[:, 0]] - points[faces[:, 1]], axis=1)))

"""The candidate `surface`: a closed surface of few faces.

Depth maps vote which grid cells are solid, and the surface encloses the solid cells.
"""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from msb.asset import Asset
from msb.bake import closed_mesh, vertex_descent
from msb.bake.arrays import Floats, Ints
from msb.bake.blending_weights import count_pixels_by_view
from msb.bake.candidate_fitted import PIXELS_TO_MOVE
from msb.bake.context import BestState, SearchContext
from msb.bake.depth_fusion import (
    REACH,
    DepthRenderer,
    Grid,
    NativeDepthRenderer,
    complete_votes,
    pull_in,
)
from msb.bake.descent import StepSchedule
from msb.bake.fairing import fair, smooth
from msb.bake.shape import measure_bending
from msb.bake.soup import Soup
from msb.bake.space import Space
from msb.cl import Device
from msb.delivery.collision_kinds import MIN_CLOSED_FACES
from msb.errors import AssetError
from msb.meshes.mesh import Mesh
from msb.scenes import Camera

# Default face budget of an object. More faces raise the PSNR, but they follow the dents of the depth maps.
# With 12,000 instead of 8,000 faces, a demo surface gained 0.3 dB and its normals became 1 degree worse.
OBJECT_FACES = 10_000
# Smallest and largest default face budget of a scene. Between these two limits, the face budget is one face
# per 2 pixels of a view. A larger face budget makes each step slower.
SCENE_FACES = 20_000, 50_000
_PIXELS_PER_FACE = 2
# Number of cells along the longest side of the first grid. Grids with half and twice as many cells are tried
# as well.
CELLS = 144
# The coarsest grid has 144 / 8 cells along its longest side.
_MIN_CELLS = 18
# A grid of 288 cells per side is tried if the error with 144 cells is below 75 % of the error with 72 cells.
# Without this condition, a finer grid would follow the noise of the soup. Moving vertices does not remove
# this noise. With an uneven soup, a grid of 288 cells lost up to 8 dB. Below this ratio, the finer grid gains
# up to 1.4 dB of PSNR.
_MAX_ERROR_RATIO = 0.75
# If the time limit for moving vertices is below this value, only one grid is tried. For a scene, further
# grids would take many times as long.
_MIN_SECONDS_TO_COMPARE = 2.0
# A note is printed if the face count differs from the budget by more than this factor.
_BUDGET_TOLERANCE = 1.25
# Up to this face budget, a reduction in two steps is also tried, because two steps preserve thin parts. With
# a larger budget, the reduction in two steps is rarely better.
_TWO_STEP_FACES = 4_000
# In the search, the error is multiplied by a penalty: the relative bending of the surface, raised to this
# power. The relative bending is 1 at the start. With this power, a surface with 10 % more bending is only
# better if its PSNR is 0.2 dB higher.
_BENDING_POWER = 0.5
# These values apply to surfaces that are made from a model's own depths. The first value is the number of
# smoothing rounds before the face reduction. The second value is the number of steps that move the vertices.
# More fairing or more steps would remove details, such as the features of a face, and cost up to 0.4 dB.
_SMOOTH_TURNS, _OWN_DEPTH_STEPS = 10, 1
# A part is removed as a speck if it covers less than this share of the pixels of all views.
MIN_PART_SHARE = 1e-4


class ClosedSurface(NamedTuple):
    """A closed surface: faces (F, 3) and points (V, 3) in the coordinates of `space`."""

    points: Floats
    faces: Ints
    space: Space


class ReducedSurface(NamedTuple):
    """A closed surface with about `budget` faces, reduced from `original_faces` faces.

    The field `error` is the validation error of the surface with the best vertex colours.
    """

    surface: ClosedSurface
    budget: int
    original_faces: int
    error: float


def make_surface(
    model: Mesh | Asset,
    context: SearchContext,
    *,
    faces: int | None = None,
    pixels: int = 0,
    seconds: float = math.inf,
) -> tuple[Mesh, list[str]]:
    """Return a closed, manifold, consistently wound mesh that looks like `model`, and notes for the user.

    The model is an opaque soup, or Gaussians. The depths of the model in the training views define a solid.
    The boundary of the solid is reduced to about `faces` faces. The default number of faces depends on
    `pixels`, the number of pixels of a view. The vertices are then moved for at most `seconds`, and the state
    with the smallest validation error is kept. The resulting mesh has vertex colours.

    An object is enclosed from outside. A scene is enclosed from inside. The faces of a scene look inwards,
    and a distant shell shows the sky.

    Raises
    ------
    AssetError
        TRIASSET_EMPTY: no view sees anything that has a volume.
    DeviceError
    """
    context = context.limited_to(PIXELS_TO_MOVE)

    def reduce_grid(cells: int) -> ReducedSurface:
        context.progress("solid", 0, 1)
        surface = enclose(model, context.training.cameras, (cells, cells), device=context.device)
        context.progress("fewer faces", 0, 1)
        least, most = SCENE_FACES if surface.space.contracted else (OBJECT_FACES, OBJECT_FACES)
        budget = min(max(pixels // _PIXELS_PER_FACE, least), most) if faces is None else faces
        return _reduce(surface, budget, context)

    has_time = seconds >= _MIN_SECONDS_TO_COMPARE
    reduced = _choose_grid(reduce_grid) if has_time else reduce_grid(CELLS)
    return _fit_surface(reduced, context, seconds)


def _choose_grid(reduce_grid: Callable[[int], ReducedSurface]) -> ReducedSurface:
    """Make surfaces with several grid sizes. Return the surface with the smallest validation error.

    A coarse grid is better for a soup that only few views show. A fine grid suits thin parts such as leaves.
    """
    best, coarse = reduce_grid(CELLS), reduce_grid(CELLS // 2)
    if best.error < _MAX_ERROR_RATIO * coarse.error:
        return min(best, reduce_grid(2 * CELLS), key=lambda reduced: reduced.error)
    cells = CELLS // 2
    while coarse.error < best.error:
        best, cells = coarse, cells // 2
        if cells >= _MIN_CELLS:
            coarse = reduce_grid(cells)
    return best


def enclose(
    model: Mesh | Asset,
    cameras: Sequence[Camera],
    cells: tuple[int, int],
    margin: float = REACH,
    *,
    device: str | Device | None = None,
) -> ClosedSurface:
    """Return the closed surface around the visible parts of a soup, or of Gaussians.

    The argument `cells` has two values, for objects and for scenes. Each value is the number of cells along
    the longest side. The unseen sides of an object are closed by planes at the distance `margin` in cells.

    Raises
    ------
    AssetError
        TRIASSET_EMPTY: no camera sees anything that has a volume.
    DeviceError
    """
    renderer: DepthRenderer
    if isinstance(model, Mesh):
        renderer = DepthRenderer(model, device)
    else:
        renderer = NativeDepthRenderer(model, device)
    with closing(renderer):
        points = renderer.sample_visible_points(cameras)
        if not len(points):
            text = "no view shows an opaque part of the model, so no surface can be made; pass other cameras"
            raise AssetError("TRIASSET_EMPTY", text)
        space = Space.fit(points, cameras)
        is_scene = space.contracted
        grid = Grid.covering(space, cells[is_scene], margin)
        votes = renderer.vote(cameras, space, grid)
    values = complete_votes(votes, space, grid)
    if not values.min() < 0 < values.max():
        text = "the visible parts of the model enclose no volume, so no surface can be made"
        raise AssetError("TRIASSET_EMPTY", text)
    boundary, faces = closed_mesh.extract_boundary(values, grid, -1.0 if is_scene else 1.0)
    boundary = pull_in(boundary, values, grid)
    if isinstance(model, Asset):
        boundary = smooth(boundary, faces, _SMOOTH_TURNS)
    return _drop_specks(ClosedSurface(boundary, faces, space), cameras, device)


def _drop_specks(
    surface: ClosedSurface, cameras: Sequence[Camera], device: str | Device | None
) -> ClosedSurface:
    """Return a surface without specks (see `MIN_PART_SHARE`). The most visible part is never dropped."""
    points, faces, space = surface
    if not len(faces):
        return surface
    least = MIN_PART_SHARE * sum(camera.width * camera.height for camera in cameras)
    is_visible = closed_mesh.select_visible_parts(
        points, faces, _count_pixels(surface, cameras, device), least
    )
    return ClosedSurface(*closed_mesh.drop_unused_points(points, faces[is_visible]), space)


def _count_pixels(surface: ClosedSurface, cameras: Sequence[Camera], device: str | Device | None) -> Ints:
    """Return the number of pixels (F,) over all cameras that show each face."""
    counts = count_pixels_by_view(_to_mesh(surface), cameras, device)
    return sum(counts, np.zeros(len(surface.faces), np.int64))


def _to_mesh(surface: ClosedSurface) -> Mesh:
    return Mesh(surface.space.to_world(surface.points).astype(np.float32), surface.faces)


def refit_surface(
    surface: ClosedSurface,
    count: int,
    context: SearchContext,
    seconds: float = math.inf,
    steps: int | None = None,
    *,
    colored: Mesh | None = None,
) -> tuple[Mesh, list[str]]:
    """Return a surface like `surface` with about `count` faces, fitted to the images, and notes for the user.

    The vertices move for `steps` steps, or until `seconds` are over. Unseen parts copy the colours of
    `colored`.

    Raises
    ------
    AssetError
        TRIASSET_EMPTY: no surface is left with this number of faces.
    DeviceError
    """
    return _fit_surface(_reduce(surface, count, context), context, seconds, steps, colored)


def copy_nearest_colors(colored: Mesh, mesh: Mesh) -> Mesh:
    """Return `mesh` with the vertex colours of the nearest vertices of `colored`.

    If `colored` has no vertex colours, return `mesh` unchanged.
    """
    from scipy.spatial import cKDTree

    if colored.vertex_colors is None:
        return mesh
    nearest = cKDTree(colored.vertices.astype(np.float64)).query(mesh.vertices.astype(np.float64))[1]
    return replace(mesh, vertex_colors=colored.vertex_colors[nearest])


def _fit_surface(
    reduced: ReducedSurface,
    context: SearchContext,
    seconds: float,
    steps: int | None = None,
    colored: Mesh | None = None,
) -> tuple[Mesh, list[str]]:
    """Return a surface whose vertices were moved and coloured to match the images, and notes for the user."""
    (points, faces, space), budget, original_faces, _ = reduced
    if not len(faces):
        text = f"no closed surface is left with {budget} faces; pass a larger number of faces"
        raise AssetError("TRIASSET_EMPTY", text)
    mesh = _to_mesh(reduced.surface)
    start = mesh if colored is None else copy_nearest_colors(colored, mesh)
    soup = Soup.from_mesh(start, share_colors=True)
    with context.open_renderers(soup) as (renderer, validation):
        soup.refit_colors(renderer)
        best = BestState(validation, _make_shape_weight(points, faces, space))
        best.evaluate(soup)
        progress = partial(context.progress, "moving vertices")
        normal = steps or vertex_descent.STEPS
        if context.has_own_depths:
            normal = min(normal, _OWN_DEPTH_STEPS)
        schedule = StepSchedule(context.count_steps(normal), time.monotonic() + seconds, progress)
        random = context.make_random()
        vertex_descent.move_vertices(points, soup, renderer, best, space, random, schedule)
        soup = best.soup
    mesh = closed_mesh.separate_vertices(soup.apply_to(_move_vertices(mesh, soup)))
    notes = schedule.notes("moving the vertices")
    if len(faces) > _BUDGET_TOLERANCE * budget:
        notes.append(f"the surface needs {len(faces):,} faces instead of {budget:,} to stay closed")
    elif len(faces) * _BUDGET_TOLERANCE < min(budget, original_faces):
        text = f"the surface has {len(faces):,} faces instead of the requested {budget:,}"
        notes.append(f"{text}, because unseen parts were removed")
    crossing = closed_mesh.find_crossing_faces(
        space.from_world(mesh.vertices.astype(np.float64)), faces, space
    )
    if len(crossing):
        notes.append(f"{len(crossing):,} faces of the surface cross other faces and could not be repaired")
    return mesh, notes


def _make_shape_weight(points: Floats, faces: Ints, space: Space) -> Callable[[Soup], float]:
    """Return a function that computes a factor for the error. The factor grows with the bending of the
    surface.

    Without this factor, the search would accept dents for a gain of a fraction of a dB (see
    `_BENDING_POWER`).
    """
    everything = np.ones(len(faces), bool)
    start = measure_bending(space.to_world(points), faces, everything).bending

    def weigh(soup: Soup) -> float:
        world = np.zeros((len(points), 3))
        world[faces.reshape(-1)] = soup.corners.reshape(-1, 3)
        bending = measure_bending(world, faces, everything).bending
        return float(max(1.0, bending / max(start, 1e-9)) ** _BENDING_POWER)

    return weigh


def _reduce(surface: ClosedSurface, budget: int, context: SearchContext) -> ReducedSurface:
    """Make two or three surfaces with about `budget` faces and without crossing faces.

    Return the surface with the smallest validation error. In the first surface, vertices of unseen parts are
    merged before the reduction. In the second surface, these vertices are not merged, because merged parts
    may cut through visible parts. With a small budget, a third surface is made. The third surface is reduced
    to twice as many faces. Then its thin parts are repaired, and the surface is reduced again.
    """
    budget, original_faces = max(budget, MIN_CLOSED_FACES), len(surface.faces)
    cameras, space = context.training.cameras, surface.space
    whole = ClosedSurface(*closed_mesh.remove_detail(*surface[:2], budget, space), space)
    pixels = _count_pixels(whole, cameras, context.device) / len(cameras)
    spared = ClosedSurface(*closed_mesh.coarsen_unseen(*whole[:2], pixels, budget, space), space)
    starts = [spared, whole]
    if budget <= _TWO_STEP_FACES:
        starts.append(_reduce_uncrossed(spared, 2 * budget, context))
    candidates = (_reduce_uncrossed(start, budget, context) for start in starts)
    errors = ((candidate, _measure_validation_error(candidate, context)) for candidate in candidates)
    best, error = min(errors, key=lambda pair: pair[1])
    return ReducedSurface(best, budget, original_faces, error)


def _reduce_uncrossed(surface: ClosedSurface, count: int, context: SearchContext) -> ClosedSurface:
    """Reduce a surface to about `count` faces by quadric error, and remove crossing faces and specks."""
    points, faces, space = surface
    points, faces = closed_mesh.reduce_faces(points, faces, count, space)
    if not context.has_own_depths:
        points = space.clamp(space.from_world(fair(space.to_world(points), faces)))
    reduced = closed_mesh.remove_crossings(points, faces, space)
    # With fewer than twice the requested faces, thin parts fall apart and leave specks.
    return _drop_specks(ClosedSurface(*reduced, space), context.training.cameras, context.device)


def _measure_validation_error(surface: ClosedSurface, context: SearchContext) -> float:
    """Fit vertex colours to a surface, and return its validation error.

    If the surface has no faces, the error is infinity.
    """
    if not len(surface.faces):
        return math.inf
    soup = Soup.from_mesh(_to_mesh(surface), share_colors=True)
    with context.open_renderers(soup) as (renderer, validation):
        soup.refit_colors(renderer)
        return soup.measure_error(validation)


def _move_vertices(mesh: Mesh, soup: Soup) -> Mesh:
    """Return `mesh` with its vertices moved to the corners of `soup`."""
    vertices = mesh.vertices.copy()
    vertices[mesh.faces.reshape(-1)] = soup.corners.reshape(-1, 3)
    return Mesh(vertices, mesh.faces)

"""Levels of detail: the baked mesh with fewer faces, each level fitted to the training images again."""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from msb.bake.candidate_fitted import PIXELS_TO_MOVE
from msb.bake.candidate_surface import ClosedSurface, copy_nearest_colors, refit_surface
from msb.bake.context import SearchContext
from msb.bake.depth_fusion import find_visible_points
from msb.bake.descent import StepSchedule, move_faces
from msb.bake.face_selection import hide_cheapest_faces
from msb.bake.simplification import is_closed_surface, simplify
from msb.bake.soup import Soup, is_uncut_soup, merge_seams
from msb.bake.space import Space
from msb.delivery.surface_distance import measure_distances, sample_surface
from msb.meshes.mesh import Mesh

# A level of detail is evaluated on a full-HD screen with this number of pixel rows. On such a screen, the
# geometric error of a level must be below a pixel.
SCREEN_ROWS = 1080
# The geometric error of a level is this percentile of the distances at the sample points. A few outliers
# therefore do not change the error.
_ERROR_PERCENTILE = 95.0
# One reduction stage keeps at least this share of the faces of a soup. The faces that stay are then moved.
# With stages of this size, a level with 50 % of the faces loses 0.1 to 0.3 dB. With stages that hid more
# faces, such a level lost up to 0.6 dB.
_STAGE_SHARE = 0.5
# Number of steps that move the remaining faces of a soup, or the vertices of a surface. With 300 steps
# instead of 200, a level of a walled scene gains 0.2 dB.
_STEPS = 300
# Step length of the descent for a soup, at the start and at the end, relative to the size of a face. With
# small last steps, the search does not lose what the first steps gained.
_STEP_LENGTHS = 0.03, 0.0003


def make_lods(
    mesh: Mesh, context: SearchContext, shares: Sequence[float], *, seconds: float = math.inf
) -> Iterator[tuple[Mesh, list[str]]]:
    """Yield a mesh and notes for the user, for each value of `shares`. The values are falling shares of the
    faces.

    The iterator makes a level of detail when the caller requests the next mesh. The search for a level takes
    at most `seconds`. The colours of a level are rough vertex colours, without a texture.

    In a soup, faces are hidden if their removal increases the error in the training images least. The other
    faces of a soup are then moved to cover the gaps. Each level of detail is made from the previous level. A
    connected mesh is reduced by quadric error, with its colour seams merged. A closed mesh is reduced in the
    coordinates of `Space.fit`, and its vertices are then moved. A closed mesh stays closed, manifold and
    consistently wound. Unseen parts keep the colours of `mesh`.

    Raises
    ------
    AssetError
        TRIASSET_EMPTY, raised by the iterator: no closed surface is left with this number of faces.
    DeviceError
    """
    counts = [max(1, round(share * len(mesh.faces))) for share in shares]
    if is_uncut_soup(mesh.vertices, mesh.faces):
        return _reduce_soup(mesh, context, counts, seconds)
    whole = merge_seams(mesh)
    if is_closed_surface(whole.vertices, whole.faces):
        return _reduce_closed(whole, context, counts, seconds)
    return _reduce_open(whole, context, counts)


def _reduce_soup(
    mesh: Mesh, context: SearchContext, counts: Sequence[int], level_seconds: float
) -> Iterator[tuple[Mesh, list[str]]]:
    """Yield a soup per level: hide the least useful faces in stages, and move the other faces."""
    whole = len(mesh.faces)
    random = context.make_random()
    soup = Soup.from_mesh(mesh, share_colors=False)
    stages = _plan_stages(whole, counts)
    notes: list[str] = []
    seconds = level_seconds
    for stage, (count, left) in enumerate(stages):
        # Larger faces need fewer image pixels. With 1/8 of the faces, images of `PIXELS_TO_MOVE` pixels are
        # large enough.
        pixels = 8 * PIXELS_TO_MOVE * count // whole
        with context.limited_to(pixels).open_renderers(soup) as (renderer, validation):
            # Hide unseen faces first, then the least useful ones.
            unseen = np.flatnonzero(soup.refit_colors(renderer).max_pixels == 0)
            soup.selected[unseen[: max(0, len(soup.selected) - count)]] = False
            hide_cheapest_faces(soup, renderer, random, count)

            began = time.monotonic()
            progress = partial(_report_step, context, stage, len(stages))
            schedule = StepSchedule(context.count_steps(_STEPS), began + seconds / left, progress)
            lengths = _STEP_LENGTHS
            soup = move_faces(
                soup, renderer, validation, random, step_lengths=lengths, most=count, schedule=schedule
            )
            seconds = max(0.0, seconds - (time.monotonic() - began))
        # Drop hidden faces, so that later stages do not try to show them again.
        soup = soup.drop_hidden()
        notes = schedule.notes("moving the triangles") or notes  # Notes also apply to later levels.
        if left == 1:
            yield soup.to_mesh(), notes
            seconds = level_seconds


def _reduce_closed(
    mesh: Mesh, whole: SearchContext, counts: Sequence[int], seconds: float
) -> Iterator[tuple[Mesh, list[str]]]:
    """For each count, yield a closed surface with fewer faces, whose vertices were moved."""
    context = whole.limited_to(PIXELS_TO_MOVE)
    cameras = context.training.cameras
    visible = find_visible_points(mesh, cameras, context.device)
    points = mesh.vertices.astype(np.float64)
    space = Space.fit(visible if len(visible) else points, cameras)
    surface = ClosedSurface(space.from_world(points), mesh.faces, space)
    for level, count in enumerate(counts):

        def progress(_: str, done: int, total: int, level: int = level) -> bool:
            return _report_progress(whole, level, len(counts), done, total)

        yield refit_surface(
            surface, count, replace(context, progress=progress), seconds, _STEPS, colored=mesh
        )


def _reduce_open(
    mesh: Mesh, context: SearchContext, counts: Sequence[int]
) -> Iterator[tuple[Mesh, list[str]]]:
    """For each count, yield an open surface with fewer faces. The vertices are not moved."""
    points = mesh.vertices.astype(np.float64)
    for level, count in enumerate(counts):
        _report_progress(context, level, len(counts), 0, 1)
        placed, faces = simplify(points, mesh.faces, count)
        yield copy_nearest_colors(mesh, Mesh(placed.astype(np.float32), faces, up=mesh.up)), []


def _report_step(context: SearchContext, stage: int, stages: int, step: int, _steps: int) -> bool:
    """Report the progress within a stage. Return whether to stop."""
    return _report_progress(context, stage, stages, step, context.count_steps(_STEPS))


def _report_progress(context: SearchContext, level: int, levels: int, done: int, total: int) -> bool:
    """Report the progress over all levels. Return whether to stop."""
    return context.progress("levels of detail", level * total + done, levels * total)


def _plan_stages(faces: int, counts: Sequence[int]) -> list[tuple[int, int]]:
    """Return the stages as pairs. The first number is the number of faces after the stage.

    The second number counts the stages until the next level of detail is complete. The second number is 1 for
    the last of these stages. The numbers of faces fall from `faces` through all `counts`. A stage never keeps
    less than `_STAGE_SHARE` of the faces.
    """
    stages: list[tuple[int, int]] = []
    for count in counts:
        turns = math.ceil(math.log(faces / count) / math.log(1 / _STAGE_SHARE) - 1e-9)
        between = [round(faces * (count / faces) ** (turn / turns)) for turn in range(1, turns)]
        stages += zip([*between, count], range(len(between) + 1, 0, -1), strict=True)
        faces = count
    return stages


def measure_screen_share(mesh: Mesh, lod: Mesh, *, rows: int = SCREEN_ROWS) -> float:
    """Return the size below which `lod` can replace `mesh`: the height of the model as a share of the image
    height.

    At this height, 95 % of the points of each surface are less than a pixel from the other surface. The image
    has `rows` rows. The height of the model is the diameter of its bounding sphere. The bounding sphere has
    the centre of the model's bounding box, and contains the farthest vertex. The result is at most 1. Colour
    differences are not measured.
    """
    # Measure the distances between the two surfaces in both directions.
    ends = [(part.vertices.astype(np.float64), part.faces) for part in (mesh, lod)]
    pairs = (ends, ends[::-1])
    distances = [measure_distances(sample_surface(*start)[0], *end) for start, end in pairs]
    error = float(np.percentile(np.concatenate(distances), _ERROR_PERCENTILE))
    used = ends[0][0][np.unique(mesh.faces)]
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    height = 2 * float(np.linalg.norm(used - middle, axis=1).max())
    return min(1.0, height / (rows * error)) if error > 0 else 1.0

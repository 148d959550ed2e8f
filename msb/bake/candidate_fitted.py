"""The candidate `fitted`: a triangle soup, pruned, moved and coloured until its opaque image matches."""

import math
import time
from functools import partial

import numpy as np

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.bake.arrays import Floats, Ints
from msb.bake.blending_weights import BlendingWeights
from msb.bake.candidate_kept import FINE_PIXELS, MIN_FACE_PIXELS, limit_for_selection
from msb.bake.color_fit import count_pixels
from msb.bake.context import BestState, SearchContext
from msb.bake.descent import StepSchedule, move_faces
from msb.bake.face_selection import hide_cheapest_faces, toggle_faces
from msb.bake.opaque_model import hide_stray_faces, prune_faces, to_opaque_mesh
from msb.bake.soup import Soup
from msb.meshes.mesh import Mesh

# Number of face-selection rounds that hide faces before any face moves. A selection round tries 8 % of the
# faces, so 12 rounds try each face about once.
_HIDING_ROUNDS = 12
# Number of descent steps without a time limit. For a demo model, these steps take about 20 s on two cores.
_STEPS = 400
# Length of a descent step at the start and at the end, relative to the size of a face. 400 steps can move a
# corner by about three face sizes.
_STEP_LENGTHS = 0.015, 0.0005
# Number of pixels of the largest image that is used to move faces. Moving faces takes longer in proportion to
# the size of the images.
PIXELS_TO_MOVE = 1 << 18
# If a method has no static colours, the colours vary within each face. Faces with varying colours are cut
# into four faces. Faces stay whole if the new number of faces would exceed this limit or the face budget.
# With more faces, each face would cover too few pixels of the images.
_MAX_QUARTERED = 20_000
# The default face budget is one face per 2.5 pixels that the model covers in an average view. With smaller
# faces, the faces follow the pixel grid of the training images, and the PSNR of other views falls.
_PIXELS_PER_FACE = 2.5
# If the budget allows more faces, the largest faces are halved until there is one piece per 5.5 pixels of a
# view. Further halving of faces reduces the PSNR.
_PIXELS_PER_PIECE = 5.5
# The target size of a piece grows by this factor until the number of pieces is within the limit. With this
# growth, the number of pieces is at most about 9 % below the limit.
_PIECE_GROWTH = 2 ** (1 / 8)


def make_fitted(
    asset: Asset,
    context: SearchContext,
    weights: BlendingWeights | None = None,
    *,
    seconds: float = math.inf,
    faces: int | None = None,
    pixels: int | None = None,
) -> tuple[Mesh, list[str]]:
    """Return an opaque soup with corner colours, made of the triangles of `asset`. Also return notes for the
    user.

    Triangles are pruned by their blending weights. The remaining triangles are moved, hidden and shown until
    they match the training images. The validation images decide which state is best. Without a limit of
    `seconds`, repeated fits on one device give equal results.

    If the images have too few pixels per triangle, no triangle is moved. With `faces`, the triangles that
    cover the most pixels are then selected.

    Parameters
    ----------
    faces : int, optional
        The face budget.
    pixels : int, optional
        The number of pixels of a view. Without `faces`, the face budget is the number of triangles that
        contribute to the images. Large faces are halved if the budget allows more faces.

    Raises
    ------
    DeviceError, and the errors of `make_kept`.
    """
    until = time.monotonic() + seconds
    random = context.make_random()
    soup = Soup.from_mesh(to_opaque_mesh(asset), share_colors=False)
    context.progress("choosing faces", 0, 1)
    with limit_for_selection(context, soup.selected_count).open_renderers(soup) as (renderer, validation):
        best = BestState(validation)
        prune_faces(soup, asset, renderer, best, weights)
        soup = best.soup
        # Compute the average number of pixels (F,) that show each selected face. Also compute the share of
        # the view that all faces cover.
        face_pixels = count_pixels(soup.refit_colors(renderer))[soup.selected] / len(renderer.images)
        covered = face_pixels.sum() / renderer.pixels_per_face(1)
    moving = context.limited_to(PIXELS_TO_MOVE)
    if pixels is not None:
        pixels = min(pixels, moving.training.max_pixels)
    default = None if pixels is None else max(1, int(covered * pixels / _PIXELS_PER_FACE))
    budget = faces or default
    if why_not(asset.manifest, "standard") is not None:
        fits = 4 * soup.selected_count <= min(_MAX_QUARTERED, budget or _MAX_QUARTERED)
        soup = soup.quarter() if fits else soup
    elif pixels is not None and budget is not None:
        soup = soup.halve(_plan_halving(face_pixels, min(budget, int(pixels / _PIXELS_PER_PIECE))))
    with moving.open_renderers(soup) as (renderer, validation):
        sums = soup.refit_colors(renderer)
        count = soup.selected_count if budget is None else min(budget, soup.selected_count)
        if renderer.pixels_per_face(count) < MIN_FACE_PIXELS:
            if faces is not None and count < soup.selected_count:
                face_pixels = np.where(soup.selected, count_pixels(sums), -1)
                soup.selected[np.argsort(-face_pixels, kind="stable")[faces:]] = False
                soup.refit_colors(renderer)
            average = renderer.pixels_per_face(soup.selected_count)
            text = f"{soup.selected_count:,} triangles have {average:.1f} pixels each in an average view"
            return soup.to_mesh(), [
                f"{text}, which is too few to move triangles; they were only selected and coloured"
            ]
        for _ in range(_HIDING_ROUNDS):
            toggle_faces(soup, renderer, random, show=False)
        if budget is not None:
            hide_cheapest_faces(soup, renderer, random, budget)
        progress = partial(context.progress, "moving faces")
        schedule = StepSchedule(context.count_steps(_STEPS), until, progress)
        lengths = _STEP_LENGTHS
        soup = move_faces(
            soup, renderer, validation, random, step_lengths=lengths, most=budget, schedule=schedule
        )
        soup = hide_stray_faces(soup, renderer, BestState(validation))
    return soup.to_mesh(), schedule.notes("moving the triangles")


def _plan_halving(pixels: Floats, most: int) -> Ints:
    """Return how often to halve each face (F,), so that there are at most `most` pieces.

    The argument `pixels` (F,) is the number of pixels that a face covers. All pieces cover about the same
    number of pixels, at least `FINE_PIXELS`.
    """
    times = np.zeros(len(pixels), np.int64)
    piece = FINE_PIXELS
    while len(pixels) < most:
        times = np.log2(np.maximum(pixels, piece) / piece).astype(np.int64)
        if (1 << times).sum() <= most:
            break
        piece *= _PIECE_GROWTH
    return times

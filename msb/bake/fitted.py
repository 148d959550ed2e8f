"""Triangles that make the opaque picture right: chosen, moved and coloured until it no longer gets better."""

import time

import numpy as np

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.bake.arrays import Floats, Ints
from msb.bake.colors import pixels as shown_by
from msb.bake.descent import Schedule, moved
from msb.bake.kept import FEWEST, FINE, choosing
from msb.bake.search import hide_least, try_faces
from msb.bake.shares import Shares
from msb.bake.soup import Soup
from msb.bake.start import Best, Guide, choose, plain_mesh
from msb.meshes.mesh import Mesh

_HIDDEN_FIRST = 12  # rounds that hide faces before any face moves
_STEPS = 400
_RATES = 0.015, 0.0005  # step length in face sizes, at the start and at the end
PIXELS_TO_MOVE = 1 << 18  # pixels of the largest image that moves faces
# Models without static colours vary within each face. With up to this many faces they are cut in four, if
# the face budget allows.
_COARSE = 20_000
# Covered pixels of a view per moving face, as smaller ones follow the pixel grid; and per face where the
# largest are halved.
_PIXELS_A_FACE, _PIXELS_A_PIECE = 2.5, 5.5
_COARSER = 2 ** (1 / 8)  # growth of the pieces of faces per try, until their number is within the budget


def fitted(
    asset: Asset,
    guide: Guide,
    shares: Shares | None = None,
    *,
    seconds: float = 40.0,
    faces: int | None = None,
    pixels: int | None = None,
) -> tuple[Mesh, list[str]]:
    """Return an opaque soup made of the triangles of `asset`, at most so many `faces`, with colours at
    corners, and what should be known of it.

    Triangles are chosen by their share in the model's look, then moved, hidden and shown as the lessons
    ask. What is best by pictures that teach nothing is returned. It ends after so many `seconds` where it has
    not before; a result that was not cut short is the same each time on one device.

    Where pictures have too few pixels for the triangles, chance would move them: they stay where they are,
    as many as were chosen, or the `faces` that most pixels show. Where nobody says how many may move, so many
    `pixels` of a view do, of which those count that show the model; where few were chosen, the largest are
    cut first.

    Raises
    ------
    DeviceError, and as `kept`.
    """
    until = time.monotonic() + seconds
    random = guide.random()
    soup = Soup.of(plain_mesh(asset), shares=False)
    guide.watch("choosing faces", 0, 1)
    with choosing(guide, soup.count).rasters(soup) as (raster, judge):
        best = Best(judge)
        choose(soup, asset, raster, best, shares)
        soup = best.soup
        owned = shown_by(soup.refit(raster))[soup.keep] / len(raster.lessons)
        covered = owned.sum() / raster.pixels_a_face(1)
    usual = None if pixels is None else max(1, int(covered * pixels / _PIXELS_A_FACE))
    most = faces or usual
    if why_not(asset.manifest, "standard") is not None:
        soup = soup.cut() if 4 * soup.count <= min(_COARSE, most or _COARSE) else soup
    elif pixels is not None and most is not None:
        soup = soup.halved(_cuts(owned, min(most, int(pixels / _PIXELS_A_PIECE))))
    with guide.within(PIXELS_TO_MOVE).rasters(soup) as (raster, judge):
        seen = soup.refit(raster)
        left = soup.count if most is None else min(most, soup.count)
        if raster.pixels_a_face(left) < FEWEST:
            if faces is not None and left < soup.count:
                shown = np.where(soup.keep, shown_by(seen), -1)
                soup.keep[np.argsort(-shown, kind="stable")[faces:]] = False
                soup.refit(raster)
            each = raster.pixels_a_face(soup.count)
            text = f"{soup.count:,} triangles have {each:.1f} pixels of a view each, too few to move them by"
            return soup.mesh(), [f"{text}: they are chosen and coloured alone"]
        for _ in range(_HIDDEN_FIRST):
            try_faces(soup, raster, random, show=False)
        if most is not None:
            hide_least(soup, raster, random, most)
        schedule = Schedule(_STEPS, until)

        def done(step: int) -> float:
            return schedule.share(step, enough=guide.watch("moving faces", step, schedule.steps))

        soup = moved(soup, raster, judge, random, rates=_RATES, most=most, done=done)
    return soup.mesh(), schedule.lacks("its triangles")


def _cuts(owned: Floats, most: int) -> Ints:
    """Return how often to halve faces of so many pixels (F,), so that there are `most` at most, as alike as
    that makes them."""
    often = np.zeros(len(owned), np.int64)
    least = FINE
    while len(owned) < most:
        often = np.log2(np.maximum(owned, least) / least).astype(np.int64)
        if (1 << often).sum() <= most:
            break
        least *= _COARSER
    return often

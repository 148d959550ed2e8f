"""Levels of detail: what was baked with fewer faces, each taught again."""

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from msb.bake.apart import distances, spread
from msb.bake.descent import Schedule, moved
from msb.bake.fitted import PIXELS_TO_MOVE
from msb.bake.fusion import seen_points
from msb.bake.search import hide_least
from msb.bake.simpler import closed, simpler
from msb.bake.soup import Soup, is_uncut_soup, without_seams
from msb.bake.space import Space
from msb.bake.start import Guide
from msb.bake.surface import Solid, taught, with_colors_of
from msb.meshes.mesh import Mesh

ROWS = 1080  # height of the image in which the error of a level must be below a pixel
_MOST_POINTS = 95.0  # percentile of the sample points whose error counts
_STAGE = 0.5  # share of a soup's faces that stay in a stage, before the others are moved
_STEPS = 300  # steps that move the remaining faces of a stage
_RATES = 0.03, 0.0003  # step length in face sizes, at the start and at the end


def lods(
    mesh: Mesh, guide: Guide, shares: Sequence[float], *, seconds: float = math.inf
) -> Iterator[tuple[Mesh, list[str]]]:
    """Return levels of detail of `mesh` with these falling shares of its faces, whose colours are rough, and
    what should be known of each. They are made as they are asked for, each for so many `seconds` at most.

    Of a soup the faces stay that are worth most in the lessons' pictures, and are moved to make up for the
    others; each level is made of the one before it. A mesh whose faces share vertices gets fewer faces by
    quadric error, seams aside: one that is closed in the space that `surface` makes it in, where its faces
    then move, and stays closed, manifold and consistently wound. Textures are left out. What no view sees
    keeps the colours of `mesh`.

    Raises
    ------
    AssetError
        TRIASSET_EMPTY, by the iterator: nothing closed is left of so few faces.
    DeviceError
    """
    counts = [max(1, round(share * len(mesh.faces))) for share in shares]
    if is_uncut_soup(mesh.vertices, mesh.faces):
        return _of_soup(mesh, guide, counts, seconds)
    whole = without_seams(mesh)
    if closed(whole.vertices, whole.faces):
        return _of_surface(whole, guide, counts, seconds)
    return _of_mesh(whole, guide, counts)


def _of_soup(
    mesh: Mesh, guide: Guide, counts: Sequence[int], level_seconds: float
) -> Iterator[tuple[Mesh, list[str]]]:
    """Yield what is left of a soup when the faces go that are worth least."""
    whole = len(mesh.faces)
    random = guide.random()
    soup = Soup.of(mesh, shares=False)
    stages = _stages(whole, counts)
    notes: list[str] = []
    seconds = level_seconds
    for stage, (count, left) in enumerate(stages):
        # Larger faces need fewer pixels; at an eighth those are enough by which all were moved.
        pixels = 8 * PIXELS_TO_MOVE * count // whole
        # Faces that are gone do not come back: they would count as some of those tried at a time.
        with guide.within(pixels).rasters(soup) as (raster, judge):
            unseen = np.flatnonzero(soup.refit(raster).most == 0)
            soup.keep[unseen[: max(0, len(soup.keep) - count)]] = False
            hide_least(soup, raster, random, count)

            began = time.monotonic()
            schedule = Schedule(_STEPS, began + seconds / left)

            def done(step: int, stage: int = stage, schedule: Schedule = schedule) -> float:
                enough = _watched(guide, stage, len(stages), step, _STEPS)
                return schedule.share(step, enough=enough)

            soup = moved(soup, raster, judge, random, rates=_RATES, most=count, done=done)
            seconds = max(0.0, seconds - (time.monotonic() - began))
        soup = soup.shown()
        notes = schedule.lacks("its triangles") or notes  # a level is made of those before it
        if left == 1:
            yield soup.mesh(), notes
            seconds = level_seconds


def _of_surface(
    mesh: Mesh, whole: Guide, counts: Sequence[int], seconds: float
) -> Iterator[tuple[Mesh, list[str]]]:
    """Yield a closed surface with fewer faces, which are moved inside the space that it was made in."""
    guide = whole.within(PIXELS_TO_MOVE)
    cameras = guide.lessons.cameras
    seen = seen_points(mesh, cameras, guide.device)
    points = mesh.vertices.astype(np.float64)
    space = Space.of(seen if len(seen) else points, cameras)
    solid = Solid(space.inward(points), mesh.faces, space)
    for level, count in enumerate(counts):

        def watch(_: str, done: int, total: int, level: int = level) -> bool:
            return _watched(whole, level, len(counts), done, total)

        yield taught(solid, count, replace(guide, watch=watch), seconds, _STEPS, like=mesh)


def _of_mesh(mesh: Mesh, guide: Guide, counts: Sequence[int]) -> Iterator[tuple[Mesh, list[str]]]:
    """Yield an open surface with fewer faces, which stay where they are."""
    points = mesh.vertices.astype(np.float64)
    for level, count in enumerate(counts):
        _watched(guide, level, len(counts), 0, 1)
        placed, faces = simpler(points, mesh.faces, count)
        yield with_colors_of(mesh, Mesh(placed.astype(np.float32), faces, up=mesh.up)), []


def _watched(guide: Guide, level: int, levels: int, done: int, total: int) -> bool:
    """Tell how much of all levels is done; return whether to end."""
    return guide.watch("levels of detail", level * total + done, levels * total)


def _stages(faces: int, counts: Sequence[int]) -> list[tuple[int, int]]:
    """Return numbers of faces from `faces` down through all `counts`, none far from the next, and how many of
    them are left until the next of `counts`: 1 of these."""
    stages: list[tuple[int, int]] = []
    for count in counts:
        turns = math.ceil(math.log(faces / count) / math.log(1 / _STAGE) - 1e-9)
        between = [round(faces * (count / faces) ** (turn / turns)) for turn in range(1, turns)]
        stages += zip([*between, count], range(len(between) + 1, 0, -1), strict=True)
        faces = count
    return stages


def screen_share(mesh: Mesh, lod: Mesh, *, rows: int = ROWS) -> float:
    """Return the share of an image's height below which `lod` is enough in the place of `mesh`.

    The height that counts is that of the model's bounding sphere: about the middle of its box, through its
    farthest vertex. Of points all over either surface 95 % are nearer to the other one than a pixel of an
    image of so many rows; 1 where that holds even if the model is as high as the image. That colours are
    coarser does not count.
    """
    ends = [(each.vertices.astype(np.float64), each.faces) for each in (mesh, lod)]
    apart = [distances(spread(*one)[0], *other) for one, other in (ends, ends[::-1])]
    error = float(np.percentile(np.concatenate(apart), _MOST_POINTS))
    used = ends[0][0][np.unique(mesh.faces)]
    middle = (used.min(axis=0) + used.max(axis=0)) / 2
    height = 2 * float(np.linalg.norm(used - middle, axis=1).max())
    return min(1.0, height / (rows * error)) if error > 0 else 1.0

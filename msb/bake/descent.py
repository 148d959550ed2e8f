"""Where the faces of an opaque soup should be: gradient descent on the squared error of its pictures.

An opaque picture changes where borders between faces move. How the error rises with each corner is summed
over the pixels at these borders (the kernel `sums` of bake.cl), for some views at a time; corners move
against it by Adam's rule (Kingma and Ba 2015, with one scale for all coordinates of a face), and colours
follow by least squares over what the last steps saw. Between steps faces are hidden or shown where that
pays (`msb.bake.search`)."""

import time
from collections.abc import Callable

import numpy as np

from msb.bake.arrays import Floats
from msb.bake.kept import FEWEST
from msb.bake.raster import Raster
from msb.bake.search import some_views, try_faces
from msb.bake.soup import Soup
from msb.bake.start import Best

_MOMENTUM, _SCALE = 0.9, 0.99
_TINY = 1e-30
MEMORY = 0.9  # decay per step of the colour sums of earlier steps
# Steps between solving colours, and between hiding and showing faces.
RECOLOR, _TRY = 5, 40
LOOK = 20  # steps between validations
_FARTHEST = 3.0  # largest move of a corner in a step, in rates
_PACE = 10  # steps after which the time of a step is known


class Schedule:
    """How many steps there are: as many as planned, or as there is time for from now on until `until`, of
    `time.monotonic`."""

    def __init__(self, planned: int, until: float = np.inf) -> None:
        self.steps = planned
        self._planned, self._taken, self._share = planned, 0, 0.0
        self._first, self._until = 0.0, until
        self._is_short = False

    def share(self, step: int, *, enough: bool) -> float:
        """Return how much of all is done after a step: all where somebody says that it is `enough`."""
        self._taken = step
        now, left = time.monotonic(), self._planned - step
        if step == 1:  # it took longer: kernels were built
            self._first = now
        elif step >= _PACE and self._until < np.inf:
            pace = max(now - self._first, _TINY) / (step - 1)
            possible = int((self._until - now) / pace)
            self._is_short |= possible < left
            if self._is_short:  # chance has a say from here on, so a step is missing to the end, and noted
                left = min(possible, left - 1)
        if enough or now > self._until or left <= 0:
            return 1.0
        self.steps = step + left
        self._share += (1 - self._share) / (left + 1)
        return self._share

    def lacks(self, what: str) -> list[str]:
        """Return the note on `what` was moved in fewer steps than were planned, if it was."""
        if not 0 < self._taken < self._planned:
            return []
        return [f"{what} took {self._taken} of {self._planned} steps to where pictures want them"]


class Adam:
    """Which way and how far to move at each step, in rates of the step, by Adam's rule.

    What moves together has one scale. No place moves farther than `farthest` rates.
    """

    def __init__(self, farthest: float) -> None:
        self._farthest = farthest
        self._step = 0
        self._slope: Floats | float = 0.0
        self._square: Floats | float = 0.0

    def move(self, slope: Floats, square: Floats | float) -> Floats:
        """Return what to take from places, as slopes (..., 3) of the error there say.

        `square` is the mean square of the slopes that have one scale, and fits to `slope`.
        """
        self._step += 1
        self._slope = _MOMENTUM * self._slope + (1 - _MOMENTUM) * slope
        self._square = _SCALE * self._square + (1 - _SCALE) * square
        size = np.sqrt(self._square / (1 - _SCALE**self._step)) + _TINY
        move: Floats = self._slope / (1 - _MOMENTUM**self._step) / size
        length = np.linalg.norm(move, axis=-1, keepdims=True)
        move *= np.minimum(1, self._farthest / np.maximum(length, _TINY))
        return move


def moved(
    soup: Soup,
    raster: Raster,
    judge: Raster,
    random: np.random.Generator,
    *,
    rates: tuple[float, float],
    most: int | None,
    done: Callable[[int], float],
) -> Soup:
    """Return the best of `soup` in the views of `judge`, while its faces move in steps that shrink from the
    first rate to the last.

    A rate is relative to the size of a face. No more than `most` are shown. ``done(step)`` is called after
    each step and says how much of all is done, from 0 to 1, where it ends. Where faces have too few pixels
    they stay where they are.
    """
    soup.refit(raster)
    best = Best(judge)
    best.look(soup)
    if raster.pixels_a_face(soup.count) < FEWEST:
        return best.soup
    adam = Adam(_FARTHEST)
    memory = None
    step, share = 0, 0.0
    while share < 1:
        step += 1
        soup.put_on(raster)
        seen = raster.seen(some_views(raster, random))
        slopes = seen.slopes.astype(np.float64)
        move = adam.move(slopes, np.square(slopes).mean(axis=(1, 2), keepdims=True))
        first, last = rates
        rate = first + (last - first) * share
        soup.corners -= (rate * _sizes(soup)[:, None, None] * move).astype(np.float32)
        memory = seen.sums if memory is None else MEMORY * memory + seen.sums
        if step % RECOLOR == 0:
            soup.recolor(seen._replace(sums=memory))
        if step % _TRY == 0:
            try_faces(soup, raster, random, show=False)
            try_faces(soup, raster, random, hide=False, most=most)
        if step % LOOK == 0:
            best.look(soup)
        share = done(step)
    soup.refit(raster)
    best.look(soup)
    return best.soup


def _sizes(soup: Soup) -> Floats:
    """Return (F,) square roots of twice the areas."""
    sides = soup.corners[:, 1:].astype(np.float64) - soup.corners[:, :1]
    found: Floats = np.sqrt(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1))
    return found

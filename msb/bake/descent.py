"""Gradient descent on the corners of an opaque soup reduces the squared error of its images.

An opaque image changes at the borders between faces when the faces move. The kernel `sums` of bake.cl adds up
the pixels at face borders, for a few views at a time. These sums are the derivatives of the error with
respect to the position of each corner. Corners move along the negative gradient by Adam's rule (Kingma and Ba
2015). All coordinates of a face have the same step scale. Every few steps, colours are fitted again by least
squares over the pixels of the last steps. Between descent steps, faces are hidden or shown if the change
reduces the error (`msb.bake.face_selection`).
"""

import time
from collections.abc import Callable

import numpy as np

from msb.bake.arrays import Floats
from msb.bake.candidate_kept import MIN_FACE_PIXELS
from msb.bake.context import BestState
from msb.bake.face_selection import sample_views, toggle_faces
from msb.bake.soup import Soup
from msb.bake.soup_renderer import SoupRenderer

# Adam's decay per step of the average gradient and of the average squared gradient. The second decay is 0.99,
# not 0.999 as in the paper on Adam, because a search has only a few hundred steps.
_MOMENTUM, _SCALE_DECAY = 0.9, 0.99
# Smallest divisor, which avoids division by 0 for faces without a gradient.
_EPSILON = 1e-30
# Decay per step of the colour sums from earlier steps. With this decay, colours depend on the last ten
# descent steps, which draw about 80 views.
COLOR_DECAY = 0.9
# Number of steps between two fits of the colours, and number of steps between two rounds of face selection.
COLOR_STEPS, _SELECTION_STEPS = 5, 40
# Number of steps between two validations. A validation is slow, because it renders all validation views.
VALIDATION_STEPS = 20
# Largest move of a corner in a step, relative to the step length. Without a limit on moves, Adam's first
# steps could be much larger.
_MAX_MOVE = 3.0
# After this number of steps, the time per step is known well enough to plan the remaining steps. The first
# step is not timed, because it builds the kernels.
_PACE_STEPS = 10


class StepSchedule:
    """Counts the steps of a search, and reduces the planned number if the time limit requires it.

    Parameters
    ----------
    planned : int
        The planned number of steps, if the time allows.
    until : float
        The time limit, a value of `time.monotonic`.
    progress : callable
        Called as ``progress(step, steps)`` after each step; returns whether to stop.
    """

    def __init__(self, planned: int, until: float, progress: Callable[[int, int], bool]) -> None:
        self._steps, self._progress = planned, progress
        self._planned, self._taken, self._share = planned, 0, 0.0
        self._first, self._until = 0.0, until
        self._is_short = False

    def finish_step(self, step: int) -> float:
        """Count a finished step. Return the finished share of the search, which is 1 at its end."""
        stop = self._progress(step, self._steps)
        self._taken = step
        now, left = time.monotonic(), self._planned - step
        if step == 1:
            self._first = now
        elif step >= _PACE_STEPS and self._until < np.inf:
            pace = max(now - self._first, _EPSILON) / (step - 1)
            possible = int((self._until - now) / pace)
            self._is_short |= possible < left
            # If the time limit reduces the number of steps, the step lengths depend on the speed of the
            # machine. In this case, omit at least one step, because only then a note informs the user.
            if self._is_short:
                left = min(possible, left - 1)
        if stop or now > self._until or left <= 0:
            return 1.0
        self._steps = step + left
        self._share += (1 - self._share) / (left + 1)
        return self._share

    def notes(self, subject: str) -> list[str]:
        """Return a note that starts with `subject` if the search took fewer steps than planned."""
        if not 0 < self._taken < self._planned:
            return []
        text = f"{subject}: stopped after {self._taken} of {self._planned} steps; the quality is reduced"
        return [f"{text}. Pass a larger --seconds for more steps"]


class Adam:
    """Adam's rule. Converts gradients to moves, in units of the step length.

    All coordinates of a face share one scale.

    Parameters
    ----------
    max_move : float
        The largest move in a step, in step lengths.
    """

    def __init__(self, max_move: float) -> None:
        self._max_move = max_move
        self._step = 0
        self._gradient: Floats | float = 0.0
        self._square: Floats | float = 0.0

    def compute_move(self, gradient: Floats, square: Floats | float) -> Floats:
        """Return the move (..., 3) to subtract from the coordinates, for the gradient (..., 3) of the error.

        `square` is the mean squared gradient over all coordinates with the same scale. The shape of `square`
        must broadcast to `gradient`.
        """
        # Running averages. Both running averages start at 0. The divisions by 1 - decay^step correct this
        # bias.
        self._step += 1
        self._gradient = _MOMENTUM * self._gradient + (1 - _MOMENTUM) * gradient
        self._square = _SCALE_DECAY * self._square + (1 - _SCALE_DECAY) * square
        size = np.sqrt(self._square / (1 - _SCALE_DECAY**self._step)) + _EPSILON
        move: Floats = self._gradient / (1 - _MOMENTUM**self._step) / size
        # Shorten moves that are too long.
        length = np.linalg.norm(move, axis=-1, keepdims=True)
        move *= np.minimum(1, self._max_move / np.maximum(length, _EPSILON))
        return move


def move_faces(
    soup: Soup,
    renderer: SoupRenderer,
    validation: SoupRenderer,
    random: np.random.Generator,
    *,
    step_lengths: tuple[float, float],
    most: int | None,
    schedule: StepSchedule,
) -> Soup:
    """Move the corners of the selected faces. Return the state with the smallest validation error.

    Step lengths fall from the first to the last value of `step_lengths`, relative to the size of a face. At
    most `most` faces are selected at the end. If faces cover fewer than `MIN_FACE_PIXELS` pixels on average,
    no face is moved.
    """
    soup.refit_colors(renderer)
    best = BestState(validation)
    best.evaluate(soup)
    if renderer.pixels_per_face(soup.selected_count) < MIN_FACE_PIXELS:
        return best.soup
    adam = Adam(_MAX_MOVE)
    sums = None
    step, share = 0, 0.0
    while share < 1:
        step += 1
        soup.upload(renderer)
        seen = renderer.sum_faces(sample_views(renderer, random))
        # Move the corners (F, 3, 3). The nine coordinates of a face share one scale.
        gradients = seen.gradients.astype(np.float64)
        move = adam.compute_move(gradients, np.square(gradients).mean(axis=(1, 2), keepdims=True))
        first, last = step_lengths
        length = first + (last - first) * share
        soup.corners -= (length * _measure_face_sizes(soup)[:, None, None] * move).astype(np.float32)
        # Fit the colours, select faces and validate at different intervals of steps.
        sums = seen.sums if sums is None else COLOR_DECAY * sums + seen.sums
        if step % COLOR_STEPS == 0:
            soup.fit_colors(seen._replace(sums=sums))
        if step % _SELECTION_STEPS == 0:
            toggle_faces(soup, renderer, random, show=False)
            toggle_faces(soup, renderer, random, hide=False, most=most)
        if step % VALIDATION_STEPS == 0:
            best.evaluate(soup)
        share = schedule.finish_step(step)
    soup.refit_colors(renderer)
    best.evaluate(soup)
    return best.soup


def _measure_face_sizes(soup: Soup) -> Floats:
    """Return the size (F,) of each face: the square root of twice its area."""
    sides = soup.corners[:, 1:].astype(np.float64) - soup.corners[:, :1]
    sizes: Floats = np.sqrt(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1))
    return sizes

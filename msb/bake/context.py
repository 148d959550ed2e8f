"""The inputs that all searches share: training and validation images, seed, device and progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from msb.bake.images import ViewImages
from msb.bake.soup_renderer import SoupRenderer
from msb.cl import Device

if TYPE_CHECKING:
    from msb.bake.soup import Soup

# Called as progress(stage, done, total). If the callback returns true, the search stops early and keeps the
# best result.
ProgressHook = Callable[[str, int, int], bool]


def ignore_progress(_stage: str, _done: int, _total: int) -> bool:
    """Do nothing, and let the search continue."""
    return False


class BestState:
    """The state of a soup with the smallest error in the validation images so far.

    Parameters
    ----------
    validation : SoupRenderer
    weigh : callable, optional
        Returns a factor for the error of a state, for example a penalty for its shape.
    """

    def __init__(self, validation: SoupRenderer, weigh: Callable[[Soup], float] = lambda _: 1.0) -> None:
        self._validation, self._weigh = validation, weigh
        self._error = np.inf
        self.evaluations_since = 0
        """Number of validations since the best state was found."""
        self._soup: Soup | None = None

    @property
    def soup(self) -> Soup:
        """An independent copy of the best state."""
        assert self._soup is not None, "evaluate was not called"
        return self._soup.copy()

    def restart(self, soup: Soup) -> None:
        """Forget all earlier states, and keep a copy of `soup`."""
        self._error = np.inf
        self.evaluate(soup)

    def evaluate(self, soup: Soup) -> None:
        """Keep a copy of `soup` if its error is smaller than all errors before."""
        error = self._weigh(soup) * soup.measure_error(self._validation)
        self.evaluations_since += 1
        if error < self._error:
            self._error, self._soup, self.evaluations_since = error, soup.copy(), 0


@dataclass(frozen=True, eq=False)
class SearchContext:
    """The inputs of a search: images, seed, device and progress.

    Attributes
    ----------
    training, validation : ViewImages
        Images to fit to, and images that decide which result is best.
    seed : int
        Seed of the random generator.
    device : str or Device, optional
    progress : callable
        Called as ``progress(stage, done, total)``; returns whether to stop early.
    step_factor : float
        The number of steps of each search, relative to the normal number.
    shows_model_mesh : bool
        Whether the images are standard-tier images of the model's triangles. No triangle is pruned if this is
        true.
    has_own_depths : bool
        Whether a surface is made of the model's own depths. The model's own depths have fewer dents than the
        depths of a fitted soup.
    """

    training: ViewImages
    validation: ViewImages
    seed: int = 0
    device: str | Device | None = None
    progress: ProgressHook = ignore_progress
    shows_model_mesh: bool = False
    step_factor: float = 1.0
    has_own_depths: bool = False

    def limited_to(self, pixels: int) -> SearchContext:
        """Return the same context with images of at most `pixels` pixels."""
        training, validation = (images.limited_to(pixels) for images in (self.training, self.validation))
        return replace(self, training=training, validation=validation)

    def count_steps(self, normal: int) -> int:
        """Return the number of steps of a search that normally has `normal` steps."""
        return max(1, round(self.step_factor * normal))

    def make_random(self) -> np.random.Generator:
        """Return a new random generator that starts with the seed of the search."""
        return np.random.default_rng(self.seed)

    @contextmanager
    def open_renderers(self, soup: Soup) -> Iterator[tuple[SoupRenderer, SoupRenderer]]:
        """Yield renderers of a soup for the training and for the validation images."""
        with closing(SoupRenderer(soup.corners, soup.colors, self.training, self.device)) as renderer:
            yield renderer, renderer.with_images(self.validation)

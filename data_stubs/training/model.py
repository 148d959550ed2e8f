"""What every method's model can do for the loop that optimises it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from data_stubs.training import losses
from data_stubs.training.optimizer import Adam

if TYPE_CHECKING:
    import torch

    from data_stubs.training.drawing import Drawn
    from data_stubs.training.scene import Capture
    from msb.scenes import Camera


@dataclass(frozen=True)
class Options:
    """What is asked for: at most `faces` triangles, SH up to `sh_degree`, random numbers from `seed`.

    `rasterizer` and `gamma` are 2DTS' rasterizer and final sharpness, `level` is that of DiffSoup's lattices.
    """

    faces: int = 8000
    sh_degree: int = 2
    seed: int = 0
    rasterizer: str = "3D"
    gamma: float = 50.0
    level: int = 2


class Statistics:
    """What was seen of each triangle since the last change of structure.

    `peak` (F,) is the largest weight it had at any sample, `error` (F,) its share of the images' absolute
    errors: weights times errors, summed.
    """

    def __init__(self, faces: int) -> None:
        self.peak = np.zeros(faces, np.float32)
        self.error = np.zeros(faces, np.float32)

    def add(self, drawn: Drawn, photograph: losses.Photograph) -> None:
        """Add an image."""
        wrong = (drawn.image.detach() - photograph.image).abs().mean(2).numpy()
        if drawn.scale > 1:
            wrong = wrong.repeat(drawn.scale, 0).repeat(drawn.scale, 1)
        pairs = drawn.pairs
        np.maximum(self.peak, drawn.peaks(len(self.peak)), out=self.peak)
        wrong = (wrong[::-1] if drawn.flipped else wrong).reshape(-1)
        self.error[pairs.faces] += pairs.total(drawn.weight * wrong[pairs.pixel]) / drawn.scale**2


class Model(ABC):
    """A method's parameters with what is done to them; a subclass is one method."""

    method: str

    def __init__(self, capture: Capture, options: Options) -> None:
        self.capture, self.options = capture, options
        self.random = np.random.default_rng(options.seed)
        self.cameras = [camera for camera, _ in capture.train]
        self.adam = Adam({k: v.requires_grad_() for k, v in self.start().items()})

    @property
    def parameters(self) -> dict[str, torch.Tensor]:
        """Name -> what is optimised."""
        return self.adam.parameters

    @property
    @abstractmethod
    def faces(self) -> int:
        """The number of triangles."""

    @abstractmethod
    def start(self) -> dict[str, torch.Tensor]:
        """Return the parameters to start from."""

    @abstractmethod
    def settings(self, progress: float) -> dict[str, Any]:
        """Return the settings of the image formation at a time from 0 to 1; those at 1 are the file's."""

    @abstractmethod
    def draw(self, camera: Camera, settings: Mapping[str, Any]) -> Drawn:
        """Return what `camera` sees."""

    @abstractmethod
    def rates(self, progress: float) -> dict[str, Any]:
        """Return the rate of each parameter."""

    @abstractmethod
    def restructure(self, progress: float, seen: Statistics) -> None:
        """Drop triangles that show nothing, and split some of those that err most."""

    @abstractmethod
    def write(self, folder: Path, iteration: int, settings: Mapping[str, Any]) -> None:
        """Write the method's official files."""

    def loss(
        self, camera: Camera, photograph: losses.Photograph, progress: float
    ) -> tuple[torch.Tensor, Drawn]:
        """Return what is minimised, and the image."""
        drawn = self.draw(camera, self.settings(progress))
        return losses.photometric(drawn.image, photograph), drawn

    def structure(self) -> dict[str, NDArray[Any]]:
        """Return what else the model consists of."""
        return {}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Take back what `structure` and `Adam.state` returned."""
        self.adam.restore(state)


def between(progress: float, start: float, end: float) -> float:
    """Return how far `progress` is from `start` to `end`, from 0 to 1."""
    return min(max((progress - start) / (end - start), 0.0), 1.0)


def geometric(first: float, last: float, share: float) -> float:
    """Return `first` at 0, `last` at 1, and equal factors in equal times between."""
    return float(first ** (1 - share) * last**share)


def worst(scores: NDArray[Any], allowed: NDArray[np.bool_], count: int, random: np.random.Generator) -> Any:
    """Return the numbers of `count` of those allowed, drawn with odds as the scores have them."""
    with np.errstate(divide="ignore"):
        # The largest of log score + Gumbel noise: drawing without replacement, in one pass.
        keys = np.log(np.where(allowed, scores, 0)) + random.gumbel(size=len(scores))
    count = min(count, int(np.isfinite(keys).sum()))
    return np.sort(np.argpartition(-keys, max(count - 1, 0))[:count]) if count else np.zeros(0, np.int64)

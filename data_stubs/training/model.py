"""Base class of trainable models."""

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
    """Options of a training: the largest number of `faces`, `sh_degree`, and the `seed` of random numbers.

    `rasterizer` and `gamma` are 2DTS' rasterizer and final sharpness; `level` is the level of DiffSoup's
    lattices.
    """

    faces: int = 8000
    sh_degree: int = 2
    seed: int = 0
    rasterizer: str = "3D"
    gamma: float = 50.0
    level: int = 2


class Statistics:
    """Statistics of each triangle since the last change of structure.

    `peak` (F,) is the largest weight of the triangle at any sample. `error` (F,) is the sum of the triangle's
    weights times the absolute errors of the images.
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
    """The parameters of a model and the operations on them; each method is a subclass."""

    method: str

    def __init__(self, capture: Capture, options: Options) -> None:
        self.capture, self.options = capture, options
        self.random = np.random.default_rng(options.seed)
        self.cameras = [camera for camera, _ in capture.train]
        self.adam = Adam({k: v.requires_grad_() for k, v in self.start().items()})

    @property
    def parameters(self) -> dict[str, torch.Tensor]:
        """Name -> optimised tensor."""
        return self.adam.parameters

    @property
    @abstractmethod
    def faces(self) -> int:
        """The number of triangles."""

    @abstractmethod
    def start(self) -> dict[str, torch.Tensor]:
        """Return the initial parameters."""

    @abstractmethod
    def settings(self, progress: float) -> dict[str, Any]:
        """Return the settings of the image formation at a time from 0 to 1; the file has those at 1."""

    @abstractmethod
    def draw(self, camera: Camera, settings: Mapping[str, Any]) -> Drawn:
        """Return the image from `camera`."""

    @abstractmethod
    def rates(self, progress: float) -> dict[str, Any]:
        """Return the learning rate of each parameter."""

    @abstractmethod
    def restructure(self, progress: float, seen: Statistics) -> None:
        """Remove invisible triangles, and split some with large errors."""

    @abstractmethod
    def write(self, folder: Path, iteration: int, settings: Mapping[str, Any]) -> None:
        """Write the method's official files."""

    def loss(
        self, camera: Camera, photograph: losses.Photograph, progress: float
    ) -> tuple[torch.Tensor, Drawn]:
        """Return the loss and the image."""
        drawn = self.draw(camera, self.settings(progress))
        return losses.photometric(drawn.image, photograph), drawn

    def structure(self) -> dict[str, NDArray[Any]]:
        """Return the non-optimised state of the model."""
        return {}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restore the values of `structure` and `Adam.state`."""
        self.adam.restore(state)


def between(progress: float, start: float, end: float) -> float:
    """Return the position of `progress` between `start` and `end`, clamped to 0 to 1."""
    return min(max((progress - start) / (end - start), 0.0), 1.0)


def geometric(first: float, last: float, share: float) -> float:
    """Interpolate geometrically between `first` at 0 and `last` at 1."""
    return float(first ** (1 - share) * last**share)


def worst(scores: NDArray[Any], allowed: NDArray[np.bool_], count: int, random: np.random.Generator) -> Any:
    """Draw `count` allowed indices without replacement, with probabilities proportional to the scores."""
    with np.errstate(divide="ignore"):
        # Gumbel top-k: the indices with the largest sum of log score and noise are a draw without
        # replacement.
        keys = np.log(np.where(allowed, scores, 0)) + random.gumbel(size=len(scores))
    count = min(count, int(np.isfinite(keys).sum()))
    return np.sort(np.argpartition(-keys, max(count - 1, 0))[:count]) if count else np.zeros(0, np.int64)

"""The model that a pipeline with a z-buffer draws: opaque triangles that carry lattices, and their decoder.

A method's module `look` has a function ``surface_model(asset, settings)`` that returns a `Surface`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from msb.render.splat.model import Model

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from msb.scenes import Camera


@dataclass(frozen=True, kw_only=True)
class Surface(Model):
    """A model whose faces are opaque where their opacity is at or above a threshold.

    Attributes
    ----------
    indices : (F, 3) uint32
    opacity : (F, S) float32 or uint8
        Samples of each face's lattice.
    features : (F, S, C), of the same dtype
    decoder : (n,) float32
        In the order in which the method's WGSL has it.
    level : int
        Of the lattices.
    projection : callable
        Camera -> the (4, 4) float32 matrix from the world to clip coordinates.
    """

    indices: NDArray[np.uint32]
    opacity: NDArray[Any]
    features: NDArray[Any]
    decoder: NDArray[np.float32]
    level: int
    projection: Callable[[Camera], NDArray[np.float32]]

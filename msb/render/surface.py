"""The model that a pipeline with a z-buffer draws: opaque triangles that carry lattices, and their decoder.

A method's module `look` has a function ``surface_model(asset, settings)`` that returns a `Surface`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.scenes import Camera


@dataclass(frozen=True)
class Surface:
    """A model whose faces are opaque where their opacity is at or above a threshold.

    Attributes
    ----------
    program, package : str
        The WGSL file, and the package that holds it.
    positions : (V, 3) float32
    indices : (F, 3) uint32
    coverage : (F, c) float32
        What the WGSL reads of each face whatever the view.
    opacity : (F, S) float32 or uint8
        Samples of each face's lattice.
    features : (F, S, C), of the same dtype
    level : int
        Of the lattices.
    decoder : (n,) float32
        In the order in which the method's WGSL has it.
    near, far : float
        The planes of the projection.
    projection : callable
        Camera -> the (4, 4) float32 matrix from the world to clip coordinates.
    own : mapping of str to numpy.float32, numpy.int32 or numpy.uint32
        Values for the WGSL that the settings decide: members of ``view.own`` by their names.
    """

    program: str
    package: str
    positions: NDArray[np.float32]
    indices: NDArray[np.uint32]
    coverage: NDArray[np.float32]
    opacity: NDArray[Any]
    features: NDArray[Any]
    level: int
    decoder: NDArray[np.float32]
    near: float
    far: float
    projection: Callable[[Camera], NDArray[np.float32]]
    own: Mapping[str, np.generic]

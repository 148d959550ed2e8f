"""The model that a z-buffer pipeline draws: opaque triangles with feature lattices and a decoder.

The module `native` of a method has a function ``surface_model(asset, settings)`` that returns a `Surface`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.scenes import Camera


@dataclass(frozen=True)
class Surface:
    """A model whose faces are drawn at samples where their opacity reaches a threshold.

    Attributes
    ----------
    program, package : str
        The WGSL file, and the package that contains it.
    positions : (V, 3) float32
    indices : (F, 3) uint32
    coverage : (F, c) float32
        Values per face that the WGSL reads and that do not depend on the view.
    opacity : (F, S) float32 or uint8
        Samples of each face's lattice.
    features : (F, S, C), with the dtype of `opacity`
    level : int
        The level of the lattices.
    decoder : (n,) float32
        Weights and biases, in the order that the method's WGSL expects.
    near, far : float
        The planes of the projection, in scene units.
    projection : callable
        Function that returns the (4, 4) float32 matrix from world to clip coordinates for a camera.
    method_values : mapping of str to numpy.float32, numpy.int32 or numpy.uint32
        Values of the method's settings for the WGSL: the members of ``view.own``, by name.
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
    method_values: Mapping[str, np.generic]

"""The model that the splatting pipeline draws: an asset as the kernels take it, and helpers that make one.

A method's module `look` has a function ``splat_model(asset, settings)`` that returns a `Model`, beside its
one kernel file, which the head of `splat_stages.cl` describes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.activation import rest_coefficients
from msb.asset.drawable import require, required_buffer
from msb.registry import METHODS, role
from msb.render.splat.view import Culling

Settings = Mapping[str, Any]

# Depth in scene units in front of which an engine clips.
ENGINE_NEAR = 0.01
# The logarithm of what is 0 in float32. Powers that end below it are slow to raise to, and where sigma is as
# small as after training most do.
_LEAST = -105.0
CLIPPED = Culling(nearest=ENGINE_NEAR, dilation=1.0, clipped=True)


@dataclass(frozen=True)
class Model:
    """An asset as the kernels take it, with activated parameters and the settings in force.

    Attributes
    ----------
    program, package : str
        The kernel file, and the package that holds it.
    face_words, engine_words : int
        The size of the file's struct `Face`, in words of four bytes, for official and for an engine's
        sampling.
    defines : mapping
        The definitions that the file is compiled with.
    near, far : float
        The planes of the official projection matrix.
    culling, engine_culling : Culling
    scale : int
        The number of samples per pixel along each axis.
    box_mean : bool
        Whether pixels are means of all their samples; otherwise they are interpolated bilinearly.
    own : mapping of str to numpy.float32, numpy.int32 or numpy.uint32
        Values for the method's kernels that the settings decide: members of ``view->own`` by their names.
    positions : (V, 3) float32
    coverage : (n, c) float32
        The activated opacity of faces or vertices, and values that it and the falloff decide for every view;
        each method's kernel file says which values.
    vertex_colors : bool
        Whether colours and opacities belong to vertices; otherwise they belong to faces.
    outputs : tuple of str
        The optional fields of a frame that the method defines.
    raw : mapping
        Name of the official kernel's buffer -> our plane.
    """

    program: str
    package: str
    face_words: int
    engine_words: int
    positions: NDArray[np.float32]
    coverage: NDArray[np.float32]
    near: float
    far: float
    culling: Culling
    raw: Mapping[str, str]
    outputs: tuple[str, ...]
    defines: Mapping[str, bool] = field(default_factory=dict)
    scale: int = 1
    box_mean: bool = False
    own: Mapping[str, np.generic] = field(default_factory=dict)
    vertex_colors: bool = False
    engine_culling: Culling = CLIPPED

    @property
    def pixel_samples(self) -> tuple[int, int]:
        """The first and the last sample along each axis whose mean is a pixel.

        They are all of the pixel's, or the one or two in its middle, as bilinear interpolation has it.
        """
        return (0, self.scale - 1) if self.box_mean else ((self.scale - 1) // 2, self.scale // 2)


def rim(opacity: NDArray[np.float32], sigma: NDArray[np.float32] | np.float32) -> NDArray[np.float32]:
    """Return a little less than the phi at which o phi^sigma = 1/255; 2 where alpha is less everywhere."""
    share = 1 / (255.0 * np.maximum(opacity, 1e-30).astype(np.float64))
    found = np.where(share < 1.0001, np.float32(0), np.float32(2))
    with np.errstate(divide="ignore"):  # a sigma that is 0 in float32: phi^0 is 1 everywhere inside
        power = np.broadcast_to(1 / np.asarray(sigma, np.float64), share.shape)
        near = (share >= np.exp(_LEAST / power)) & (share < 1.0001)
        found[near] = np.minimum(share[near], 1) ** power[near] * 0.9999
    return found


def contour(opacity: NDArray[np.float32], sigma: NDArray[np.float32] | np.float32) -> NDArray[np.float32]:
    """Return the phi at which o phi^sigma = 0.01, as the official fast power has it: each step rounded."""
    with np.errstate(divide="ignore", over="ignore"):
        power = (1 / sigma) * np.log2(np.float32(0.01) / opacity, dtype=np.float64).astype(np.float32)
        return np.asarray(np.exp2(power, dtype=np.float64), np.float32)


def make_model(asset: Asset, settings: Settings) -> Model:
    """Return `asset` as the kernels take it, as its method's module `look` makes it (``splat_model``)."""
    method = asset.manifest.method
    look: Any = role(method, "look")
    require(asset, "compositing", "kind", "front_to_back")
    require(asset, "coverage", "kernel", METHODS[method].coverage)
    model: Model = look.splat_model(asset, settings)
    return model


def sh_buffers(asset: Asset, rows: int) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return `f_dc`, and `f_rest` in the order coefficient, channel (None at degree 0)."""
    first = required_buffer(asset, "f_dc", rows, 3)
    degree = asset.manifest.sh_degree
    if degree == 0:
        return first, None
    rest = required_buffer(asset, "f_rest", rows, 3 * ((degree + 1) ** 2 - 1))
    return first, np.ascontiguousarray(rest_coefficients(asset)).reshape(rest.shape)


def soup_positions(asset: Asset) -> NDArray[np.float32]:
    """Return positions as rows of three corners a face, whatever the indices are."""
    positions, indices = asset.buffers["positions"], asset.buffers["indices"]
    if asset.manifest.topology == "triangle_soup":
        return positions
    return np.asarray(positions[indices.reshape(-1)])

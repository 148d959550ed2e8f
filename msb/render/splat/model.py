"""The model that the splatting pipeline draws, and helper functions that build one from an asset.

The module `native` of a method has a function ``splat_model(asset, settings)`` that returns a `SplatModel`.
The method's only kernel file is in the same folder. The comment at the top of `splat_stages.cl` lists the
required contents of the kernel file.
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

# Near plane of the engine sampling in scene units, equal to the near plane of the standard tier.
ENGINE_NEAR = 0.01
# If the natural logarithm of a power is below this value, the float32 power is 0. The smallest float32 is
# exp(-103.3). These tiny powers are slow to compute, and small sigmas produce many of them.
_LEAST = -105.0
# Culling with engine sampling: faces are clipped at the near plane, and extend no farther than their corners.
CLIPPED = Culling(nearest=ENGINE_NEAR, dilation=1.0, clipped=True)


@dataclass(frozen=True)
class SplatModel:
    """An asset in the form that the kernels read: activated parameters and the values of the settings.

    Attributes
    ----------
    program, package : str
        The kernel file, and the package that contains it.
    face_words, engine_words : int
        The size of the file's struct `Face` in words of four bytes, for official and for engine sampling.
    defines : mapping
        Definitions for the compilation of the kernel file.
    near, far : float
        The planes of the official projection matrix, in scene units.
    culling, engine_culling : Culling
    scale : int
        The number of samples per pixel along each axis.
    box_mean : bool
        Whether a pixel is the mean of all its samples. If false, pixels are interpolated bilinearly from
        the samples around their centres.
    method_values : mapping of str to numpy.float32, numpy.int32 or numpy.uint32
        Values of the method's settings for its kernels: the members of ``view->own`` by name.
    positions : (V, 3) float32
    coverage : (n, c) float32
        The activated opacity of faces or vertices, and values derived from it and the falloff that do not
        depend on the view. The method's kernel file documents the columns.
    vertex_colors : bool
        Whether colours and opacities belong to vertices; otherwise they belong to faces.
    outputs : tuple of str
        The optional fields of a frame that the method defines.
    raw : mapping
        Maps the name of an official buffer to our plane with the same content.
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
    method_values: Mapping[str, np.generic] = field(default_factory=dict)
    vertex_colors: bool = False
    engine_culling: Culling = CLIPPED

    @property
    def pixel_samples(self) -> tuple[int, int]:
        """The first and the last sample along each axis that are averaged into a pixel.

        With `box_mean`, all samples of the pixel are averaged. Without `box_mean`, a pixel is the mean of the
        one or two middle samples. This mean is bilinear interpolation at the centre of the pixel.
        """
        return (0, self.scale - 1) if self.box_mean else ((self.scale - 1) // 2, self.scale // 2)


def rim(opacity: NDArray[np.float32], sigma: NDArray[np.float32] | np.float32) -> NDArray[np.float32]:
    """Return the phi below which alpha is less than 1/255, or 2 if alpha is less than 1/255 in the whole
    face.

    A face with opacity o has alpha = o phi^sigma, where phi is 0 on its edges and 1 at its incentre.
    The result is slightly reduced to allow for rounding, because samples with a smaller phi are skipped.
    """
    share = 1 / (255.0 * np.maximum(opacity, 1e-30).astype(np.float64))
    limit = np.where(share < 1.0001, np.float32(0), np.float32(2))
    # If sigma is 0, phi^0 is 1 in the whole face.
    with np.errstate(divide="ignore"):
        power = np.broadcast_to(1 / np.asarray(sigma, np.float64), share.shape)
        near = (share >= np.exp(_LEAST / power)) & (share < 1.0001)
        limit[near] = np.minimum(share[near], 1) ** power[near] * 0.9999
    return limit


def contour(opacity: NDArray[np.float32], sigma: NDArray[np.float32] | np.float32) -> NDArray[np.float32]:
    """Return the phi that solves o phi^sigma = 0.01. Each step rounds like the official fast power
    function."""
    with np.errstate(divide="ignore", over="ignore"):
        power = (1 / sigma) * np.log2(np.float32(0.01) / opacity, dtype=np.float64).astype(np.float32)
        return np.asarray(np.exp2(power, dtype=np.float64), np.float32)


def make_model(asset: Asset, settings: Settings) -> SplatModel:
    """Return the model of an asset, built by ``splat_model`` of its method's module `native`."""
    method = asset.manifest.method
    native: Any = role(method, "native")
    require(asset, "compositing", "kind", "front_to_back")
    require(asset, "coverage", "kernel", METHODS[method].coverage)
    model: SplatModel = native.splat_model(asset, settings)
    return model


def sh_buffers(asset: Asset, rows: int) -> tuple[NDArray[Any], NDArray[Any] | None]:
    """Return `f_dc`, and `f_rest` in coefficient-major order (None at degree 0)."""
    first = required_buffer(asset, "f_dc", rows, 3)
    degree = asset.manifest.sh_degree
    if degree == 0:
        return first, None
    rest = required_buffer(asset, "f_rest", rows, 3 * ((degree + 1) ** 2 - 1))
    return first, np.ascontiguousarray(rest_coefficients(asset)).reshape(rest.shape)


def soup_positions(asset: Asset) -> NDArray[np.float32]:
    """Return positions (3 F, 3) with three rows per face, also for meshes with shared vertices."""
    positions, indices = asset.buffers["positions"], asset.buffers["indices"]
    if asset.manifest.topology == "triangle_soup":
        return positions
    return np.asarray(positions[indices.reshape(-1)])

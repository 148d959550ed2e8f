"""Reference renderers: each method's official image formation in readable NumPy, slow and obviously right.

In float32 they repeat the official kernels operation by operation and are the oracle of the OpenCL kernels;
in float64 they are compared by statistics. docs/reference.md describes the formulas and how closely they
agree.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from msb.asset.drawable import check_drawable
from msb.asset.settings import check_modes, effective_settings
from msb.errors import Unsupported
from msb.methods import METHODS
from msb.reference import diffsoup, mesh_splatting, triangle_splatting, two_dts
from msb.reference.frame import ReferenceFrame
from msb.reference.modes import Modes

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from msb.asset import Asset
    from msb.methods import Order, Sampling
    from msb.scenes import Camera

__all__ = ["RENDERERS", "ReferenceFrame", "render_reference"]

RENDERERS = MappingProxyType(
    {
        "two_dts": two_dts.render,
        "triangle_splatting": triangle_splatting.render,
        "mesh_splatting": mesh_splatting.render,
        "diffsoup": diffsoup.render,
    }
)
"""Method -> its renderer."""


def render_reference(
    asset: Asset,
    camera: Camera,
    background: Sequence[float] = (0, 0, 0),
    settings: Mapping[str, Any] | None = None,
    dtype: type[Any] = np.float32,
    order: Order = "tile",
    sampling: Sampling = "official",
) -> ReferenceFrame:
    """Return `asset` as its method's official renderer, or a game engine, would show it to `camera`.

    Parameters
    ----------
    asset : Asset
    camera : Camera
        OpenCV axes, for every method. A principal point off the middle shifts the image of the three
        splatting methods, whose official code ignores it, and enters DiffSoup's with upstream's sign.
    background : sequence of 3 floats
        In the stored colour space.
    settings : mapping, optional
        Overrides of the asset's settings.
    dtype : numpy.float32 or numpy.float64
        float32: the official order of operations in strict IEEE float32. float64: the same in double.
    order, sampling : str
        "tile" and "official" are as officially; the others are what an engine does (docs/dedicated.md).

    Raises
    ------
    Unsupported
        UNSUPPORTED_TIER: the method has no appearance of its own.
    UsageError
        SETTING_UNKNOWN or SETTING_VALUE; USAGE: an unknown order or sampling.
    AssetError
        TRIASSET_VALUE_NONFINITE, TRIASSET_INDEX_OUT_OF_RANGE, TRIASSET_BUFFER_REQUIRED,
        TRIASSET_BUFFER_SHAPE or TRIASSET_FIELD_VALUE: the buffers cannot be drawn.

    Examples
    --------
    >>> import msb
    >>> from msb.reference import render_reference
    >>> asset = msb.load("data_stubs/splat_like.triasset")
    >>> camera = msb.Camera.look_at((0, 0, 4), (0, 0, 0), up=(0, 1, 0), width=12, height=8, fov_y=0.9)
    >>> frame = render_reference(asset, camera, background=(1, 1, 1))
    >>> frame.image.shape, frame.image.dtype.name, frame.visible.shape
    ((8, 12, 3), 'float32', (34761,))
    """
    method = asset.manifest.method
    if method not in RENDERERS:
        reason = METHODS[method].unsupported.get("reference", "there is no reference renderer of it")
        text = f"{method} has no reference tier: {reason}"
        raise Unsupported("UNSUPPORTED_TIER", text, file=asset.path, value="reference")
    if np.dtype(dtype) not in (np.dtype(np.float32), np.dtype(np.float64)):
        text = f"dtype is {np.dtype(dtype)}; it must be float32 or float64"
        raise ValueError(text)
    dtype = np.dtype(dtype).type
    values = effective_settings(asset.manifest, settings)
    check_modes(order, sampling)
    check_drawable(asset)
    color = np.asarray(background, dtype)
    if color.shape != (3,) or not np.isfinite(color).all():
        text = f"background is {background!r}; it must be three finite numbers"
        raise ValueError(text)
    # Dropped faces are computed with too, and give what they give.
    with np.errstate(all="ignore"):
        return RENDERERS[method](asset, camera, color, values, dtype, Modes(order, sampling))

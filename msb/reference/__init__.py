"""Reference renderers: the official image formation of each method in readable NumPy.

The renderers are slow and easy to verify.

In float32 the renderers repeat the official kernels operation by operation. The OpenCL kernels are tested
against the reference renderers. Results in float64 may differ from float32 results where a single rounding
decides. The formulas and the measured agreement are in docs/reference.md.
"""

import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from msb.asset import Asset
from msb.asset.arguments import A_CAMERA, AN_ASSET, check_type
from msb.asset.drawable import check_drawable
from msb.asset.origin import without_origin
from msb.asset.settings import check_modes, effective_settings
from msb.base.version import __version__
from msb.errors import Unsupported, UsageError, shorten
from msb.reference.frame import ReferenceFrame
from msb.reference.tiles import Modes
from msb.registry import Order, Sampling, lookup, role
from msb.scenes import Camera
from msb.scenes.colors import check_background
from msb.scenes.datasets import default_background

__all__ = ["ReferenceFrame", "ReferenceRenderer", "render_reference"]


def render_reference(
    asset: Asset,
    camera: Camera,
    background: Sequence[float] | str | None = None,
    settings: Mapping[str, Any] | None = None,
    dtype: type[Any] = np.float32,
    order: Order = "tile",
    sampling: Sampling = "official",
) -> ReferenceFrame:
    """Render `asset` with the image formation of its method's official code, or of a game engine.

    Parameters
    ----------
    asset : Asset
    camera : Camera
        The camera has OpenCV axes for every method. An off-centre principal point shifts the image of the
        splatting methods, although their official code ignores it. For DiffSoup, the vertical principal point
        has the sign of the official code.
    background : sequence of 3 floats, or str, optional
        The background colour in the stored colour space. The accepted values and the default are the same as
        in `msb.Renderer.render`.
    settings : mapping, optional
        Overrides of the asset's settings.
    dtype : numpy.float32 or numpy.float64
        float32: the official order of operations in strict IEEE float32. float64: the same operations in
        double precision.
    order, sampling : str
        "tile" and "official" repeat the official code; the other values imitate a game engine
        (docs/dedicated.md).

    Raises
    ------
    Unsupported
        UNSUPPORTED_TIER: the method has no reference renderer.
    UsageError
        SETTING_UNKNOWN or SETTING_VALUE; USAGE: an unknown order, sampling or dtype, or an argument of the
        wrong type.
    AssetError
        TRIASSET_VALUE_NONFINITE, TRIASSET_INDEX_OUT_OF_RANGE, TRIASSET_BUFFER or TRIASSET_FIELD: the buffers
        cannot be drawn.

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
    check_type("asset", asset, Asset, AN_ASSET)
    check_type("camera", camera, Camera, A_CAMERA)
    method = asset.manifest.method
    module: Any = role(method, "reference")
    if module is None:
        reason = lookup(method).unsupported.get(
            "reference", "the package of the method contains no reference renderer"
        )
        text = f"{method} on tier reference: {reason}"
        raise Unsupported("UNSUPPORTED_TIER", text, file=asset.opened_from)
    real = precision(dtype)
    values = effective_settings(asset.manifest, settings)
    check_modes(order, sampling)
    check_drawable(asset)
    if background is None:
        background = default_background(asset.manifest)
    color = np.asarray(check_background(background, asset.manifest.appearance.get("background")), real)
    # Culled faces also pass through the array operations, so divisions by zero are expected.
    with np.errstate(all="ignore"):
        view = camera.in_units(asset.manifest.origin)
        frame: ReferenceFrame = module.render(asset, view, color, values, real, Modes(order, sampling))
    return camera.in_world(frame)


def precision(dtype: Any) -> type[Any]:
    """Return the NumPy type of `dtype`, which must be float32 or float64."""
    for real in (np.float32, np.float64):
        if dtype is real or (isinstance(dtype, str | np.dtype) and dtype == np.dtype(real)):
            return real
    text = f"dtype is {shorten(str(dtype), 40)}; it must be float32 or float64"
    raise UsageError("USAGE", text)


class ReferenceRenderer:
    """The reference renderers as a `Backend`; they run in NumPy on the host and ignore `device`."""

    name = "msb-reference"
    version = __version__

    def __init__(
        self,
        asset: Asset,
        *,
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        dtype: str = "float32",
        order: Order = "tile",
        sampling: Sampling = "official",
    ) -> None:
        check_modes(order, sampling)
        rules: dict[str, Any] = {"order": order, "sampling": sampling, "dtype": precision(dtype)}
        # Cameras passed to a backend are already relative to the origin.
        self._draw = partial(render_reference, without_origin(asset), settings=settings, **rules)

    def render(self, camera: Camera, background: tuple[float, float, float]) -> ReferenceFrame:
        """Draw the asset from `camera` over `background`; `timings` contains the time spent in NumPy."""
        start = time.perf_counter()
        frame = self._draw(camera=camera, background=background)
        frame.timings["numpy"] = 1000 * (time.perf_counter() - start)
        return frame

    def memory(self) -> Mapping[str, int]:
        """Return an empty mapping, because no device is used."""
        return {}

    def close(self) -> None:
        """Do nothing, because no device memory is held."""

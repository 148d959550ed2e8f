"""Render an asset from a camera on any renderer tier."""

import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from typing import Any, Self

from msb.api.opening import as_asset
from msb.asset import Asset
from msb.asset.arguments import A_CAMERA, check_type
from msb.cl import Device
from msb.errors import UsageError, one_line
from msb.registry import Tier
from msb.render.backend import DrawTime, attribute_errors, class_for, make_backend
from msb.render.frame import Frame
from msb.scenes import Camera
from msb.scenes.colors import Color, check_background
from msb.scenes.datasets import default_background

Background = Sequence[float] | str


class Renderer:
    """An asset on one renderer tier, ready to be rendered many times; constant data stay on the device.

    Parameters
    ----------
    asset : Asset or path-like
        The asset, or a path that `msb.open` can read.
    tier : {"standard", "dedicated", "reference"}
        "standard" draws an ordinary opaque mesh, like every engine (docs/standard.md). "dedicated" is
        native rendering in OpenCL, by the image formation of the method (docs/dedicated.md). "reference" is
        native rendering in NumPy, which is slow (docs/reference.md).
    device : str or Device, optional
        Where to compute: "cpu", "gpu" or "PLATFORM:INDEX". The default device is MSB_DEVICE, otherwise the
        first usable device. Other engines accept "cpu" or "gpu", and choose a device by default.
    settings : mapping, optional
        Overrides of the settings that the asset stores; `msb methods` lists the settings.
    name : str, optional
        The entry point of the group `msb.renderers` that replaces the tier's built-in renderer.
    **options
        Other options of the renderer. The dedicated and the reference tier accept `order` ("tile", "global",
        "none") and `sampling` ("official", "engine"), which docs/dedicated.md explains. The standard tier
        accepts `supersample`, the samples along each side of a pixel, from 1 to 16.

    Raises
    ------
    Unsupported
        The method does not support this tier, or the renderer lacks the option.
    UsageError
        A tier, renderer or setting is unknown, or an argument has the wrong type.
    AssetError
        The asset's values cannot be drawn: an index is out of range, or a coordinate is not finite.
    InputError, CheckpointError, MeshFileError, MeshError
        `msb.open` cannot read the path `asset`.
    DeviceError
        No device was found, or its memory is too small.

    Examples
    --------
    >>> import msb
    >>> asset = msb.load("data_stubs/splat_like.triasset")
    >>> camera = msb.Camera.look_at(
    ...     (0.5, 0.5, -1.5), (0.5, 0.5, 0.5), up=(0, 1, 0), width=64, height=48, fov_y=0.9
    ... )
    >>> with msb.Renderer(asset, tier="standard") as renderer:
    ...     frame = renderer.render(camera, background=(1, 1, 1))
    >>> frame.image.shape, float(frame.alpha.max())
    ((48, 64, 3), 1.0)
    """

    def __init__(
        self,
        asset: Asset | str | os.PathLike[str],
        tier: Tier = "standard",
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        *,
        name: str | None = None,
        **options: Any,
    ) -> None:
        if settings is not None:
            check_type("settings", settings, Mapping, "a mapping from names to values")
        if device is not None and not isinstance(device, str | Device) and name is None:
            text = f'device is of type {type(device).__name__}; pass text such as "cpu", or an open device'
            raise UsageError("DEVICE_SELECTOR", text)
        asset = as_asset(asset)
        self.tier = tier
        self._drawn = f"{asset.manifest.method}, {asset.manifest.face_count:,} faces"
        self._is_closed = False
        self._origin = asset.manifest.origin
        self._official = asset.manifest.appearance.get("background")
        self._background = default_background(asset.manifest)
        self._by = name or tier
        make = class_for(asset, tier, name, options)
        self._backend = make_backend(make, self._by, asset, device=device, settings=settings or {}, **options)

    @property
    def name(self) -> str:
        """Name and version of the drawing software."""
        with attribute_errors(self._by):
            return f"{self._backend.name} {self._backend.version}"

    @property
    def device_info(self) -> Mapping[str, str] | None:
        """The `platform`, `name` and `kind` of the drawing device if it does not use OpenCL, otherwise
        None."""
        return getattr(self._backend, "device_info", None)

    def render(self, camera: Camera, background: Background | None = None) -> Frame:
        """Return the image of `camera` over `background`, as a frame.

        Parameters
        ----------
        camera : Camera
        background : (3,) array_like of float, or str, optional
            Red, green and blue in the asset's colour space, all finite. Possible texts are "black", "white",
            "#rrggbb", "r,g,b" with numbers in 0..1, and "official", the background that the asset records.
            The default background is "official". If the asset records no background, the background of the
            method is used; meshes have a black background.

        Raises
        ------
        UsageError
            `USAGE`: the camera or the colour is invalid. `SETTING_VALUE`: no image can be rendered with the
            value of a setting.
        DeviceError
            The frame does not fit into the device's memory, or the device failed.
        """
        checked = self._check_view(camera, background)
        with attribute_errors(self._by):
            frame = self._backend.render(*checked)
            if not isinstance(frame, Frame):
                # A renderer that does not import msb may return any object with the attributes of `Frame`.
                names = (item.name for item in fields(Frame))
                frame = Frame(**{name: getattr(frame, name) for name in names if hasattr(frame, name)})
            return camera.in_world(frame)

    def draw(self, camera: Camera, background: Background | None = None) -> DrawTime:
        """Render without reading the frame back, wait until it is complete, and return the duration.

        If the renderer has no method `draw`, the frame is read back and discarded. The parameters and errors
        are the same as in `render`.
        """
        if not hasattr(self._backend, "draw"):
            stages = self.render(camera, background).timings
            return DrawTime(stages, sum(stages.values()))
        checked = self._check_view(camera, background)
        with attribute_errors(self._by):
            return self._backend.draw(*checked)

    def _check_view(self, camera: Camera, background: Background | None) -> tuple[Camera, Color]:
        check_type("camera", camera, Camera, A_CAMERA)
        seen = camera.in_units(self._origin)
        if background is None:
            return seen, self._background
        return seen, check_background(background, self._official)

    def memory(self) -> Mapping[str, int]:
        """Return the bytes of device memory by purpose."""
        with attribute_errors(self._by):
            return self._backend.memory()

    def memory_groups(self) -> Mapping[str, str]:
        """Return "geometry", "appearance", "scratch" or "targets" for each purpose; all other purposes are
        scratch."""
        with attribute_errors(self._by):
            groups: Mapping[str, str] = getattr(self._backend, "memory_groups", dict)()
            return groups

    def close(self) -> None:
        """Release all memory on the device."""
        self._is_closed = True
        with attribute_errors(self._by):
            self._backend.close()

    def __repr__(self) -> str:
        words = [self._drawn]
        with suppress(Exception):  # a renderer of another package can raise any exception
            words.append(f"by {self.name}")
            info = self.device_info
            words += [] if info is None else [f"on {info['name']}"]
        words += ["closed"] if self._is_closed else []
        return one_line(f"<Renderer {self.tier}: {', '.join(words)}>")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def render(
    asset: Asset | str | os.PathLike[str],
    camera: Camera,
    tier: Tier = "standard",
    background: Background | None = None,
    settings: Mapping[str, Any] | None = None,
    device: Any = None,
    **options: Any,
) -> Frame:
    """Render an asset once from a camera.

    For several frames use `Renderer`. `Renderer` keeps the asset on the device, and is faster.

    Parameters
    ----------
    asset : Asset or path-like
        The asset, or a path that `msb.open` can read.
    camera : Camera
    tier : {"standard", "dedicated", "reference"}
        An ordinary opaque mesh, native rendering in OpenCL, or native rendering in NumPy.
    background : (3,) array_like of float, or str, optional
        Red, green and blue, or a text such as "white". The accepted values and the default are the same as in
        `Renderer.render`.
        settings : mapping, optional Overrides of the asset's settings.
    device : str, optional
        The OpenCL device, such as "cpu" or "gpu".
    **options
        Further arguments of `Renderer`: `name`, and options of the tier's renderer.

    Returns
    -------
    Frame
        The fields `image`, `alpha`, `depth` and others.

    Raises
    ------
    Unsupported, UsageError, AssetError, InputError, CheckpointError, MeshFileError, MeshError, DeviceError
        As raised by `Renderer`.

    Examples
    --------
    >>> import msb
    >>> camera = msb.Camera.look_at((0.5, 0.5, -1.5), (0.5, 0.5, 0.5), width=64, height=48, fov_y=0.9)
    >>> frame = msb.render("data_stubs/splat_like.triasset", camera, tier="standard", background="white")
    >>> frame.image.shape
    (48, 64, 3)
    """
    with Renderer(asset, tier, device, settings, **options) as renderer:
        return renderer.render(camera, background)

"""Draw an asset from a camera, on any tier."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, Self

from msb.api.opening import as_asset
from msb.asset import Asset
from msb.asset.arguments import A_CAMERA, check_type
from msb.cl import Device
from msb.errors import UsageError
from msb.registry import Tier
from msb.render.backend import Drawn, blaming, class_for, make_backend
from msb.render.frame import Frame
from msb.scenes import Camera
from msb.scenes.colors import Color, check_background
from msb.scenes.datasets import own_background

Background = Sequence[float] | str


class Renderer:
    """An asset on one tier, ready to be drawn again and again; data that do not change stay on the device.

    Parameters
    ----------
    asset : Asset or path-like
        The asset, or the path of anything that `msb.open` takes.
    tier : {"standard", "dedicated", "reference"}
        "standard" is the plain mesh that any engine shows (docs/standard.md), "dedicated" is the method's own
        image in OpenCL (docs/dedicated.md), "reference" is the same image in NumPy, slowly
        (docs/reference.md).
    device : str or Device, optional
        Where to compute: "cpu", "gpu" or "PLATFORM:INDEX"; MSB_DEVICE or the default if not given. Foreign
        engines take "cpu" or "gpu", and choose themselves if nothing is given.
    settings : mapping, optional
        Values that replace the settings that the asset stores; `msb methods` lists the settings.
    name : str, optional
        An entry point of group `msb.renderers`, to be used for the tier instead of ours.
    **options
        Other options of the renderer. The dedicated and the reference tier take `order` ("tile", "global",
        "none") and `sampling` ("official", "engine"), which docs/dedicated.md explains; the standard tier
        takes `supersample`, the samples along each side of a pixel, from 1 to 16.

    Raises
    ------
    Unsupported
        The method cannot be shown on this tier, or the renderer has no such option.
    UsageError
        An unknown tier, renderer or setting; an argument of another type.
    AssetError
        The asset's values cannot be drawn: an index out of range, a coordinate that is not finite.
    InputError, CheckpointError, MeshFileError, MeshError
        `asset` is a path at which there is nothing that `msb.open` can read.
    DeviceError
        There is no device, or it has too little memory.

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
            text = f'device is of type {type(device).__name__}; it must be text, as "cpu", or an open device'
            raise UsageError("DEVICE_SELECTOR", text)
        asset = as_asset(asset)
        self.tier = tier
        self._official = asset.manifest.appearance.get("background")
        self._background = own_background(asset.manifest)
        self._by = name or tier
        make = class_for(asset, tier, name, options)
        self._backend = make_backend(make, self._by, asset, device=device, settings=settings or {}, **options)

    @property
    def name(self) -> str:
        """Name and version of what draws."""
        with blaming(self._by):
            return f"{self._backend.name} {self._backend.version}"

    @property
    def device_info(self) -> Mapping[str, str] | None:
        """The `platform`, `name` and `kind` of what draws, if that is no OpenCL device."""
        return getattr(self._backend, "device_info", None)

    def render(self, camera: Camera, background: Background | None = None) -> Frame:
        """Return what `camera` sees, over `background`.

        Parameters
        ----------
        camera : Camera
        background : (3,) array_like of float, or str, optional
            Red, green and blue in the asset's colour space, all finite. Or a text as on the command line:
            "black", "white", "#rrggbb", "r,g,b" in 0..1, or "official", the background that the asset states.
            Default: "official"; where the asset states none, that of its method, which is black for meshes.

        Raises
        ------
        UsageError
            `USAGE`: no camera or no such colour. `SETTING_VALUE`: a setting that no camera can be drawn with.
        DeviceError
            The frame does not fit on the device, or the device fails.
        """
        checked = self._checked(camera, background)
        with blaming(self._by):
            drawn = self._backend.render(*checked)
            if not isinstance(drawn, Frame):
                # A renderer that may not import us (the reference, a third party's) returns the same fields.
                names = (item.name for item in fields(Frame))
                drawn = Frame(**{name: getattr(drawn, name) for name in names if hasattr(drawn, name)})
            return camera.in_world(drawn)

    def draw(self, camera: Camera, background: Background | None = None) -> Drawn:
        """Draw what `camera` sees and wait for it, but read nothing back; return how long the device took.

        A renderer that cannot do that reads its frame back. Parameters and errors are those of `render`.
        """
        if not hasattr(self._backend, "draw"):
            stages = self.render(camera, background).timings
            return Drawn(stages, sum(stages.values()))
        checked = self._checked(camera, background)
        with blaming(self._by):
            return self._backend.draw(*checked)

    def _checked(self, camera: Camera, background: Background | None) -> tuple[Camera, Color]:
        check_type("camera", camera, Camera, A_CAMERA)
        seen = camera.in_units()
        if background is None:
            return seen, self._background
        return seen, check_background(background, self._official)

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes on the device."""
        with blaming(self._by):
            return self._backend.memory()

    def memory_groups(self) -> Mapping[str, str]:
        """Return use -> "geometry", "appearance", "scratch" or "targets"; any other use is scratch."""
        with blaming(self._by):
            groups: Mapping[str, str] = getattr(self._backend, "memory_groups", dict)()
            return groups

    def close(self) -> None:
        """Release everything on the device."""
        with blaming(self._by):
            self._backend.close()

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
    """Draw an asset once, as one camera sees it.

    For several frames `Renderer`, which does the drawing, is faster: it keeps the asset on the device.

    Parameters
    ----------
    asset : Asset or path-like
        Or the path of anything that `msb.open` takes.
    camera : Camera
    tier : {"standard", "dedicated", "reference"}
        The plain mesh as any engine shows it, the method's own look, or that look in NumPy.
    background : (3,) array_like of float, or str, optional
        Red, green and blue, or a text such as "white", as `Renderer.render` takes it; its default, too.
    settings : mapping, optional
        Overrides of the asset's settings.
    device : str, optional
        The OpenCL device, such as "cpu" or "gpu".
    **options
        The further options of `Renderer`: `name`, and what the renderer itself takes.

    Returns
    -------
    Frame
        `image`, `alpha`, `depth` and more.

    Raises
    ------
    Unsupported, UsageError, AssetError, InputError, CheckpointError, MeshFileError, MeshError, DeviceError
        As `Renderer` does.

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

"""Draw an asset from a camera, on any tier."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any, Self

from msb.render.frame import Frame
from msb.render.protocol import Drawn, check_options, check_supported, check_tier, find_renderer

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from msb.asset import Asset
    from msb.methods import Tier
    from msb.render.protocol import Backend
    from msb.scenes import Camera


class Renderer:
    """An asset on one tier, ready to be drawn again and again; what does not change stays on the device.

    Parameters
    ----------
    asset : Asset
    tier : {"standard", "dedicated", "reference"}
        DESIGN: Methods. The reference is NumPy and slow.
    device : str or Device, optional
        Where to compute: "cpu", "gpu", "PLATFORM:INDEX"; MSB_DEVICE or the default if not given. Foreign
        engines take "cpu" or "gpu", and choose themselves if nothing is given.
    settings : mapping, optional
        Overrides of the settings the asset stores; `msb methods` lists them.
    name : str, optional
        An entry point of group `msb.renderers`, to be used for the tier instead of ours.
    **options
        What else the renderer takes: of the dedicated and the reference tier `order` ("tile", "global",
        "none") and `sampling` ("official", "engine"), which docs/dedicated.md explains.

    Raises
    ------
    Unsupported
        The method cannot be shown on this tier, or the renderer has no such option.
    UsageError
        An unknown tier, renderer or setting.
    AssetError
        The asset's values cannot be drawn: an index out of range, a coordinate that is not finite.
    DeviceError
        No device, or too little memory on it.

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
        asset: Asset,
        tier: Tier = "standard",
        device: Any = None,
        settings: Mapping[str, Any] | None = None,
        *,
        name: str | None = None,
        **options: Any,
    ) -> None:
        check_supported(asset, tier)
        self.tier = tier
        make = find_renderer(name or tier)
        check_tier(make, tier, f"renderer {name}")
        check_options(make, options, asset, f"renderer {name}" if name else f"tier {tier}")
        self._backend: Backend = make(asset, device=device, settings=settings or {}, **options)

    @property
    def name(self) -> str:
        """Name and version of what draws."""
        return f"{self._backend.name} {self._backend.version}"

    @property
    def device_info(self) -> Mapping[str, str] | None:
        """What draws, if that is no OpenCL device: `platform`, `name`, `kind`."""
        return getattr(self._backend, "device_info", None)

    def render(self, camera: Camera, background: Sequence[float] = (0.0, 0.0, 0.0)) -> Frame:
        """Return what `camera` sees, over `background` (RGB, in the asset's colour space)."""
        red, green, blue = (float(value) for value in background)
        found = self._backend.render(camera, (red, green, blue))
        if isinstance(found, Frame):
            return found
        # A renderer that may not import us (the reference, a third party's) returns the same fields.
        names = (item.name for item in fields(Frame))
        return Frame(**{name: getattr(found, name) for name in names if hasattr(found, name)})

    def draw(self, camera: Camera, background: Sequence[float] = (0.0, 0.0, 0.0)) -> Drawn:
        """Draw what `camera` sees and wait for it, reading nothing back; return how long the device took.

        A renderer that cannot do that reads its frame back.
        """
        if not hasattr(self._backend, "draw"):
            stages = self.render(camera, background).timings
            return Drawn(stages, sum(stages.values()))
        red, green, blue = (float(value) for value in background)
        return self._backend.draw(camera, (red, green, blue))

    def memory(self) -> Mapping[str, int]:
        """Return use -> bytes on the device."""
        return self._backend.memory()

    def close(self) -> None:
        """Release everything on the device."""
        self._backend.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def render(
    asset: Asset,
    camera: Camera,
    tier: Tier = "standard",
    background: Sequence[float] = (0.0, 0.0, 0.0),
    settings: Mapping[str, Any] | None = None,
    device: Any = None,
    **options: Any,
) -> Frame:
    """Return one frame; for several of one asset a `Renderer` is faster. Parameters and errors as there."""
    with Renderer(asset, tier, device, settings, **options) as renderer:
        return renderer.render(camera, background)

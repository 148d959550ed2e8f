"""What teaches a bake: the model as its method draws it, or the photographs that it was trained on."""

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.bake.arrays import Singles
from msb.bake.cache import Pictures
from msb.bake.lessons import Lessons, whole
from msb.bake.options import Supervision
from msb.bake.views import BakeViews
from msb.base.version import __version__
from msb.cl.devices import choose_device
from msb.errors import AssetError, UsageError
from msb.metrics.ground_truth import ground_truth
from msb.registry import Tier
from msb.render import Renderer
from msb.render.backend import check_supported, lean_options
from msb.scenes import Camera

SAMPLES = 4  # samples along each side of a pixel for a plain mesh, and in the finer of the two numbers


class Teacher:
    """Draws what the views of a bake should show: the asset as its method does, on the device.

    A plain mesh has no other look than the standard tier, which is then drawn with 16 samples a pixel.
    With `source` "photographs" those of the scene teach, and the look is there for numbers alone. What it
    draws is looked for in the folder `cache` first, and kept there.
    """

    def __init__(
        self,
        asset: Asset,
        views: BakeViews,
        source: Supervision = "dedicated",
        device: str | None = None,
        cache: Path | None = None,
    ) -> None:
        if source == "photographs" and views.scene is None:
            raise UsageError("USAGE", "photographs teach with a scene, which says how they are compared")
        self._asset, self._views, self.source = asset, views, source
        manifest = asset.manifest
        plain = why_not(manifest, "dedicated") is not None and why_not(manifest, "standard") is None
        tier: Tier = "standard" if plain else "dedicated"
        check_supported(asset, tier)
        options = {"supersample": SAMPLES} if plain else lean_options(tier, None)
        self._make: Callable[[], Renderer] = partial(Renderer, asset, tier, device, **options)
        self._renderer: Renderer | None = self._make()
        name = self._renderer.name
        self.pictures: Pictures | None = None
        """Those of former bakes, where there is a folder for them."""
        if cache is not None:
            record = choose_device(device).record
            by = __version__, name, json.dumps(options), record.name, record.driver
            self.pictures = Pictures(cache, asset, by)

    def lessons(self, cameras: Sequence[Camera], scale: int = 1) -> Lessons:
        """Return what teaches cameras, in pictures `scale` times as large.

        Photographs have no more pixels than they have: they are not scaled.
        """
        if self.source == "photographs":
            return self.photographs(cameras)
        return self.looks([camera.scaled(scale) if scale > 1 else camera for camera in cameras])

    def looks(self, cameras: Sequence[Camera]) -> Lessons:
        """Return what cameras see by the model's own renderer, drawn when asked for."""
        draw = self._look
        if self.pictures is not None:
            draw = partial(self.pictures.picture, background=self._views.background, draw=self._look)
        return Lessons(cameras, self._views.background, draw)

    def photographs(self, cameras: Sequence[Camera]) -> Lessons:
        """Return the photographs of cameras of the scene as they are compared, read when asked for."""
        return Lessons(cameras, self._views.background, self._photograph)

    def _look(self, camera: Camera) -> NDArray[np.uint16]:
        if self._renderer is None:
            self._renderer = self._make()
        image = self._renderer.render(camera, self._views.background).image
        if not np.isfinite(image).all():
            text = f"its look in view {camera.name} has pixels without a number: its colours must be finite"
            raise AssetError("TRIASSET_VALUE_NONFINITE", text, file=self._asset.path)
        return whole(image)

    def _photograph(self, camera: Camera) -> Singles:
        assert self._views.scene is not None
        return ground_truth(self._views.scene, camera)

    def rest(self) -> None:
        """Release everything on the device until something is to be drawn again."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.rest()

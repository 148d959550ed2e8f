"""The source of training, validation and test images: native renderings, or the scene's photographs."""

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
from msb.bake.image_cache import ImageCache
from msb.bake.images import ViewImages, quantize
from msb.bake.options import Supervision
from msb.bake.views import BakeViews
from msb.base.version import __version__
from msb.cl.devices import choose_device
from msb.errors import AssetError, UsageError
from msb.metrics.ground_truth import ground_truth
from msb.registry import Tier
from msb.render import Renderer
from msb.render.backend import check_supported, minimal_options
from msb.scenes import Camera

# Standard-tier images have this number of samples along each side of a pixel.
SAMPLES_PER_SIDE = 4


# A pixel belongs to the model if its alpha is at least half of 1 / 255.
_MIN_ALPHA = 0.5 / 255


class ImageSource:
    """Renders or reads the target images of the views of a bake.

    Native renderings are drawn by the dedicated tier. A mesh without a native rendering is drawn on the
    standard tier with 16 samples per pixel. If the supervision is "photographs", the training images are the
    scene's photographs. With photographs, native renderings are only used for measurements. Native renderings
    in the folder `cache` are reused by later bakes.
    """

    def __init__(
        self,
        asset: Asset,
        views: BakeViews,
        supervision: Supervision = "native",
        device: str | None = None,
        cache: Path | None = None,
    ) -> None:
        if supervision == "photographs" and views.scene is None:
            text = (
                "photographs can only supervise a bake with a scene; pass --scene with the folder of "
                "the scene"
            )
            raise UsageError("USAGE", text)
        self._asset, self._views, self.supervision = asset, views, supervision
        manifest = asset.manifest
        is_standard = why_not(manifest, "dedicated") is not None and why_not(manifest, "standard") is None
        tier: Tier = "standard" if is_standard else "dedicated"
        check_supported(asset, tier)
        options = {"supersample": SAMPLES_PER_SIDE} if is_standard else minimal_options(tier, None)
        self._open: Callable[[], Renderer] = partial(Renderer, asset, tier, device, **options)
        self._renderer: Renderer | None = self._open()
        name = self._renderer.name
        self.cache: ImageCache | None = None
        """The folder of native renderings from earlier bakes, or None."""
        if cache is not None:
            record = choose_device(device).record
            identity = __version__, name, json.dumps(options), record.name, record.driver
            self.cache = ImageCache(cache, asset, identity)

    def training_images(self, cameras: Sequence[Camera], scale: int = 1) -> ViewImages:
        """Return the training images, `scale` times as large as the views.

        Photographs are not scaled, because enlarged photographs have no more detail.
        """
        if self.supervision == "photographs":
            return self.photographs(cameras)
        return self.native_images([camera.scaled(scale) if scale > 1 else camera for camera in cameras])

    def native_images(self, cameras: Sequence[Camera]) -> ViewImages:
        """Return the native renderings of cameras. Each image is drawn on first use."""
        backgrounds = [self._views.background_of(camera) for camera in cameras]

        def draw(camera: Camera) -> NDArray[np.uint16]:
            background = self._views.background_of(camera)
            if self.cache is not None:
                return self.cache.get(camera, background, self._render)
            return self._render(camera)

        return ViewImages(cameras, self._views.background, draw, backgrounds)

    def covers(self, camera: Camera) -> NDArray[np.bool_]:
        """Return the mask (H, W) of the pixels that the native rendering covers visibly."""
        return self._open_renderer().render(camera, self._views.background).alpha >= _MIN_ALPHA

    def photographs(self, cameras: Sequence[Camera]) -> ViewImages:
        """Return the photographs of the scene's cameras, prepared as for metrics and read on first use."""
        return ViewImages(cameras, self._views.background, self._read_photograph)

    def _render(self, camera: Camera) -> NDArray[np.uint16]:
        image = self._open_renderer().render(camera, self._views.background_of(camera)).image
        if not np.isfinite(image).all():
            text = (
                f"the native rendering of view {camera.name} has pixels that are not finite; "
                "remove invalid colours from the model"
            )
            raise AssetError("TRIASSET_VALUE_NONFINITE", text, file=self._asset.path)
        return quantize(image)

    def _open_renderer(self) -> Renderer:
        if self._renderer is None:
            self._renderer = self._open()
        return self._renderer

    def _read_photograph(self, camera: Camera) -> Singles:
        assert self._views.scene is not None
        return ground_truth(self._views.scene, camera)

    def release(self) -> None:
        """Free the memory of the renderer on the device. The next rendering opens the renderer again."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

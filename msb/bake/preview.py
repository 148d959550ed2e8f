"""The preview image of a bake: target images, the unbaked standard-tier mesh, and the baked mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.bake.arrays import Singles
from msb.bake.image_source import SAMPLES_PER_SIDE, ImageSource
from msb.bake.views import BakeViews
from msb.base.origin import Origin
from msb.render import Renderer
from msb.scenes import Camera
from msb.views import spread_evenly

# Number of rows of the preview image. Each row of the preview shows one view.
_VIEWS = 2
# Number of pixels of the largest image. Three columns of this size fit on a screen.
_MAX_PIXELS = 1 << 18


@dataclass(frozen=True, eq=False, repr=False)
class Preview:
    """Images of a few views side by side, and the views that a page can show.

    Attributes
    ----------
    image : (H, W, 3) float32
        RGB in [0, 1], with one row of images per view. Meshes are drawn with 16 samples per pixel.
    columns : tuple of str
        The titles of the columns from the left. The first title is "photograph" or "native rendering". The
        next title is "unbaked mesh" if the model has a standard tier. The last title is "baked".
    cameras : tuple of Camera
        The test views, or the training views if no view is held out.
    """

    image: Singles
    columns: tuple[str, ...]
    cameras: tuple[Camera, ...]

    def moved_back(self, origin: Origin) -> Preview:
        """Return the preview with its cameras in scene coordinates. The given cameras are relative to
        `origin`."""
        to_scene = -np.asarray(origin)
        return replace(self, cameras=tuple(camera.relative_to(to_scene) for camera in self.cameras))


def make_preview(
    model: Asset, baked: Asset, views: BakeViews, source: ImageSource, device: str | None
) -> Preview:
    """Return the preview of a baked asset.

    Raises
    ------
    DeviceError, and the errors of photographs that cannot be read.
    """
    cameras = views.test or views.all_but_test
    has_photographs = views.scene is not None and bool(views.test)
    chosen = spread_evenly(cameras, _VIEWS)
    columns = {}
    with source.photographs(chosen) if has_photographs else source.native_images(chosen) as whole:
        target = whole.limited_to(_MAX_PIXELS)
        title = "photograph" if has_photographs else "native rendering"
        columns[title] = [target.image(number) for number in range(len(target))]
    for title, asset in (("unbaked mesh", model), ("baked", baked)):
        if why_not(asset.manifest, "standard") is None:
            with Renderer(asset, "standard", device, supersample=SAMPLES_PER_SIDE) as renderer:
                images = [
                    renderer.render(camera, color).image
                    for camera, color in zip(target.cameras, target.backgrounds, strict=True)
                ]
            columns[title] = [np.clip(image, 0, 1) for image in images]
    image = _join_columns(list(columns.values()), views.background)
    return Preview(image, tuple(columns), tuple(cameras))


def _join_columns(columns: list[list[Singles]], background: tuple[float, float, float]) -> Singles:
    """Join columns of images. The images of one row must have the same size."""
    width = max(image.shape[1] for image in columns[0])
    heights = [image.shape[0] for image in columns[0]]
    joined = np.full((sum(heights), len(columns) * width, 3), background, np.float32)
    for number, column in enumerate(columns):
        for image, bottom in zip(column, np.cumsum(heights), strict=True):
            top = bottom - image.shape[0]
            joined[top:bottom, number * width : number * width + image.shape[1]] = image
    return joined

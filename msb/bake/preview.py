"""A picture of what a bake lost: what should be seen, the plain mesh of the model, and what was baked."""

from dataclasses import dataclass

import numpy as np

from msb.asset import Asset
from msb.asset.tiers import why_not
from msb.bake.arrays import Singles
from msb.bake.teacher import SAMPLES, Teacher
from msb.bake.views import BakeViews
from msb.render import Renderer
from msb.scenes import Camera
from msb.views import spread

_VIEWS = 2
_PIXELS = 1 << 18  # pixels of the largest image


@dataclass(frozen=True, eq=False, repr=False)
class Preview:
    """A row of pictures for each of a few views, and the views that a page offers.

    Attributes
    ----------
    picture : (H, W, 3) float32
        RGB in [0, 1]; plain pictures are drawn with 16 samples a pixel.
    columns : tuple of str
        What its columns show, from the left: "photograph" or "own look"; "plain mesh before", if the model
        has one; "baked".
    cameras : tuple of Camera
        The views held back; those that teach where there is none.
    """

    picture: Singles
    columns: tuple[str, ...]
    cameras: tuple[Camera, ...]


def preview(asset: Asset, made: Asset, views: BakeViews, master: Teacher, device: str | None) -> Preview:
    """Return the picture of what was `made` of an asset.

    Raises
    ------
    DeviceError, and those of photographs that cannot be read.
    """
    cameras = views.held_back or views.taught
    photographs = views.scene is not None and bool(views.held_back)
    shown = spread(cameras, _VIEWS)
    columns = {}
    with master.photographs(shown) if photographs else master.looks(shown) as whole:
        truth = whole.within(_PIXELS)
        name = "photograph" if photographs else "own look"
        columns[name] = [truth.image(number) for number in range(len(truth))]
    for name, one in (("plain mesh before", asset), ("baked", made)):
        if why_not(one.manifest, "standard") is None:
            with Renderer(one, "standard", device, supersample=SAMPLES) as renderer:
                columns[name] = [
                    np.clip(renderer.render(camera, views.background).image, 0, 1) for camera in truth.cameras
                ]
    return Preview(_side_by_side(list(columns.values()), views.background), tuple(columns), tuple(cameras))


def _side_by_side(columns: list[list[Singles]], background: tuple[float, float, float]) -> Singles:
    """Return a picture of columns of pictures, whose sizes may differ from row to row."""
    width = max(image.shape[1] for image in columns[0])
    heights = [image.shape[0] for image in columns[0]]
    picture = np.full((sum(heights), len(columns) * width, 3), background, np.float32)
    for number, column in enumerate(columns):
        for image, bottom in zip(column, np.cumsum(heights), strict=True):
            top = bottom - image.shape[0]
            picture[top:bottom, number * width : number * width + image.shape[1]] = image
    return picture

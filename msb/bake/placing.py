"""The frame of a bake: the up direction, the length of the unit, and the height of the floor."""

from dataclasses import replace

import numpy as np

from msb.asset import Asset
from msb.asset.frame import Frame, parse_up, unit_vector
from msb.asset.look import up_axis
from msb.bake.options import BakeOptions
from msb.bake.views import BakeViews
from msb.base.origin import Origin
from msb.render import Renderer

# Longer side, in pixels, of the images in which the lowest visible point is searched.
_SIDE = 320


def choose_frame(
    model: Asset, baked: Asset, views: BakeViews, options: BakeOptions, device: str | None
) -> Frame | None:
    """Return the coordinate frame of the baked asset. Return None if it equals the frame of the model."""
    frame = options.frame or Frame()
    if frame.up is None and views.scene is not None and model.manifest.coordinate_frame.known_up is None:
        frame = replace(frame, up=unit_vector(views.scene.up))
    if options.floor:
        up = frame.up or parse_up(up_axis(model))
        frame = replace(frame, up=up, floor=_find_floor(baked, views, up, device))
    return None if frame == Frame() else frame


def move_frame(frame: Frame | None, origin: Origin) -> Frame | None:
    """Return the frame of a scene for positions relative to `origin`."""
    if frame is None or frame.up is None or frame.floor is None:
        return frame
    return replace(frame, floor=frame.floor + float(np.dot(frame.up, origin)))


def _find_floor(
    baked: Asset, views: BakeViews, up: tuple[float, float, float], device: str | None
) -> float | None:
    """Return the lowest height along `up` that at least two views show.

    Return None if no surface is visible.
    """
    lowest, direction = [], np.array(up)
    with Renderer(baked, "standard", device) as renderer:
        for camera in (*views.training, *views.validation, *views.test):
            small = camera.scaled(min(1.0, _SIDE / max(camera.width, camera.height)))
            depth = renderer.render(small, views.background).depth
            assert depth is not None  # The standard tier renders depths.
            # Height (n,) of the surface at each covered pixel.
            rows, columns = np.nonzero(np.isfinite(depth) & (depth > 0))
            z = depth[rows, columns].astype(np.float64)
            rays = (columns + 0.5 - small.cx) / small.fx, (rows + 0.5 - small.cy) / small.fy, np.ones(len(z))
            along = small.world_to_camera[:3, :3] @ direction
            heights = small.center @ direction + z * sum(r * a for r, a in zip(rays, along, strict=True))
            lowest += [heights.min()] if len(heights) else []
    return float(sorted(lowest)[:2][-1]) if lowest else None

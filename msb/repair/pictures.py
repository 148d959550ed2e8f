"""Pictures of a repair: what was deleted in red, what was added in green, cut edges as lines."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset, build_asset
from msb.asset.look import drawn_colors
from msb.meshes.colors import as_floats
from msb.render import Renderer
from msb.render.images import write_image
from msb.repair.assets import Repaired
from msb.scenes import Camera
from msb.topology.halfedge import NONE

RED, GREEN, CUT = (0.85, 0.1, 0.1), (0.1, 0.7, 0.2), (0.0, 0.0, 0.55)
# Grey of black and of white faces, light enough for the colours to stand out.
_DARKEST, _LIGHTEST = 0.55, 0.9
_NEAR = 0.004  # cut edges are drawn up to this share of their depth behind the visible surface


def keep_picture(
    folder: Path, name: str, original: Asset, done: Repaired, camera: Camera, device: str | None = None
) -> str:
    """Write the picture of a repair that is called `name` into `folder`, and return the file's name."""
    file = f"{re.sub('[^a-z]+', '-', name)}.png"
    write_image(folder / file, picture(original, done, camera, device), "png")
    return file


def picture(
    original: Asset, done: Repaired, camera: Camera, device: str | None = None
) -> NDArray[np.float32]:
    """Return an image (H, W, 3): kept faces grey, deleted ones red, added ones green, cut edges as lines."""
    with Renderer(_colored(original, done), tier="standard", device=device) as renderer:
        frame = renderer.render(camera, background=(1.0, 1.0, 1.0))
    image = frame.image.copy()
    edges = done.cut_edges
    ends = original.buffers["positions"][edges] if len(edges) else np.zeros((0, 2, 3))
    _draw_edges(image, frame.depth, ends, camera)
    return image


def _colored(original: Asset, done: Repaired) -> Asset:
    """Return a mesh of all faces there were or are, coloured by what became of them."""
    faces, points = original.buffers["indices"], original.buffers["positions"]
    gone = np.ones(len(faces), bool)
    gone[done.face_map[done.face_map != NONE]] = False
    colors = np.repeat(_grey(original)[:, None], 3, axis=1)
    colors[gone] = RED
    new = done.asset.buffers["indices"][done.face_map == NONE]
    colors = np.concatenate([colors, np.tile(GREEN, (len(new), 1))])
    return build_asset(
        {
            "positions": np.concatenate([points, done.asset.buffers["positions"]]),
            "indices": np.concatenate([faces, new + np.uint32(len(points))]),
            "color": colors.astype(np.float32),
        },
        {"color": "face"},
    )


def _grey(asset: Asset) -> NDArray[np.float32]:
    """Return the brightness (F,) of each face's static colour, squeezed into the lighter half."""
    colors = drawn_colors(asset)
    light = as_floats(colors.values[:, :3]).mean(axis=1)
    if colors.domain == "vertex":
        light = light[asset.buffers["indices"]].mean(axis=1)
    elif colors.domain == "corner":
        light = light.reshape(-1, 3).mean(axis=1)
    return np.asarray(_DARKEST + (_LIGHTEST - _DARKEST) * light, np.float32)


def _draw_edges(
    image: NDArray[np.float32], depth: NDArray[np.float32], ends: NDArray[Any], camera: Camera
) -> None:
    """Draw the (n, 2, 3) edges into `image` where nothing hides them, a sample for each pixel along them."""
    pixels, _ = camera.project(ends)
    length = np.abs(pixels[:, 1] - pixels[:, 0]).max(axis=1, initial=0.0)
    good = np.isfinite(length) & (length < 4 * max(image.shape))  # no end beside or behind the camera
    samples = np.where(good, np.ceil(np.where(good, length, 0)) + 1, 0).astype(np.int64)
    edge = np.repeat(np.arange(len(ends)), samples)
    first = np.cumsum(samples) - samples
    along = ((np.arange(len(edge)) - first[edge]) / np.maximum(samples[edge] - 1, 1))[:, None]
    places, far = camera.project(ends[edge, 0] * (1 - along) + ends[edge, 1] * along)
    with np.errstate(invalid="ignore"):
        column, row = np.floor(np.nan_to_num(places, nan=-1.0)).astype(np.int64).T
    inside = (column >= 0) & (column < image.shape[1]) & (row >= 0) & (row < image.shape[0])
    row, column, far = row[inside], column[inside], far[inside]
    seen = depth[row, column]
    shown = (seen > 0) & (far <= seen * (1 + _NEAR))
    image[row[shown], column[shown]] = CUT

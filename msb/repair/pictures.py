"""Images of a repair: removed faces in red, added faces in green, and cut edges as blue lines."""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset, Description, build_asset
from msb.asset.look import drawn_colors
from msb.asset.origin import world_positions
from msb.meshes.colors import as_floats
from msb.render import Renderer
from msb.render.images import write_image
from msb.repair.assets import Repaired
from msb.scenes import Camera
from msb.topology.halfedge import NONE

RED, GREEN, CUT = (0.85, 0.1, 0.1), (0.1, 0.7, 0.2), (0.0, 0.0, 0.55)
# Grey levels of black and of white faces. Light grey levels contrast with the other colours.
_DARKEST, _LIGHTEST = 0.55, 0.9
# Depth tolerance for drawing cut edges, as a fraction of the surface depth. Cut edges lie on the surface, so
# their depths are nearly equal to the surface depth.
_TOLERANCE = 0.004


def save_picture(
    folder: Path, name: str, original: Asset, done: Repaired, camera: Camera, device: str | None = None
) -> str:
    """Write the image of a repair into `folder`, and return its file name.

    The file name is derived from `name`.
    """
    file = f"{re.sub('[^a-z]+', '-', name)}.png"
    write_image(folder / file, draw_picture(original, done, camera, device), "png")
    return file


def draw_picture(
    original: Asset, done: Repaired, camera: Camera, device: str | None = None
) -> NDArray[np.float32]:
    """Return an image (H, W, 3) with unchanged faces in grey, removed faces in red, and added faces in
    green."""
    with Renderer(_color_faces(original, done), tier="standard", device=device) as renderer:
        frame = renderer.render(camera, background=(1.0, 1.0, 1.0))
    image = frame.image.copy()
    edges = done.cut_edges
    ends = world_positions(original)[edges] if len(edges) else np.zeros((0, 2, 3))
    _draw_edges(image, frame.depth, ends, camera)
    return image


def _color_faces(original: Asset, done: Repaired) -> Asset:
    """Return an asset with all faces from before and after the repair.

    Unchanged, removed and added faces have different colours.
    """
    faces, points = original.buffers["indices"], original.buffers["positions"]
    # Colour the original faces (F, 3). A face without a counterpart in the result is red.
    is_removed = np.ones(len(faces), bool)
    is_removed[done.face_map[done.face_map != NONE]] = False
    colors = np.repeat(_compute_grey(original)[:, None], 3, axis=1)
    colors[is_removed] = RED
    # Append the added faces.
    new = done.asset.buffers["indices"][done.face_map == NONE]
    colors = np.concatenate([colors, np.tile(GREEN, (len(new), 1))])
    return build_asset(
        {
            "positions": np.concatenate([points, done.asset.buffers["positions"]]),
            "indices": np.concatenate([faces, new + np.uint32(len(points))]),
            "color": colors.astype(np.float32),
        },
        {"color": "face"},
        Description(origin=original.manifest.origin),
    )


def _compute_grey(asset: Asset) -> NDArray[np.float32]:
    """Return the brightness (F,) of each face's static colour, mapped to light grey levels."""
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
    """Draw the visible parts of the edges `ends` (n, 2, 3) into `image` (H, W, 3), in place.

    The argument `depth` (H, W) is the depth of the visible surface, 0 in the background.
    """
    # Compute the length of each edge in pixels (n,). Skip an edge if one end is behind the camera or in the
    # camera plane.
    pixels, _ = camera.project(ends)
    length = np.abs(pixels[:, 1] - pixels[:, 0]).max(axis=1, initial=0.0)
    is_valid = np.isfinite(length) & (length < 4 * max(image.shape))
    samples = np.where(is_valid, np.ceil(np.where(is_valid, length, 0)) + 1, 0).astype(np.int64)
    # Sample one point per pixel of length. For each of m samples, store its edge, and its position along the
    # edge from 0 to 1.
    edge = np.repeat(np.arange(len(ends)), samples)
    first = np.cumsum(samples) - samples
    along = ((np.arange(len(edge)) - first[edge]) / np.maximum(samples[edge] - 1, 1))[:, None]
    # Project the samples (m, 3) to pixels, and keep samples inside the image.
    places, sample_depth = camera.project(ends[edge, 0] * (1 - along) + ends[edge, 1] * along)
    with np.errstate(invalid="ignore"):
        column, row = np.floor(np.nan_to_num(places, nan=-1.0)).astype(np.int64).T
    inside = (column >= 0) & (column < image.shape[1]) & (row >= 0) & (row < image.shape[0])
    row, column, sample_depth = row[inside], column[inside], sample_depth[inside]
    # Draw the samples that are on or in front of the visible surface.
    surface = depth[row, column]
    visible = (surface > 0) & (sample_depth <= surface * (1 + _TOLERANCE))
    image[row[visible], column[visible]] = CUT

"""Temporal stability of the frames of a camera path: popping, shimmer and holes.

Image content moves as the camera moves. Depths and cameras predict this motion. Flicker is the change of the
image that this motion does not explain. Triangles pop when their blending order changes, and an image
shimmers if it has too few samples per pixel. Full definitions are in docs/protocol.md.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msb.scenes import Camera

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Standard deviation in pixels of the Gaussian that smooths images before comparison. After smoothing, cubic
# splines between pixels are accurate to a fraction of 1/255.
BLUR = 1.5
# Radius in pixels within which a neighbouring surface affects a smoothed pixel.
REACH = 3
# Maximum relative difference between the depths of one surface point in two frames.
SAME = 0.02
# A pixel is near a border if the depth of a pixel within `REACH` differs from its depth by more than this
# fraction.
_FLAT = 0.05


@dataclass(frozen=True, eq=False)
class PreparedFrame:
    """A frame prepared for comparison with the previous and the next frame.

    Attributes
    ----------
    camera : Camera
    smooth : (H, W, 3) float32
        The smoothed image in levels, 0 to 255.
    splines : (3, H, W) float32
        Coefficients of the image's cubic splines.
    inverse_depths : (3, H, W) float32
        Inverse depths of three surfaces: at the pixel itself, and the nearest and the farthest within
        `REACH`. For background pixels, where alpha is below 1/2, the value is 0.
    """

    camera: Camera
    smooth: Floats
    splines: Floats
    inverse_depths: Floats

    @property
    def covered(self) -> Mask:
        """The mask (H, W) of pixels that show the model."""
        return np.asarray(self.inverse_depths[0] > 0)


def prepare_frame(camera: Camera, image: Floats, alpha: Floats, depth: Floats) -> PreparedFrame:
    """Return a prepared frame from a camera and the image, alpha and depth of a `Frame`."""
    from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter, spline_filter

    levels = 255 * np.clip(image, 0, 1).astype(np.float32)
    smooth = gaussian_filter(levels, (BLUR, BLUR, 0), mode="nearest", truncate=3.0)
    splines = [spline_filter(smooth[..., k], 3, output=np.float32, mode="nearest") for k in range(3)]
    covered = (alpha >= 0.5) & (depth > 0)
    inverse = np.where(covered, 1 / np.where(covered, depth, 1), 0).astype(np.float32)
    side = 2 * REACH + 1
    around = maximum_filter(inverse, side, mode="nearest"), minimum_filter(inverse, side, mode="nearest")
    return PreparedFrame(camera, smooth, np.stack(splines), np.stack([inverse, *around]))


def unexplained_change(before: PreparedFrame, here: PreparedFrame, after: PreparedFrame) -> Floats:
    """For each pixel, return the difference from the average of its surface point in both adjacent frames.

    Returns
    -------
    (H, W) float32
        Root mean square over red, green and blue of the difference in levels of 255. The difference is NaN if
        no pixel of the model is within `REACH`. The difference is also NaN if the surface point is hidden or
        outside the image in an adjacent frame.

    Notes
    -----
    For a steady change, such as a view-dependent colour, the difference is 0, because the frame equals the
    average of its neighbours. A pixel near a border shows two surfaces that move differently. Each pixel is
    therefore followed with three depths: its own depth, and the nearest and farthest depth within `REACH`.
    The result is the smallest of the differences.
    """
    inverse, nearest, farthest = here.inverse_depths
    # Find the N pixels within `REACH` of the model, and whether each pixel is near a border between surfaces.
    rows, columns = np.nonzero(nearest > 0)
    colors = here.smooth[rows, columns].T
    least = np.full(len(rows), np.inf)
    counted = np.ones(len(rows), bool)
    border = (nearest - farthest > SAME * nearest)[rows, columns]
    for layer, inverse_depths in enumerate((inverse, nearest, farthest)):
        # Take the depths of one of the three surfaces. Project the pixels with these depths into both
        # adjacent frames. `same` marks pixels whose surface is visible in both frames.
        same = np.ones(len(rows), bool)
        places = []
        for other in (before, after):
            place, expected = _project_into(here, other.camera, rows, columns, inverse_depths[rows, columns])
            same &= _test_depths(other.inverse_depths[layer], place, expected)
            places.append(place)
        counted &= same | (layer == 0)
        followed = np.flatnonzero(same & (border | (layer == 0)))  # omit pixels that show only one surface
        both = [
            _sample_colors(other, place[:, followed])
            for other, place in zip((before, after), places, strict=True)
        ]
        # Compute the difference from the average of the two adjacent frames. Keep the smallest difference of
        # all layers.
        squares = np.square(colors[:, followed] - (both[0] + both[1]) / 2).mean(axis=0)
        least[followed] = np.minimum(least[followed], squares)
    change = np.full(inverse.shape, np.nan, np.float32)
    change[rows, columns] = np.where(counted & np.isfinite(least), np.sqrt(least), np.nan)
    return change


def _sample_colors(frame: PreparedFrame, place: NDArray[np.float64]) -> Floats:
    """Return the smoothed colours (3, N) at positions (2, N)."""
    from scipy.ndimage import map_coordinates

    channels = (
        map_coordinates(spline, place, order=3, mode="nearest", prefilter=False) for spline in frame.splines
    )
    return np.stack(list(channels))


def _project_into(
    here: PreparedFrame, camera: Camera, rows: NDArray[np.int_], columns: NDArray[np.int_], inverse: Floats
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Project the surface points of N pixels into another camera. Return positions (2, N) and inverse depths.

    Positions are (row, column). Pixel centres have integer positions. Points behind the camera get positions
    far outside the image, so NaN does not occur.
    """
    rays, move = (
        _compute_rays(here.camera, rows, columns),
        camera.world_to_camera @ here.camera.camera_to_world,
    )
    # Inverse depths also project background pixels, whose inverse depth is 0.
    x, y, z = move[:3, :3] @ rays + move[:3, 3:] * inverse
    ahead = np.where(z > 1e-6, z, 1e-6)
    place = np.stack([y / ahead * camera.fy + camera.cy - 0.5, x / ahead * camera.fx + camera.cx - 0.5])
    return place, np.where(z > 1e-6, inverse / ahead, np.inf)


def _compute_rays(camera: Camera, rows: NDArray[np.int_], columns: NDArray[np.int_]) -> NDArray[np.float64]:
    """Return rays (3, N) through the centres of N pixels, with z = 1 in camera space."""
    x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    return np.stack([x, y, np.ones(len(rows))])


def _test_depths(
    inverse_depths: Floats, place: NDArray[np.float64], expected: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return a mask (N,) of the positions (2, N) that lie inside the image and have the expected depth."""
    ends = np.array(inverse_depths.shape)[:, None] - 1
    inside = ((place >= REACH) & (place <= ends - REACH)).all(axis=0)
    row, column = np.clip(np.rint(place), 0, ends).astype(np.int64)
    return np.asarray(inside & (np.abs(inverse_depths[row, column] - expected) <= SAME * expected))


def find_surface_points(frame: PreparedFrame) -> NDArray[np.float64]:
    """Return world points (N, 3) on the surfaces of a frame, away from their borders.

    The result contains every second pixel of every second row. `find_holes` fills the pixels in between.
    """
    inverse, nearest, farthest = frame.inverse_depths
    inner = (farthest > 0) & (nearest - farthest <= _FLAT * nearest)
    rows, columns = 2 * np.array(np.nonzero(inner[::2, ::2]))
    local, pose = _compute_rays(frame.camera, rows, columns), frame.camera.camera_to_world
    return np.asarray((pose[:3, :3] @ (local / inverse[rows, columns]) + pose[:3, 3:]).T)


def find_holes(frame: PreparedFrame, points: NDArray[np.float64]) -> Mask:
    """Return the mask (H, W) of background pixels that the model should cover.

    `points` (N, 3) are surface points of other frames. Two kinds of pixels with alpha below 1/2 are holes:

    - Gaps: in the 5 x 5 square around a gap pixel, every pixel is at most one pixel away from the model or
      from a projected surface point.
    - Specks: a region of background that the model encloses, with at most (2 `REACH` + 1)^2 pixels.
    """
    from scipy.ndimage import label, maximum_filter, minimum_filter

    covered = frame.covered
    if covered.all():
        return ~covered
    hit = covered.copy()
    # Mark pixels that show the model or a surface point of another frame.
    pixels, depth = frame.camera.project(points)
    column, row = np.floor(np.where(depth[:, None] > 0, pixels, -1)).T
    height, width = covered.shape
    within = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    hit[row[within].astype(np.int64), column[within].astype(np.int64)] = True
    # The added border connects background regions at the image edge, so that they are not enclosed.
    regions, count = label(np.pad(~covered, 1, constant_values=True))
    sizes = np.bincount(regions.ravel(), minlength=count + 1)
    specks = (sizes <= (2 * REACH + 1) ** 2)[regions[1:-1, 1:-1]]
    dilated = maximum_filter(hit, 3, mode="constant", cval=False)
    # Nothing is known about pixels beyond the image edge. Treat these pixels as not hit.
    around = minimum_filter(dilated, 5, mode="constant", cval=False)
    return np.asarray(~covered & (specks | around))

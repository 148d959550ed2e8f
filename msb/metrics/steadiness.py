"""How steady the frames of a flight are: popping, shimmer and holes.

What is seen moves in a picture as the camera does. Depth and cameras say how, so the change that they do not
explain can be told: triangles that change places in the order of blending pop, too few samples shimmer.
docs/protocol.md has the definitions in full.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msb.scenes import Camera

Floats = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Standard deviation in pixels of the Gaussian that pictures are smoothed by before they are compared: the
# cubic spline between their pixels is then exact to a fraction of a level.
BLUR = 1.5
# Pixels within which another surface may show in a smoothed pixel.
REACH = 3
# A surface is the same one in two frames if its depths differ by no more than this share.
SAME = 0.02
# Within `REACH`, depths of a surface away from any border differ by no more than this share.
_FLAT = 0.05


@dataclass(frozen=True, eq=False)
class Still:
    """A frame made ready to be held against those before and after it.

    Attributes
    ----------
    camera : Camera
    smooth : (H, W, 3) float32
        The smoothed picture in levels, 0 to 255.
    splines : (3, H, W) float32
        The coefficients of the cubic splines through it.
    inverse_depths : (3, H, W) float32
        Of the pixel itself, and of the nearest and the farthest surface within `REACH`; 0 of the background,
        which is what alpha below 1/2 shows.
    """

    camera: Camera
    smooth: Floats
    splines: Floats
    inverse_depths: Floats

    @property
    def covered(self) -> Mask:
        """The pixels that show the model, (H, W)."""
        return np.asarray(self.inverse_depths[0] > 0)


def still(camera: Camera, image: Floats, alpha: Floats, depth: Floats) -> Still:
    """Return a frame made ready; the arguments are a camera and what `Frame` holds."""
    from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter, spline_filter

    levels = 255 * np.clip(image, 0, 1).astype(np.float32)
    smooth = gaussian_filter(levels, (BLUR, BLUR, 0), mode="nearest", truncate=3.0)
    splines = [spline_filter(smooth[..., k], 3, output=np.float32, mode="nearest") for k in range(3)]
    seen = (alpha >= 0.5) & (depth > 0)
    own = np.where(seen, 1 / np.where(seen, depth, 1), 0).astype(np.float32)
    side = 2 * REACH + 1
    near_by = maximum_filter(own, side, mode="nearest"), minimum_filter(own, side, mode="nearest")
    return Still(camera, smooth, np.stack(splines), np.stack([own, *near_by]))


def unexplained_change(before: Still, here: Still, after: Still) -> Floats:
    """Return how far each pixel is from the mean of the same surface points a frame before and after.

    Returns
    -------
    (H, W) float32
        The root mean square over red, green and blue of the difference in levels of 255. NaN where the model
        is not within `REACH`, and where what is seen was hidden or outside of the picture before or after.

    Notes
    -----
    Even change, such as that of a colour that depends on the view, is the mean of both sides and so no
    change. A pixel near a border shows two surfaces that move differently: it is followed as its own, as the
    nearest and as the farthest surface within `REACH`, and the least difference counts.
    """
    own, nearest, farthest = here.inverse_depths
    rows, columns = np.nonzero(nearest > 0)
    colors = here.smooth[rows, columns].T
    least = np.full(len(rows), np.inf)
    counted = np.ones(len(rows), bool)
    border = (nearest - farthest > SAME * nearest)[rows, columns]
    for layer, inverse_depths in enumerate((own, nearest, farthest)):
        same = np.ones(len(rows), bool)
        places = []
        for other in (before, after):
            place, expected = _seen_from(here, other.camera, rows, columns, inverse_depths[rows, columns])
            same &= _shows(other.inverse_depths[layer], place, expected)
            places.append(place)
        counted &= same | (layer == 0)
        followed = np.flatnonzero(same & (border | (layer == 0)))  # elsewhere all three are one surface
        both = [
            _sampled(other, place[:, followed]) for other, place in zip((before, after), places, strict=True)
        ]
        squares = np.square(colors[:, followed] - (both[0] + both[1]) / 2).mean(axis=0)
        least[followed] = np.minimum(least[followed], squares)
    change = np.full(own.shape, np.nan, np.float32)
    change[rows, columns] = np.where(counted & np.isfinite(least), np.sqrt(least), np.nan)
    return change


def _sampled(one: Still, place: NDArray[np.float64]) -> Floats:
    """Return the smoothed colours (3, N) at N places."""
    from scipy.ndimage import map_coordinates

    channels = (
        map_coordinates(spline, place, order=3, mode="nearest", prefilter=False) for spline in one.splines
    )
    return np.stack(list(channels))


def _seen_from(
    here: Still, camera: Camera, rows: NDArray[np.int_], columns: NDArray[np.int_], inverse: Floats
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where another camera sees what N pixels show: (2, N) rows and columns, and its inverse depths.

    Pixel centres are whole numbers. NaN does not occur: what is behind the camera is far outside.
    """
    rays, move = _rays(here.camera, rows, columns), camera.world_to_camera @ here.camera.camera_to_world
    # Divided by the depth, the background is a point at infinity like any other.
    x, y, z = move[:3, :3] @ rays + move[:3, 3:] * inverse
    ahead = np.where(z > 1e-6, z, 1e-6)
    place = np.stack([y / ahead * camera.fy + camera.cy - 0.5, x / ahead * camera.fx + camera.cx - 0.5])
    return place, np.where(z > 1e-6, inverse / ahead, np.inf)


def _rays(camera: Camera, rows: NDArray[np.int_], columns: NDArray[np.int_]) -> NDArray[np.float64]:
    """Return the rays (3, N) through the centres of N pixels, with z = 1 in camera space."""
    x, y = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    return np.stack([x, y, np.ones(len(rows))])


def _shows(
    inverse_depths: Floats, place: NDArray[np.float64], expected: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return at which of N places, well within the picture, a frame shows a surface of the depth expected."""
    ends = np.array(inverse_depths.shape)[:, None] - 1
    inside = ((place >= REACH) & (place <= ends - REACH)).all(axis=0)
    row, column = np.clip(np.rint(place), 0, ends).astype(np.int64)
    return np.asarray(inside & (np.abs(inverse_depths[row, column] - expected) <= SAME * expected))


def surface_points(one: Still) -> NDArray[np.float64]:
    """Return the points (N, 3) of the world that a frame shows away from the borders of its surfaces.

    They are those of every second pixel of every second row: `holes` fills the places between.
    """
    own, nearest, farthest = one.inverse_depths
    inner = (farthest > 0) & (nearest - farthest <= _FLAT * nearest)
    rows, columns = 2 * np.array(np.nonzero(inner[::2, ::2]))
    local, pose = _rays(one.camera, rows, columns), one.camera.camera_to_world
    return np.asarray((pose[:3, :3] @ (local / own[rows, columns]) + pose[:3, 3:]).T)


def holes(one: Still, points: NDArray[np.float64]) -> Mask:
    """Return the pixels (H, W) through which the background shows where the model should be.

    These show background (alpha below 1/2) although a point of the model's surface that other frames show,
    one of `points` (N, 3), is on the pixel's ray, and on or beside those of all pixels around it; or they are
    specks: regions that pixels of the model enclose, no larger than a square of 2 `REACH` + 1 pixels.
    """
    from scipy.ndimage import label, maximum_filter, minimum_filter

    covered = one.covered
    if covered.all():
        return ~covered
    shown = covered.copy()
    pixels, depth = one.camera.project(points)
    column, row = np.floor(np.where(depth[:, None] > 0, pixels, -1)).T
    height, width = covered.shape
    within = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    shown[row[within].astype(np.int64), column[within].astype(np.int64)] = True
    # The border around lets what is cut off by the picture's edge be one with what is outside.
    regions, count = label(np.pad(~covered, 1, constant_values=True))
    sizes = np.bincount(regions.ravel(), minlength=count + 1)
    specks = (sizes <= (2 * REACH + 1) ** 2)[regions[1:-1, 1:-1]]
    near_by = maximum_filter(shown, 3, mode="constant", cval=False)
    # What lies beyond the picture's edge is not known, and so not shown.
    around = minimum_filter(near_by, 5, mode="constant", cval=False)
    return np.asarray(~covered & (specks | around))

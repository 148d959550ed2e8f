"""Pairs of a triangle and a pixel that it may colour, in front-to-back order per pixel.

The pixels of a triangle are inside three half-planes and inside its tiles. Pairs are listed by triangle, the
nearest triangle first. Therefore a sum over a triangle is a sum over a run of the list. Blending needs the
order within each pixel. `Ranks` lists the same pairs by rank: first the front pair of every pixel, then the
second pair of every pixel, and so on. Pixels with the longest lists come first, so each rank is a slice.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from msb.reference.tiles import Rectangles

TILE = 16
_MARGIN = 1e-3
"""Margin of a row in pixels. Pairs outside of the triangle get weight 0 later."""


@dataclass(frozen=True, eq=False)
class Pairs:
    """P pairs of G triangles and a raster of `width` x `height` samples.

    `faces` (G,) are the triangles with pairs, in drawing order; `starts` and `counts` (G,) delimit their
    pairs. `x`, `y` (P,) are columns and rows of samples, and `pixel` is y width + x. If `key` is given
    (values from 1 to 4), it orders the pairs of a pixel; pairs with equal keys are ordered by index.
    """

    width: int
    height: int
    faces: NDArray[np.int64]
    starts: NDArray[np.int64]
    counts: NDArray[np.int64]
    x: NDArray[Any]
    y: NDArray[Any]
    pixel: NDArray[np.int32]
    key: NDArray[np.float32] | None = None

    @property
    def dtype(self) -> Any:
        """The dtype of all values per pair."""
        return self.x.dtype

    def spread(self, values: NDArray[Any]) -> NDArray[Any]:
        """Expand values per triangle (G,) to pairs (P,)."""
        return np.repeat(values.astype(self.dtype), self.counts)

    def total(self, values: NDArray[Any]) -> NDArray[Any]:
        """Sum values per pair (P,) over each triangle, (G,)."""
        return np.add.reduceat(values, self.starts) if len(self.starts) else np.zeros(0, self.dtype)

    def highest(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the maximum of values per pair (P,) over each triangle, (G,)."""
        return np.maximum.reduceat(values, self.starts) if len(self.starts) else np.zeros(0, self.dtype)

    @cached_property
    def ranks(self) -> Ranks:
        """The pairs by rank."""
        return Ranks.of(self.pixel, self.key)

    def only(self, kept: NDArray[np.bool_], key: NDArray[np.float32] | None = None) -> Pairs:
        """Return the pairs selected by `kept` (P,), ordered by `key` (P,) if it is given."""
        counts = np.add.reduceat(kept, self.starts, dtype=np.int64) if len(self.starts) else self.counts
        some = counts > 0
        counts = counts[some]
        return replace(
            self,
            faces=self.faces[some],
            starts=np.cumsum(counts) - counts,
            counts=counts,
            x=self.x[kept],
            y=self.y[kept],
            pixel=self.pixel[kept],
            key=None if key is None else key[kept],
        )


@dataclass(frozen=True, eq=False)
class Ranks:
    """All P pairs, sorted by rank.

    Fields are the index of each pair in `Pairs`, the pixels (Q,), and the number of pairs of each rank.

    Pixels with the longest lists come first.
    """

    pair: NDArray[np.int64]
    pixels: NDArray[np.int64]
    sizes: list[int]

    @classmethod
    def of(cls, pixel: NDArray[np.int32], key: NDArray[np.float32] | None = None) -> Ranks:
        """Return the order of pairs with pixel indices `pixel`; see `Pairs.key`."""
        # Sorting unique numbers is several times as fast as a stable sort of the pixels.
        bits = max(len(pixel) - 1, 1).bit_length()
        by_pixel = pixel.astype(np.int64)
        if key is not None:
            by_pixel = (by_pixel << 24) | (key.view(np.int32) - np.float32(1).view(np.int32))
        by_pixel = (by_pixel << bits) | np.arange(len(pixel))
        by_pixel.sort()
        by_pixel &= (1 << bits) - 1
        lengths = np.bincount(pixel)
        # NumPy sorts 16-bit numbers by radix sort, which is several times as fast.
        short = -lengths.astype(np.int16) if lengths.max(initial=0) < 1 << 15 else -lengths
        pixels = np.argsort(short, kind="stable")[: np.count_nonzero(lengths)]
        starts = (np.cumsum(lengths) - lengths)[pixels]
        at_least = np.cumsum(np.bincount(lengths)[::-1])[::-1]
        sizes = at_least[1:].tolist()
        pair = np.zeros(len(pixel), np.int64)
        done = 0
        for rank, size in enumerate(sizes):
            by_pixel.take(starts[:size] + rank, out=pair[done : done + size], mode="clip")
            done += size
        return cls(pair, pixels, sizes)

    def slices(self) -> Iterator[tuple[slice, int]]:
        """Yield the slice of each rank, and its number of pixels."""
        done = 0
        for size in self.sizes:
            yield slice(done, done + size), size
            done += size

    def by_rank(self, values: NDArray[Any]) -> NDArray[Any]:
        """Expand values per pixel (Q,), in the order of `pixels`, to pairs (P,)."""
        return (
            np.concatenate([values[:size] for size in self.sizes])
            if self.sizes
            else np.zeros(0, values.dtype)
        )

    def add_up(self, values: NDArray[Any]) -> NDArray[Any]:
        """Sum values per pair (P,) over each pixel, (Q,)."""
        found = np.zeros(len(self.pixels), values.dtype)
        for part, size in self.slices():
            found[:size] += values[part]
        return found

    def to_faces(self, values: NDArray[Any]) -> NDArray[Any]:
        """Reorder values (P,) from rank order to the order of `Pairs`."""
        found = np.zeros_like(values)
        found[self.pair] = values
        return found


Box = tuple["NDArray[np.int64]", "NDArray[np.int64]"]


def tile_box(rectangles: Rectangles, width: int, height: int) -> Box:
    """Return the first and last samples of triangles' tiles, for `make_pairs`."""
    limit = np.array([width, height])
    return np.minimum(rectangles.low * TILE, limit), np.minimum(rectangles.high * TILE, limit) - 1


def make_pairs(
    faces: NDArray[np.int64],
    planes: NDArray[np.float64],
    box: Box,
    width: int,
    height: int,
    dtype: Any,
) -> Pairs:
    """Return the pairs of `faces` (K,), given in drawing order, and the samples inside them.

    A sample is inside if a x + b y + c >= 0 for all three rows (a, b, c) of `planes` (F, 3, 3). The
    half-planes may be slightly too wide, never too narrow. `box` (F, 2) holds the first and last samples of
    each triangle.
    """
    planes = planes[faces]
    first, last = box[0][faces], box[1][faces]
    with np.errstate(all="ignore"):
        rows = _heights(planes)
    # If two edges are parallel, the result is NaN, and all rows of the box are used.
    low = np.fmax(first[:, 1], np.floor(rows[0]) - 1)
    high = np.fmin(last[:, 1], np.ceil(rows[1]) + 1)
    rows_of = np.maximum(high - low + 1, 0).astype(np.int64)
    number = np.repeat(np.arange(len(faces)), rows_of)
    y = np.arange(len(number)) - np.repeat(np.cumsum(rows_of) - rows_of - low.astype(np.int64), rows_of)
    left, right = first[number, 0].astype(float), last[number, 0].astype(float)
    with np.errstate(all="ignore"):
        for edge in range(3):
            slope = planes[number, edge, 0]
            base = planes[number, edge, 1] * y + planes[number, edge, 2]
            end = -base / slope
            np.fmax(left, end - _MARGIN, out=left, where=slope > 0)
            np.fmin(right, end + _MARGIN, out=right, where=slope < 0)
            right[(slope == 0) & ~(base >= -_MARGIN)] = -1
    left, right = np.ceil(left).astype(np.int64), np.floor(right).astype(np.int64)
    lengths = np.maximum(right - left + 1, 0)
    columns = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths - left, lengths)
    lines = np.repeat(y, lengths)
    counts = np.bincount(number, weights=lengths, minlength=len(faces)).astype(np.int64)
    some = counts > 0
    counts = counts[some]
    return Pairs(
        width=width,
        height=height,
        faces=faces[some],
        starts=np.cumsum(counts) - counts,
        counts=counts,
        x=columns.astype(dtype),
        y=lines.astype(dtype),
        pixel=(lines * width + columns).astype(np.int32),
    )


def _heights(planes: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the smallest and largest y of the triangle enclosed by three half-planes."""
    corners = []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        (a, b, c), (d, e, f) = planes[:, i].T, planes[:, j].T
        corners.append((c * d - a * f) / (a * e - b * d))
    return np.minimum.reduce(corners), np.maximum.reduce(corners)


def front_to_back(depth: NDArray[Any], kept: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the indices of kept triangles in the official order: by float32 depth, then by index."""
    faces = np.flatnonzero(kept)
    return faces[np.argsort(depth[faces].astype(np.float32), kind="stable")]

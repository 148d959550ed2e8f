"""Tiles of 16 x 16 samples: which faces each tile lists, front to back."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.reference.arithmetic import Reals
from msb.reference.camera_matrices import SplattingCamera
from msb.registry import Order, Sampling

TILE = 16

Integers = NDArray[Any]


@dataclass(frozen=True)
class Rectangles:
    """Of each of F faces the tiles [low, high) it is listed in; both (F, 2) integers, x and y."""

    low: Integers
    high: Integers

    @property
    def empty(self) -> NDArray[np.bool_]:
        """Where the product of both extents is 0, which is what the official kernels test."""
        return np.asarray((self.high - self.low).prod(axis=1) == 0)


@dataclass(frozen=True)
class Tile:
    """P samples and the K faces listed for them, front to back.

    `columns` and `rows` are (P,) integers, `faces` is (K,).
    """

    columns: Integers
    rows: Integers
    faces: Integers


def grid_size(width: int, height: int) -> Integers:
    """Return the number of tiles in x and y, (2,)."""
    return np.array([-(-width // TILE), -(-height // TILE)])


def tile_number(value: Reals, limit: Integers) -> Integers:
    """Return `value` (..., 2) truncated to an integer within 0 and `limit` (2,).

    A GPU's conversion from float saturates, and NaN gives 0.
    """
    return np.asarray(np.clip(np.nan_to_num(np.trunc(value), nan=0), 0, limit).astype(np.int64))


def tiles_front_to_back(
    rectangles: Rectangles | None, depth: Reals, kept: NDArray[np.bool_], width: int, height: int
) -> Iterator[Tile]:
    """Yield every tile of the raster that lists a face, of the faces that are `kept`.

    Without `rectangles` every tile lists every face. The sort key `depth` is not negative; equal keys keep
    ascending face number. The official kernels sort (tile number << 32 | bits of the float32 depth) with a
    stable radix sort; for positive depths that is this order.
    """
    columns, tile_rows = grid_size(width, height).tolist()
    faces = np.flatnonzero(kept)
    faces = faces[np.argsort(depth[faces].astype(np.float32), kind="stable")]
    if rectangles is None:
        for tile in range(columns * tile_rows if len(faces) else 0):
            yield _tile(tile, columns, width, height, faces)
        return
    extent = np.maximum(rectangles.high - rectangles.low, 0)[faces]
    counts = extent.prod(axis=1)
    listed = np.repeat(np.arange(len(faces)), counts)
    within = np.arange(len(listed)) - np.repeat(np.cumsum(counts) - counts, counts)
    tile_x = rectangles.low[faces[listed], 0] + within % extent[listed, 0]
    tile_y = rectangles.low[faces[listed], 1] + within // extent[listed, 0]
    number = tile_y * columns + tile_x
    order = np.argsort(number, kind="stable")
    numbers, starts, sizes = np.unique(number[order], return_index=True, return_counts=True)
    for tile, start, size in zip(numbers.tolist(), starts.tolist(), sizes.tolist(), strict=True):
        yield _tile(tile, columns, width, height, faces[listed[order[start : start + size]]])


def _tile(number: int, columns: int, width: int, height: int, faces: Integers) -> Tile:
    x, y = TILE * (number % columns), TILE * (number // columns)
    columns_of_tile, rows = np.arange(x, min(x + TILE, width)), np.arange(y, min(y + TILE, height))
    return Tile(np.tile(columns_of_tile, len(rows)), np.repeat(rows, len(columns_of_tile)), faces)


@dataclass(frozen=True)
class Modes:
    """In which order and by which rules of sampling triangles are drawn; the defaults are official.

    "tile": by depth, and a triangle is seen in its official tiles alone. "global": by depth, and it is seen
    wherever it reaches. "none": likewise, in the order of the asset. With sampling "engine"
    (`msb.reference.engine`) a triangle reaches no farther than its edges, so that "tile" and "global" are the
    same.
    """

    order: Order = "tile"
    sampling: Sampling = "official"

    @property
    def engine(self) -> bool:
        """Whether triangles are sampled as graphics hardware does."""
        return self.sampling == "engine"

    def tiles(
        self, rectangles: Rectangles, depth: Reals, kept: NDArray[np.bool_], view: SplattingCamera
    ) -> Iterator[Tile]:
        """Yield the tiles of the view's raster with the faces each lists, in the order of drawing."""
        everywhere = self.order != "tile" and not self.engine
        key = np.zeros_like(depth) if self.order == "none" else depth
        return tiles_front_to_back(None if everywhere else rectangles, key, kept, view.width, view.height)

"""Tiles of 16 x 16 samples, and the faces that each tile lists from front to back."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.reference.arithmetic import Reals
from msb.reference.camera_matrices import SplattingCamera
from msb.registry import Order, Sampling

# Width and height of a tile in samples, as in the official kernels.
TILE = 16

Integers = NDArray[Any]


@dataclass(frozen=True)
class Rectangles:
    """For each of F faces, the rectangle [low, high) of tiles that list the face.

    `low` and `high` are (F, 2) integers, x and y.
    """

    low: Integers
    high: Integers

    @property
    def empty(self) -> NDArray[np.bool_]:
        """Whether a rectangle is empty by the official test: the product of its width and height is 0."""
        return np.asarray((self.high - self.low).prod(axis=1) == 0)


@dataclass(frozen=True)
class Tile:
    """The P samples of a tile, and the K faces listed for them from front to back.

    `columns` and `rows` are (P,) integers, `faces` is (K,).
    """

    columns: Integers
    rows: Integers
    faces: Integers


def grid_size(width: int, height: int) -> Integers:
    """Return the number of tiles in x and y, (2,)."""
    return np.array([-(-width // TILE), -(-height // TILE)])


def tile_number(value: Reals, limit: Integers) -> Integers:
    """Return `value` (..., 2) truncated to integers and clamped to [0, `limit`]. `limit` is (2,).

    As in a conversion on a GPU, large values saturate, and NaN becomes 0.
    """
    return np.asarray(np.clip(np.nan_to_num(np.trunc(value), nan=0), 0, limit).astype(np.int64))


def tiles_front_to_back(
    rectangles: Rectangles | None, depth: Reals, kept: NDArray[np.bool_], width: int, height: int
) -> Iterator[Tile]:
    """Yield every tile of the raster that lists at least one of the `kept` faces.

    Without `rectangles` every tile lists every face. The sort key `depth` must not be negative. Faces with
    equal keys keep ascending face numbers. The official kernels sort (tile number << 32 | bits of the float32
    depth) with a stable radix sort. For positive depths, a stable sort of the float32 depths gives the same
    order.
    """
    columns, tile_rows = grid_size(width, height).tolist()
    faces = np.flatnonzero(kept)
    faces = faces[np.argsort(depth[faces].astype(np.float32), kind="stable")]
    if rectangles is None:
        for tile in range(columns * tile_rows if len(faces) else 0):
            yield _tile(tile, columns, width, height, faces)
        return
    # Create one pair of (face, tile) for each tile of each rectangle; pairs stay sorted by depth.
    extent = np.maximum(rectangles.high - rectangles.low, 0)[faces]
    counts = extent.prod(axis=1)
    listed = np.repeat(np.arange(len(faces)), counts)
    within = np.arange(len(listed)) - np.repeat(np.cumsum(counts) - counts, counts)
    tile_x = rectangles.low[faces[listed], 0] + within % extent[listed, 0]
    tile_y = rectangles.low[faces[listed], 1] + within // extent[listed, 0]
    number = tile_y * columns + tile_x
    # A stable sort by tile keeps the depth order within each tile.
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
    """The drawing order and the sampling rules; the defaults follow the official code.

    With order "tile", triangles are sorted by depth, and each triangle is drawn only in its official tiles.
    With order "global" (by depth) or "none" (by index), triangles are drawn in every tile that they reach.
    With sampling "engine" (`msb.reference.engine`), the tiles of a triangle contain all of its samples, so
    "tile" and "global" give the same image.
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
        """Yield the tiles of the view's raster with their faces in drawing order."""
        everywhere = self.order != "tile" and not self.engine
        key = np.zeros_like(depth) if self.order == "none" else depth
        return tiles_front_to_back(None if everywhere else rectangles, key, kept, view.width, view.height)

"""Projected primitives -> depth order -> tile lists, all on the device.

The host reads two counts only: how many primitives are listed, and how many entries all lists have together,
which decides how much memory the lists need.
"""

from typing import NamedTuple

import numpy as np

from msb.cl import Buffer, Device, Program
from msb.cl.scan import MOST, chunks_of, exclusive_scan
from msb.cl.sort import sort_pairs
from msb.errors import DeviceError
from msb.registry import Order

# Number of faces, or samples of a row, that a work-item takes at once; PoCL crashes with 16
# (docs/opencl.md).
LANES = {"cpu": 8, "gpu": 1}
# Work-items of a group of the stages over faces.
WORK_GROUP = 64
# Places that a work-item of a CPU looks through for equal depths; a multiple of the lanes.
SETTLED = 1024


class Projected(NamedTuple):
    """The buffers that `project` writes for F faces. Each face that some tile lists has a place in them.

    `faces`, `keys` and `tiles` have for each place the record that blending reads, the depth, and the
    rectangle of tiles; a work-item's places begin at the row of its first face. `listed` counts the listed
    faces of each work-item, `visible` says of each row whether the official culling keeps its face.
    """

    faces: Buffer
    keys: Buffer
    tiles: Buffer
    listed: Buffer
    visible: Buffer


class TileLists(NamedTuple):
    """Tile t lists ``list[starts[t] : starts[t + 1]]``, places of faces from front to back.

    `starts` is uint64 (columns * rows + 1,), `list` is uint32.
    """

    starts: Buffer
    list: Buffer
    listed: int
    pairs: int


class DepthSort:
    """Puts places of listed faces in the order of blending: by depth, and by number at equal depth.

    The official sort is stable, hence the numbers; order "none" sorts by them alone. `by_rows` says whether
    faces lie in the order of their numbers, as they are stored, and not in drawing order
    (`msb.render.splat.order`).
    """

    def __init__(self, device: Device, program: Program, order: Order) -> None:
        self._device = device
        self._program = program
        self._by_number_alone = order == "none"
        self.by_rows = True

    def __call__(self, projected: Projected, depths: Buffer, places: Buffer) -> Buffer:
        """Return `places`, which are ascending, sorted by their `depths`. Both arrays are overwritten."""
        if self._by_number_alone:
            return places if self.by_rows else self._by_number(projected, depths, places)
        order = self._by_depth(depths, places)
        if self.by_rows or self._settle(projected, *order):
            return order[1]
        # Too many are equal, as in a plane that the camera faces: one stable sort after the other.
        places = self._by_number(projected, depths, places)
        arguments = places, projected.keys, depths, np.uint32(places.size)
        self._program.depths_of(places.size, WORK_GROUP, *arguments)
        return self._by_depth(depths, places)[1]

    def _by_depth(self, depths: Buffer, places: Buffer) -> tuple[Buffer, Buffer]:
        return sort_pairs(self._device, depths, places, name="splat depth sort")

    def _by_number(self, projected: Projected, keys: Buffer, places: Buffer) -> Buffer:
        """Return `places` sorted by the numbers of their faces, which are `keys` from here on."""
        count = places.size
        self._program.numbers_of(count, WORK_GROUP, places, projected.faces, keys, np.uint32(count))
        bits = (projected.visible.size - 1).bit_length()
        return sort_pairs(self._device, keys, places, bits=bits, name="splat number sort")[1]

    def _settle(self, projected: Projected, depths: Buffer, places: Buffer) -> bool:
        """Sort equal depths by number; return False where there are too many for that."""
        unsettled = self._device.scratch("splat unsettled", 1, np.uint32)
        unsettled.fill(0)
        arguments = depths, places, projected.faces, unsettled, np.uint32(places.size)
        if self._device.style == "cpu":
            self._program.settle_ties(-(-places.size // SETTLED), 1, *arguments, np.uint32(SETTLED))
        else:
            self._program.settle_ties(places.size, WORK_GROUP, *arguments)
        return not unsettled.read()[0]


def bin_faces(
    device: Device, projected: Projected, chunk: int, columns: int, rows: int, sort: DepthSort
) -> TileLists:
    """Queue depth order and tile lists of faces projected `chunk` a work-item; waits for the two counts."""
    program = device.program(f"splat_bins_{device.style}")
    items = projected.listed.size
    with device.stage("sort"):
        before = device.scratch("splat listed before", items + 1, np.uint32)
        exclusive_scan(device, projected.listed, before)
        listed = int(before.read(start=items)[0])
        keys = device.scratch("splat depth keys", listed, np.uint32)
        places = device.scratch("splat depth order", listed, np.uint32)
        group = 1 if device.style == "cpu" else WORK_GROUP
        sizes = np.uint32(items), np.uint32(chunk)
        program.compact(items, group, before, projected.keys, keys, places, *sizes)
        if listed:
            places = sort(projected, keys, places)
    with device.stage("bin"):
        make = _count_and_fill if device.style == "cpu" else _sort_by_tile
        return make(device, projected, places, listed, columns, columns * rows)


def _count_and_fill(
    device: Device, projected: Projected, order: Buffer, listed: int, columns: int, tiles: int
) -> TileLists:
    program = device.program(f"splat_bins_{device.style}")
    chunk, chunks = chunks_of(device, listed)
    counts = device.scratch("splat tile counts of chunks", (max(chunks, 1), tiles), np.uint32)
    totals = device.scratch("splat tile totals", tiles, np.uint32)
    starts = device.scratch("splat tile starts", tiles + 1, np.uint64)
    sizes = np.uint32(listed), np.uint32(chunk), np.uint32(columns), np.uint32(tiles)
    ordered = device.scratch("splat ordered tiles", (max(listed, 1), 4), np.uint16)
    program.count_tiles(chunks, 1, order, projected.tiles, ordered, counts, *sizes)
    program.sum_tiles(tiles, WORK_GROUP, counts, totals, np.uint32(chunks), np.uint32(tiles))
    exclusive_scan(device, totals, starts, tiles)
    pairs = int(starts.read(start=tiles)[0])
    lists = device.scratch("splat tile lists", max(pairs, 1), np.uint32)
    program.fill_tiles(chunks, 1, order, ordered, counts, starts, lists, *sizes)
    return TileLists(starts, lists, listed, pairs)


def _sort_by_tile(
    device: Device, projected: Projected, order: Buffer, listed: int, columns: int, tiles: int
) -> TileLists:
    program = device.program(f"splat_bins_{device.style}")
    counts = device.scratch("splat tiles of ordered faces", max(listed, 1), np.uint32)
    offsets = device.scratch("splat pair offsets", listed + 1, np.uint64)
    program.count_pairs(listed, WORK_GROUP, order, projected.tiles, counts, np.uint32(listed))
    exclusive_scan(device, counts, offsets, listed)
    pairs = int(offsets.read(start=listed)[0])
    if pairs > MOST:
        text = f"{pairs} pairs of tile and face are too many to sort ({MOST}): draw a smaller image"
        raise DeviceError("DEVICE_MEMORY", text)
    starts = device.scratch("splat tile starts", tiles + 1, np.uint64)
    pair_tiles = device.scratch("splat pair tiles", max(pairs, 1), np.uint32)
    places = device.scratch("splat pair places", max(pairs, 1), np.uint32)
    sizes = np.uint32(listed), np.uint32(columns)
    program.emit_pairs(listed, WORK_GROUP, order, projected.tiles, offsets, pair_tiles, places, *sizes)
    if pairs:
        bits = max(1, (tiles - 1).bit_length())
        pair_tiles, places = sort_pairs(
            device, pair_tiles, places, count=pairs, bits=bits, name="splat pair sort"
        )
    program.find_starts(pairs + 1, WORK_GROUP, pair_tiles, starts, np.uint32(pairs), np.uint32(tiles))
    return TileLists(starts, places, listed, pairs)

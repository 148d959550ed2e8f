"""From projected primitives to depth order and tile lists, entirely on the device.

The host reads only two numbers: the number of listed faces, and the total length of all lists. The total
length decides how much memory the lists need.
"""

from typing import NamedTuple

import numpy as np

from msb.cl import Buffer, Device, Program
from msb.cl.scan import MOST, chunks_of, exclusive_scan
from msb.cl.sort import sort_pairs
from msb.errors import DeviceError
from msb.registry import Order

# Number of faces, or of samples of a row, that one work-item processes at once (SIMD lanes). PoCL crashes
# with a value of 16 (docs/opencl.md).
LANES = {"cpu": 8, "gpu": 1}
# Work-items per work-group in the stages over faces.
WORK_GROUP = 64
# Number of list positions that one CPU work-item searches for equal depths; a multiple of the lanes.
SETTLED = 1024


class Projected(NamedTuple):
    """The buffers that the kernel `project` writes for F faces.

    A face is listed if its tile rectangle is not empty. A listed face has a position in three arrays: `faces`
    (the record for blending), `keys` (its depth) and `tiles` (its tile rectangle). The positions of a
    work-item begin at the row of its first face. `listed` counts the listed faces of each work-item.
    `visible` marks the rows whose faces pass the official culling.
    """

    faces: Buffer
    keys: Buffer
    tiles: Buffer
    listed: Buffer
    visible: Buffer


class TileLists(NamedTuple):
    """Tile t lists ``list[starts[t] : starts[t + 1]]``: positions of faces from front to back.

    `starts` is uint64 (columns * rows + 1,), `list` is uint32. `listed` is the number of listed faces,
    `pairs` the length of `list`.
    """

    starts: Buffer
    list: Buffer
    listed: int
    pairs: int


class DepthSort:
    """Sorts the positions of listed faces into blending order: by depth, and by face number at equal depth.

    The official sort is stable, so faces of equal depth keep the order of their numbers. With order "none"
    faces are sorted by number only. `by_rows` tells whether the rows on the device are ordered by face
    number, or sorted by `msb.render.splat.order`.
    """

    def __init__(self, device: Device, program: Program, order: Order) -> None:
        self._device = device
        self._program = program
        self._by_number_alone = order == "none"
        self.by_rows = True

    def __call__(self, projected: Projected, depths: Buffer, places: Buffer) -> Buffer:
        """Return the ascending list positions `places` sorted by their `depths`. The function overwrites
        both buffers."""
        if self._by_number_alone:
            return places if self.by_rows else self._by_number(projected, depths, places)
        order = self._by_depth(depths, places)
        if self.by_rows or self._settle(projected, *order):
            return order[1]
        # If too many depths are equal, sort by number first, then stably by depth. Depths are equal in a
        # plane parallel to the image.
        places = self._by_number(projected, depths, places)
        arguments = places, projected.keys, depths, np.uint32(places.size)
        self._program.depths_of(places.size, WORK_GROUP, *arguments)
        return self._by_depth(depths, places)[1]

    def _by_depth(self, depths: Buffer, places: Buffer) -> tuple[Buffer, Buffer]:
        return sort_pairs(self._device, depths, places, name="splat depth sort")

    def _by_number(self, projected: Projected, keys: Buffer, places: Buffer) -> Buffer:
        """Return `places` sorted by the numbers of their faces; the numbers overwrite `keys`."""
        count = places.size
        self._program.numbers_of(count, WORK_GROUP, places, projected.faces, keys, np.uint32(count))
        bits = (projected.visible.size - 1).bit_length()
        return sort_pairs(self._device, keys, places, bits=bits, name="splat number sort")[1]

    def _settle(self, projected: Projected, depths: Buffer, places: Buffer) -> bool:
        """Sort runs of equal depth in `places` by face number; return False if a run is too long for this
        method."""
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
    """Return the tile lists of projected faces in depth order. Each work-item projected `chunk` faces.

    The function waits for the device twice, to read two counts.
    """
    program = device.program(f"splat_bins_{device.style}")
    items = projected.listed.size
    with device.stage("sort"):
        before = device.scratch("splat listed before", items + 1, np.uint32)
        # The scan gives the first slot of each work-item in the compacted arrays.
        exclusive_scan(device, projected.listed, before)
        listed = int(before.read(start=items)[0])
        keys = device.scratch("splat depth keys", listed, np.uint32)
        places = device.scratch("splat depth order", listed, np.uint32)
        group = 1 if device.style == "cpu" else WORK_GROUP
        sizes = np.uint32(items), np.uint32(chunk)
        program.compact(items, group, before, projected.keys, keys, places, *sizes)
        # Compact the keys and positions, then bring the positions into blending order.
        if listed:
            places = sort(projected, keys, places)
    with device.stage("bin"):
        build = _count_and_fill if device.style == "cpu" else _sort_by_tile
        return build(device, projected, places, listed, columns, columns * rows)


def _count_and_fill(
    device: Device, projected: Projected, order: Buffer, listed: int, columns: int, tiles: int
) -> TileLists:
    """Build the lists by counting: each chunk of faces counts its entries per tile, then writes the
    entries."""
    program = device.program(f"splat_bins_{device.style}")
    chunk, chunks = chunks_of(device, listed)
    counts = device.scratch("splat tile counts of chunks", (max(chunks, 1), tiles), np.uint32)
    totals = device.scratch("splat tile totals", tiles, np.uint32)
    starts = device.scratch("splat tile starts", tiles + 1, np.uint64)
    sizes = np.uint32(listed), np.uint32(chunk), np.uint32(columns), np.uint32(tiles)
    ordered = device.scratch("splat ordered tiles", (max(listed, 1), 4), np.uint16)
    # Count the entries of each chunk in each tile. The sums of these counts give the start of each tile's
    # list.
    program.count_tiles(chunks, 1, order, projected.tiles, ordered, counts, *sizes)
    program.sum_tiles(tiles, WORK_GROUP, counts, totals, np.uint32(chunks), np.uint32(tiles))
    exclusive_scan(device, totals, starts, tiles)
    pairs = int(starts.read(start=tiles)[0])
    # Each chunk appends its faces to the lists in order, at offsets computed from the counts.
    lists = device.scratch("splat tile lists", max(pairs, 1), np.uint32)
    program.fill_tiles(chunks, 1, order, ordered, counts, starts, lists, *sizes)
    return TileLists(starts, lists, listed, pairs)


def _sort_by_tile(
    device: Device, projected: Projected, order: Buffer, listed: int, columns: int, tiles: int
) -> TileLists:
    """Build the lists by sorting pairs of (tile, face) by tile; the stable sort keeps the depth order."""
    program = device.program(f"splat_bins_{device.style}")
    counts = device.scratch("splat tiles of ordered faces", max(listed, 1), np.uint32)
    offsets = device.scratch("splat pair offsets", listed + 1, np.uint64)
    # Count the tiles that each face covers, and find the first pair of each face.
    program.count_pairs(listed, WORK_GROUP, order, projected.tiles, counts, np.uint32(listed))
    exclusive_scan(device, counts, offsets, listed)
    pairs = int(offsets.read(start=listed)[0])
    if pairs > MOST:
        text = f"the image needs {pairs} tile pairs, but at most {MOST} can be sorted; render a smaller image"
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
    # The pairs are sorted by tile number, so the list of tile t starts at the first pair with number t.
    program.find_starts(pairs + 1, WORK_GROUP, pair_tiles, starts, np.uint32(pairs), np.uint32(tiles))
    return TileLists(starts, places, listed, pairs)

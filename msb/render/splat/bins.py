"""Projected primitives -> depth order -> tile lists, all on the device.

The host reads two counts only: how many primitives are listed, and how many entries all lists have together,
which decides how much memory the lists need.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from msb.cl.scan import MOST, chunks_of, exclusive_scan
from msb.cl.sort import sort_pairs
from msb.errors import DeviceError
from msb.render.splat.launch import WORK_GROUP

if TYPE_CHECKING:
    from msb.cl import Buffer, Device
    from msb.render.splat.depth import DepthSort


class Projected(NamedTuple):
    """The buffers that `project` writes for F faces. Each face that some tile lists has a place in them.

    Attributes
    ----------
    faces, keys, tiles : Buffer
        For each place: the record that blending reads, the depth, and the rectangle of tiles. A work-item's
        places begin at the row of its first face.
    listed : Buffer
        For each work-item, how many of its faces are listed.
    visible : Buffer
        For each row, whether the official culling keeps its face.
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


def bin_faces(
    device: Device, found: Projected, chunk: int, columns: int, rows: int, sort: DepthSort
) -> TileLists:
    """Queue depth order and tile lists of faces projected `chunk` a work-item; waits for the two counts."""
    program = device.program(f"splat_bins_{device.style}")
    items = found.listed.size
    with device.stage("sort"):
        before = device.scratch("splat listed before", items + 1, np.uint32)
        exclusive_scan(device, found.listed, before)
        listed = int(before.read(start=items)[0])
        keys = device.scratch("splat depth keys", listed, np.uint32)
        places = device.scratch("splat depth order", listed, np.uint32)
        group = 1 if device.style == "cpu" else WORK_GROUP
        sizes = np.uint32(items), np.uint32(chunk)
        program.compact(items, group, before, found.keys, keys, places, *sizes)
        if listed:
            places = sort(found, keys, places)
    with device.stage("bin"):
        make = _count_and_fill if device.style == "cpu" else _sort_by_tile
        return make(device, found, places, listed, columns, columns * rows)


def _count_and_fill(
    device: Device, found: Projected, order: Buffer, listed: int, columns: int, tiles: int
) -> TileLists:
    program = device.program(f"splat_bins_{device.style}")
    chunk, chunks = chunks_of(device, listed)
    counts = device.scratch("splat tile counts of chunks", (max(chunks, 1), tiles), np.uint32)
    totals = device.scratch("splat tile totals", tiles, np.uint32)
    starts = device.scratch("splat tile starts", tiles + 1, np.uint64)
    sizes = np.uint32(listed), np.uint32(chunk), np.uint32(columns), np.uint32(tiles)
    ordered = device.scratch("splat ordered tiles", (max(listed, 1), 4), np.uint16)
    program.count_tiles(chunks, 1, order, found.tiles, ordered, counts, *sizes)
    program.sum_tiles(tiles, WORK_GROUP, counts, totals, np.uint32(chunks), np.uint32(tiles))
    exclusive_scan(device, totals, starts, tiles)
    pairs = int(starts.read(start=tiles)[0])
    lists = device.scratch("splat tile lists", max(pairs, 1), np.uint32)
    program.fill_tiles(chunks, 1, order, ordered, counts, starts, lists, *sizes)
    return TileLists(starts, lists, listed, pairs)


def _sort_by_tile(
    device: Device, found: Projected, order: Buffer, listed: int, columns: int, tiles: int
) -> TileLists:
    program = device.program(f"splat_bins_{device.style}")
    counts = device.scratch("splat tiles of ordered faces", max(listed, 1), np.uint32)
    offsets = device.scratch("splat pair offsets", listed + 1, np.uint64)
    program.count_pairs(listed, WORK_GROUP, order, found.tiles, counts, np.uint32(listed))
    exclusive_scan(device, counts, offsets, listed)
    pairs = int(offsets.read(start=listed)[0])
    if pairs > MOST:
        text = f"{pairs} pairs of tile and face are too many to sort ({MOST}): draw a smaller image"
        raise DeviceError("DEVICE_MEMORY", text)
    starts = device.scratch("splat tile starts", tiles + 1, np.uint64)
    pair_tiles = device.scratch("splat pair tiles", max(pairs, 1), np.uint32)
    places = device.scratch("splat pair places", max(pairs, 1), np.uint32)
    sizes = np.uint32(listed), np.uint32(columns)
    program.emit_pairs(listed, WORK_GROUP, order, found.tiles, offsets, pair_tiles, places, *sizes)
    if pairs:
        bits = max(1, (tiles - 1).bit_length())
        pair_tiles, places = sort_pairs(
            device, pair_tiles, places, count=pairs, bits=bits, name="splat pair sort"
        )
    program.find_starts(pairs + 1, WORK_GROUP, pair_tiles, starts, np.uint32(pairs), np.uint32(tiles))
    return TileLists(starts, places, listed, pairs)

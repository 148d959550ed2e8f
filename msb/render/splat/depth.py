"""The order of blending: by depth, and by number at equal depth, as the official sort is stable."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msb.cl.sort import sort_pairs
from msb.render.splat.launch import WORK_GROUP

if TYPE_CHECKING:
    from msb.cl import Buffer, Device, Program
    from msb.registry import Order
    from msb.render.splat.bins import Projected

_SETTLED = 1024
"""Equals MOST_SETTLED in splat_ties.cl."""


class DepthSort:
    """Puts places of listed faces in the order of blending.

    Parameters
    ----------
    device : Device
    program : Program
        The program of the method.
    order : {"tile", "global", "none"}
        The order of blending; "none" sorts by number alone.

    Attributes
    ----------
    by_rows : bool
        Whether faces lie in the order of their numbers, as they are stored, and not in drawing order
        (`msb.render.splat.order`).
    """

    def __init__(self, device: Device, program: Program, order: Order) -> None:
        self._device = device
        self._program = program
        self._by_number_alone = order == "none"
        self.by_rows = True

    def __call__(self, found: Projected, depths: Buffer, places: Buffer) -> Buffer:
        """Return `places`, which are ascending, sorted by their `depths`. Both arrays are overwritten."""
        if self._by_number_alone:
            return places if self.by_rows else self._by_number(found, depths, places)
        order = self._by_depth(depths, places)
        if self.by_rows or self._settle(found, *order):
            return order[1]
        # Too many are equal, as in a plane that the camera faces: one stable sort after the other.
        places = self._by_number(found, depths, places)
        arguments = places, found.keys, depths, np.uint32(places.size)
        self._program.depths_of(places.size, WORK_GROUP, *arguments)
        return self._by_depth(depths, places)[1]

    def _by_depth(self, depths: Buffer, places: Buffer) -> tuple[Buffer, Buffer]:
        return sort_pairs(self._device, depths, places, name="splat depth sort")

    def _by_number(self, found: Projected, keys: Buffer, places: Buffer) -> Buffer:
        """Return `places` sorted by the numbers of their faces, which are `keys` from here on."""
        count = places.size
        self._program.numbers_of(count, WORK_GROUP, places, found.faces, keys, np.uint32(count))
        bits = (found.visible.size - 1).bit_length()
        return sort_pairs(self._device, keys, places, bits=bits, name="splat number sort")[1]

    def _settle(self, found: Projected, depths: Buffer, places: Buffer) -> bool:
        """Sort equal depths by number; return False where there are too many for that."""
        unsettled = self._device.scratch("splat unsettled", 1, np.uint32)
        unsettled.fill(0)
        arguments = depths, places, found.faces, unsettled, np.uint32(places.size)
        if self._device.style == "cpu":
            self._program.settle_ties(-(-places.size // _SETTLED), 1, *arguments, np.uint32(_SETTLED))
        else:
            self._program.settle_ties(places.size, WORK_GROUP, *arguments)
        return not unsettled.read()[0]

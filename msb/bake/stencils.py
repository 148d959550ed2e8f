"""The normal equations of a texture and its smaller levels: stencils, and nothing larger than the texture.

A pixel shows four texels of a level that lie beside each other, and between two levels four of each. So a
texel is tied to the eight around it alone, level by level. A texel of a smaller level is the mean of four.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.bake.arrays import Floats, Singles
from msb.render.device_scope import DeviceScope, OnDevice, in_turn

if TYPE_CHECKING:
    from msb.cl import Buffer, Device


# What it costs, in pixels, that the changes of two texels differ: it fills what no picture shows.
SMOOTHNESS = 0.5
# Of conjugate gradients.
STEPS = 15
# A residual up to this counts as 0.
_NOTHING = 1e-12
_GROUP = 64
# Texels that a work-item sums over, and such work-items of a group.
_RUN, _RUNS = 64, 8


class Pyramid(OnDevice):
    """The normal equations of a square texture and its smaller levels, each a stencil of nine texels.

    `equations` (texels, 8) has of each texel, level by level, the products with itself, with the right one,
    the one below, below right and below left, and the right sides of red, green and blue;
    `msb.bake.painting` sums them.
    """

    def __init__(self, size: int, device: str | Device | None = None) -> None:
        self.size = size
        sides = [size]
        while sides[-1] % 2 == 0 and sides[-1] > 2:
            sides.append(sides[-1] // 2)
        self.levels = len(sides)
        self.sides = np.array(sides)
        self.starts = np.concatenate([[0], np.cumsum(self.sides**2)])
        self._scope = DeviceScope(device, "stencils")
        with self._scope.setting_up():
            self._device = self._scope.device
            self._own = self._device.program("bake_solve", {"RUN": _RUN, "NOTHING": _NOTHING})
            self.equations = self._new((self.starts[-1], 8))
            self.equations.fill(0)

    def _new(self, shape: tuple[int, ...]) -> Buffer:
        return self._device.allocate(shape, np.float32, "bake equations")

    @in_turn
    def tie(self, chart: NDArray[np.int32]) -> None:
        """Tie the changes of neighbours of one chart (size, size) to each other."""
        charts = self._device.upload(chart, "bake charts")
        how = np.float32(SMOOTHNESS), np.int32(self.size)
        self._own.tie(chart.size, _GROUP, charts, *how, self.equations, np.uint32(chart.size))
        self._device.finish()
        charts.release()

    @in_turn
    def solved(self) -> Singles:
        """Return the change (size, size, 3) that the equations ask for, by conjugate gradients.

        The right sides are gone then: they hold what is left of them.
        """
        own, levels, texels = self._own, self._levels(), self.size**2
        count, runs = np.uint32(texels), -(-texels // _RUN)
        direction, sums = self._new((self.starts[-1], 4)), self._new((self.starts[-1], 3))
        change, partial = self._new((self.size, self.size, 3)), self._new((runs, 4))
        for many, at in reversed(levels):
            own.spread(many, _GROUP, self.equations, *at, direction, np.uint32(many))
        own.begin(runs, _RUNS, self.equations, direction, change, partial, count)
        left, again = _total(partial), np.zeros(3)
        for _ in range(STEPS):
            if (left <= _NOTHING).all():
                break
            own.turn(texels, _GROUP, self.equations, _four(again), direction, count)
            for (_, (before, start, _)), (many, (_, _, side)) in pairwise(levels):
                own.halve(many, _GROUP, direction, before, start, side, np.uint32(many))
            for many, at in reversed(levels):
                given = self.equations, direction, *at, sums, partial, np.uint32(many)
                own.apply(-(-many // _RUN), _RUNS, *given)
            length = _quotient(left, _total(partial))
            ends = self.equations, change, partial, count
            own.advance(runs, _RUNS, direction, sums, _four(length), *ends)
            last, left = left, _total(partial)
            again = _quotient(left, last)
        for buffer in (direction, sums, partial):
            buffer.release()
        found: Singles = change.read()
        change.release()
        return found

    def _levels(self) -> list[tuple[int, tuple[np.uint32, np.uint32, np.int32]]]:
        """Return of each level how many texels it has, and where it begins, where the next smaller one does,
        or 0, and its side."""
        begins = [*map(np.uint32, self.starts[:-1]), np.uint32(0)]
        sides = self.sides.tolist()
        return [(n * n, (begins[k], begins[k + 1], np.int32(n))) for k, n in enumerate(sides)]


def _total(partial: Buffer) -> Floats:
    """Return the sums of red, green and blue."""
    total: Floats = partial.read()[:, :3].sum(axis=0, dtype=np.float64)
    return total


def _quotient(above: Floats, below: Floats) -> Floats:
    """Return the quotients; 0 where nothing is left to do."""
    return np.divide(above, below, out=np.zeros(3), where=(above > _NOTHING) & (below > 0))


def _four(values: Floats) -> Singles:
    return np.array([*values, 0], np.float32)

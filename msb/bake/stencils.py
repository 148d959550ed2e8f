"""The normal equations of a texture and its smaller levels: stencils, and nothing larger than the texture.

A pixel shows four texels of a level that lie beside each other, and between two levels four of each. So a
texel is tied to the eight around it alone, level by level. A texel of a smaller level is the mean of four.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    Reals = NDArray[np.float64]

SMOOTHNESS = 0.5
"""What it costs, in pixels, that the changes of two texels differ: it fills what no picture shows."""
_STEPS = 15
_NOTHING = 1e-12


class Pyramid:
    """The normal equations of a square texture and its smaller levels, each a stencil of nine texels."""

    def __init__(self, size: int) -> None:
        self.size = size
        sides = [size]
        while sides[-1] % 2 == 0 and sides[-1] > 2:
            sides.append(sides[-1] // 2)
        self.levels = len(sides)
        self.sides = np.array(sides)
        self.starts = np.concatenate([[0], np.cumsum(self.sides**2)])
        self._slices = [slice(a, b) for a, b in pairwise(self.starts.tolist())]
        # `msb.bake.painting` sums them. Of each texel: with itself, with the right one, the one below, below
        # right and below left.
        self.planes = np.zeros((5, self.starts[-1]), np.float32)
        self.right = np.zeros((3, self.starts[-1]), np.float32)

    def tie(self, chart: NDArray[np.int32]) -> None:
        """Tie the changes of neighbours of one chart (size, size) to each other."""
        center, right, down = (plane[: self.size**2].reshape(chart.shape) for plane in self.planes[:3])
        for plane, first, second in (
            (right, np.s_[:, :-1], np.s_[:, 1:]),
            (down, np.s_[:-1], np.s_[1:]),
        ):
            tied = np.float32(SMOOTHNESS) * (chart[first] == chart[second])
            plane[first] -= tied
            center[first] += tied
            center[second] += tied

    def solved(self) -> Iterator[NDArray[np.float32]]:
        """Yield the change (texels,) that the equations ask for, by conjugate gradients: red, green, blue."""
        diagonal = self._spread([self.planes[0, level] for level in self._slices], 1 / 16)
        scale = np.divide(1, diagonal, out=np.zeros_like(diagonal), where=diagonal > _NOTHING)
        for right in self.right:
            yield self._one_channel(self._spread([right[level] for level in self._slices], 1 / 4), scale)

    def _one_channel(self, rest: NDArray[np.float32], scale: NDArray[np.float32]) -> NDArray[np.float32]:
        made = np.zeros_like(rest)
        way, size = np.zeros_like(rest), 0.0
        for _ in range(_STEPS):
            scaled = scale * rest
            before, size = size, _dot(rest, scaled)
            if size <= _NOTHING:
                break
            way *= np.float32(size / before if before else 0)
            way += scaled
            moved = self.applied(way)
            length = np.float32(size / _dot(way, moved))
            made += length * way
            rest -= length * moved
        return made

    def applied(self, change: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the left side for a change (texels,) of the texture."""
        parts: list[NDArray[np.float32]] = []
        for level, side in zip(self._slices, self.sides.tolist(), strict=True):
            if parts:
                four = change.reshape(side, 2, side, 2)
                rows = four[:, 0] + four[:, 1]
                change = (np.float32(1 / 4) * (rows[..., 0] + rows[..., 1])).reshape(-1)
            center, *others = self.planes[:, level]
            made = center * change
            # In rows one after the other: a texel at the border is not tied beyond it.
            for plane, step in zip(others, (1, side, side + 1, side - 1), strict=True):
                made[:-step] += plane[:-step] * change[step:]
                made[step:] += plane[:-step] * change[:-step]
            parts.append(made)
        return self._spread(parts, 1 / 4)

    def _spread(self, parts: Sequence[NDArray[np.float32]], share: float) -> NDArray[np.float32]:
        """Return the sum (texels,) of what levels have: a texel gets `share` of that which it is part of."""
        total = parts[-1].copy()
        for part in parts[-2::-1]:
            half = math.isqrt(len(total))
            own = part.reshape(half, 2, half, 2)
            total = (own + np.float32(share) * total.reshape(half, 1, half, 1)).reshape(-1)
        return total


def _dot(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    return float((one * other).sum(dtype=np.float64))

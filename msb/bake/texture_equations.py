"""The normal equations of a texture and its mip levels are stored as stencils and solved on the device.

A pixel on one mip level shows four neighbouring texels. A pixel between two levels shows four texels of each
level. A texel is therefore only coupled to eight neighbours in its level. A texel of a smaller mip level is
the average of four texels of the next larger level. The memory is therefore proportional to the number of
texels, not pixels.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from msb.bake.arrays import Floats, Singles
from msb.render.device_scope import DeviceScope, OnDevice, in_turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.cl import Buffer, Device

# Weight of the squared difference between the changes of two neighbouring texels. A pixel has the weight 1. A
# weight of this size has little influence on texels with pixels. Changes spread to texels without pixels.
SMOOTHNESS = 0.5
# Number of conjugate-gradient steps. Few steps suffice, because the initial texture is near the solution.
# Each conjugate-gradient step needs a pass over all texels.
STEPS = 15
# A channel is solved if its squared residual is not larger than this value.
_ZERO = 1e-12
# Work-items of a work-group.
_GROUP = 64
# A work-item adds up this number of texels. The second value is the number of such work-items in a
# work-group. Sums are reproducible, because a work-item adds up the same texels on every device.
_RUN, _RUN_GROUP = 64, 8


class TextureEquations(OnDevice):
    """The normal equations of a square texture and its mip levels.

    The field `stencils` (texels, 8) has a row for each texel, level by level. The first five values of a
    stencil are sums of products of two weights. The first weight belongs to the texel itself. The second
    weight belongs to the same texel or to a neighbour: right, below, below right, or below left. The last
    three values of a stencil are the right sides of red, green and blue. `msb.bake.texture_renderer` computes
    the sums of the stencils.

    The field `sides` has the number of texels along a side for each mip level. The field `starts` has the
    index of the first texel of each mip level, and the total number of texels at the end.
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
            self._kernels = self._device.program("bake_solve", {"RUN": _RUN, "NOTHING": _ZERO})
            self.stencils = self._allocate((self.starts[-1], 8))
            self.stencils.fill(0)

    def _allocate(self, shape: tuple[int, ...]) -> Buffer:
        return self._device.allocate(shape, np.float32, "bake equations")

    @in_turn
    def add_smoothness(self, chart: NDArray[np.int32]) -> None:
        """Couple the changes of neighbouring texels in the same chart. `chart` (size, size) is the chart of
        each texel."""
        charts = self._device.upload(chart, "bake charts")
        settings = np.float32(SMOOTHNESS), np.int32(self.size)
        self._kernels.tie(chart.size, _GROUP, charts, *settings, self.stencils, np.uint32(chart.size))
        self._device.finish()
        charts.release()

    @in_turn
    def solve(self) -> Singles:
        """Return the change (size, size, 3) of the texture that solves the equations.

        The method is conjugate gradients with Jacobi's preconditioner, solved for three channels at a time.
        The right sides in `stencils` are overwritten with the residuals.
        """
        kernels, levels, texels = self._kernels, self._describe_levels(), self.size**2
        count, runs = np.uint32(texels), -(-texels // _RUN)
        direction, sums = self._allocate((self.starts[-1], 4)), self._allocate((self.starts[-1], 3))
        change, partial = self._allocate((self.size, self.size, 3)), self._allocate((runs, 4))
        # Restrict the right sides and the diagonal of the matrix from the smaller levels to the texture
        # itself.
        for many, place in reversed(levels):
            kernels.spread(many, _GROUP, self.stencils, *place, direction, np.uint32(many))
        kernels.begin(runs, _RUN_GROUP, self.stencils, direction, change, partial, count)
        residual, ratio = _sum_partial(partial), np.zeros(3)
        for _ in range(STEPS):
            if (residual <= _ZERO).all():
                break
            # Compute the next direction and the average of the direction in each smaller level. Multiply the
            # system matrix with the direction.
            kernels.turn(texels, _GROUP, self.stencils, _pad(ratio), direction, count)
            for (_, (before, start, _)), (many, (_, _, side)) in pairwise(levels):
                kernels.halve(many, _GROUP, direction, before, start, side, np.uint32(many))
            for many, place in reversed(levels):
                arguments = self.stencils, direction, *place, sums, partial, np.uint32(many)
                kernels.apply(-(-many // _RUN), _RUN_GROUP, *arguments)
            # Step along the direction, and compute the new residual.
            length = _divide(residual, _sum_partial(partial))
            outputs = self.stencils, change, partial, count
            kernels.advance(runs, _RUN_GROUP, direction, sums, _pad(length), *outputs)
            last, residual = residual, _sum_partial(partial)
            ratio = _divide(residual, last)
        for buffer in (direction, sums, partial):
            buffer.release()
        result: Singles = change.read()
        change.release()
        return result

    def _describe_levels(self) -> list[tuple[int, tuple[np.uint32, np.uint32, np.int32]]]:
        """For each level, return the number of texels. Also return the first texel, the first texel of the
        next level (or 0), and the side."""
        starts = [*map(np.uint32, self.starts[:-1]), np.uint32(0)]
        sides = self.sides.tolist()
        return [(n * n, (starts[k], starts[k + 1], np.int32(n))) for k, n in enumerate(sides)]


def _sum_partial(partial: Buffer) -> Floats:
    """Return the sums (3,) of red, green and blue from all partial sums."""
    total: Floats = partial.read()[:, :3].sum(axis=0, dtype=np.float64)
    return total


def _divide(above: Floats, below: Floats) -> Floats:
    """Return the quotients (3,) of two values per channel. The quotient is 0 for a channel that is already
    solved."""
    return np.divide(above, below, out=np.zeros(3), where=(above > _ZERO) & (below > 0))


def _pad(values: Floats) -> Singles:
    """Return three values as a float4 of OpenCL."""
    return np.array([*values, 0], np.float32)

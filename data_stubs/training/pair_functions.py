"""Functions per pair of a triangle and a pixel, with hand-derived derivatives.

Arrays of pairs are flat, with one number per pair in the order of `Pairs`. Arrays of triangles have one row
per entry of `Pairs.faces`. Most functions use NumPy. It is as fast as torch for memory-bound arrays, and many
times faster at sums over runs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

if TYPE_CHECKING:
    from data_stubs.training.pairs import Pairs


class Affine(torch.autograd.Function):
    """Compute a x + b y + c at every pair, (K, P), from rows (a, b, c) of triangles, (G, K, 3)."""

    @staticmethod
    def forward(ctx: Any, rows: torch.Tensor, pairs: Pairs) -> torch.Tensor:
        ctx.pairs, ctx.shape = pairs, rows.shape
        values = rows.detach().numpy()
        found = np.zeros((rows.shape[1], len(pairs.x)), pairs.dtype)
        for k, line in enumerate(found):
            np.multiply(pairs.spread(values[:, k, 0]), pairs.x, out=line)
            line += pairs.spread(values[:, k, 1]) * pairs.y
            line += pairs.spread(values[:, k, 2])
        return torch.from_numpy(found)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor, None]:
        pairs, lines = ctx.pairs, grad.numpy()
        found = np.zeros(ctx.shape)
        for k, line in enumerate(lines):
            found[:, k, 0] = pairs.total(line * pairs.x)
            found[:, k, 1] = pairs.total(line * pairs.y)
            found[:, k, 2] = pairs.total(line)
        return torch.from_numpy(found), None


class Spread(torch.autograd.Function):
    """Copy values of triangles, (G,), to every pair, (P,)."""

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, pairs: Pairs) -> torch.Tensor:
        ctx.pairs = pairs
        return torch.from_numpy(pairs.spread(values.detach().numpy()))

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor, None]:
        return torch.from_numpy(ctx.pairs.total(grad.numpy()).astype(np.float64)), None


class Highest(torch.autograd.Function):
    """Return the maximum (P,) of each column of (3, P); the first of equal values gets the derivative."""

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor) -> torch.Tensor:
        first, second, third = values.numpy()
        highest = np.fmax(np.fmax(first, second), third)
        is_first = first == highest
        is_second = (second == highest) & ~is_first
        ctx.masks = is_first, is_second, ~(is_first | is_second)
        return torch.from_numpy(highest)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> torch.Tensor:
        line = grad.numpy()
        return torch.from_numpy(np.stack([line * mask for mask in ctx.masks]))


class Quotient(torch.autograd.Function):
    """Barycentric coordinates in perspective, l_k / (l_0 + l_1 + l_2), (3, P), from numerators l (3, P).

    If the absolute value of the sum is less than `least`, the result is NaN, which gives an alpha of 0.
    """

    @staticmethod
    def forward(ctx: Any, values: torch.Tensor, least: float) -> torch.Tensor:
        lines = values.numpy()
        total = lines[0] + lines[1] + lines[2]
        total[np.abs(total) < least] = np.nan
        ctx.inverse = 1 / total
        ctx.found = lines * ctx.inverse
        return torch.from_numpy(ctx.found)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor, None]:
        lines = grad.numpy()
        common = sum(line * value for line, value in zip(lines, ctx.found, strict=True))
        return torch.from_numpy(np.nan_to_num((lines - common) * ctx.inverse)), None


class WindowAlpha(torch.autograd.Function):
    """Alpha min(cap, o phi^sigma) from distances phi, opacity o and sigma, (P,) each; 0 where phi < 0."""

    @staticmethod
    def forward(
        ctx: Any, phi: torch.Tensor, opacity: torch.Tensor, sigma: torch.Tensor, cap: float
    ) -> torch.Tensor:
        inside = phi.numpy() >= 0
        tiny = float(torch.finfo(phi.dtype).tiny)
        logarithm = torch.log2(phi.clamp(min=tiny))
        coverage = torch.exp2(sigma * logarithm)
        coverage.numpy()[...] *= inside & (phi.numpy() > 0)
        alpha = opacity * coverage
        below = alpha.numpy() < cap
        ctx.saved = phi, opacity, sigma, coverage, logarithm, below
        return alpha.clamp_(max=cap)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, None]:
        phi, opacity, sigma, coverage, logarithm, below = ctx.saved
        grad = grad * torch.from_numpy(below.astype(grad.numpy().dtype))
        for_opacity = grad * coverage
        alpha_term = for_opacity * opacity
        tiny = 1e-6
        return (
            alpha_term * sigma / phi.clamp(min=tiny),
            for_opacity,
            alpha_term * logarithm * float(np.log(2)),
            None,
        )


class GaussianAlpha(torch.autograd.Function):
    """Alpha min(cap, o exp(-e^(2 gamma) / 2)) from eccentricity e and opacity o; 0 unless 0 <= e <= 10."""

    @staticmethod
    def forward(
        ctx: Any, eccentricity: torch.Tensor, opacity: torch.Tensor, gamma: float, cap: float
    ) -> torch.Tensor:
        e = eccentricity.numpy()
        near = (e >= 0) & (e <= 10)
        safe = torch.from_numpy(np.clip(np.nan_to_num(e, nan=10), 1e-30, 10))
        power = safe.square() if gamma == 1 else torch.exp2(2 * gamma * torch.log2(safe))
        falloff = torch.exp(-0.5 * power)
        falloff.numpy()[...] *= near
        alpha = opacity * falloff
        ctx.saved = safe, power, opacity, falloff, alpha.numpy() < cap
        ctx.gamma = gamma
        return alpha.clamp(max=cap)

    @staticmethod
    def backward(ctx: Any, grad: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, None, None]:
        safe, power, opacity, falloff, below = ctx.saved
        for_opacity = grad * torch.from_numpy(below.astype(grad.numpy().dtype)) * falloff
        # The fall-off is 0 if the power overflows float32.
        slope = (power.clamp(max=1e6) / safe).mul_(-ctx.gamma)
        return for_opacity * opacity * slope, for_opacity, None, None

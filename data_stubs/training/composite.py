"""Front-to-back blending of pairs, with its derivative worked out by hand.

The pairs of a pixel have weights w_i = a_i T_i with T_i = (1 - a_0) ... (1 - a_(i-1)). If g is the derivative
of the loss by the colour, then dL/da_i = T_i (g . c_i) - (sum of w_j (g . c_j) over j > i) / (1 - a_i).
Transmittances are never divided by each other, so small transmittances keep their precision.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from msb.reference.blend import MIN_TRANSMITTANCE

if TYPE_CHECKING:
    from data_stubs.training.pairs import Pairs


class Blended(NamedTuple):
    """A raster of H x W samples: colours (C, H W) without background, and the weight (P,) of every pair."""

    color: torch.Tensor
    transmittance: torch.Tensor
    weight: NDArray[Any]


def composite(
    alpha: torch.Tensor, color: torch.Tensor, pairs: Pairs, *, blends_crossing: bool, least: float = 1 / 255
) -> Blended:
    """Blend pairs front to back; pairs with `alpha` (P,) below `least` are skipped.

    `color` is (C, G) per triangle or (C, P) per pair; `blends_crossing` as in `msb.reference.blend.Rule`.
    """
    kept: dict[str, Any] = {}
    found, through = _Composite.apply(alpha, color, pairs, blends_crossing, least, kept)
    return Blended(found, through, pairs.ranks.to_faces(kept["weight"]))


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        alpha: torch.Tensor,
        color: torch.Tensor,
        pairs: Pairs,
        blends_crossing: bool,
        least: float,
        kept: dict[str, Any],
    ) -> tuple[torch.Tensor, torch.Tensor]:
        ranks, real = pairs.ranks, pairs.dtype.type
        values = alpha.detach().numpy()[ranks.pair]
        values *= values >= real(least)
        stays = 1 - values
        before = np.ones_like(values)
        previous: slice | None = None
        for part, size in ranks.slices():
            if previous is not None:
                start = previous.start
                np.multiply(before[start : start + size], stays[start : start + size], out=before[part])
            previous = part
        after = before * stays
        threshold = real(MIN_TRANSMITTANCE)
        blended = before > threshold if blends_crossing else after >= threshold
        weight = values * before
        weight *= blended
        after[~blended] = 1
        through = np.ones(len(ranks.pixels), pairs.dtype)
        for part, size in ranks.slices():
            np.minimum(through[:size], after[part], out=through[:size])
        colors = color.detach().numpy()
        per_face = colors.shape[1] == len(pairs.faces) and len(pairs.faces) != len(pairs.x)
        image = np.zeros((len(colors), pairs.width * pairs.height), pairs.dtype)
        by_rank = []
        for channel, line in zip(image, colors, strict=True):
            ranked = (pairs.spread(line) if per_face else line)[ranks.pair]
            by_rank.append(ranked)
            channel[ranks.pixels] = ranks.add_up(weight * ranked)
        transmittance = np.ones(pairs.width * pairs.height, pairs.dtype)
        transmittance[ranks.pixels] = through
        kept["weight"] = weight
        ctx.saved = pairs, weight, before, stays, blended, through, by_rank, per_face
        return torch.from_numpy(image), torch.from_numpy(transmittance)

    @staticmethod
    def backward(
        ctx: Any, for_color: torch.Tensor, for_transmittance: torch.Tensor
    ) -> tuple[torch.Tensor | None, ...]:
        pairs, weight, before, stays, blended, through, by_rank, per_face = ctx.saved
        ranks = pairs.ranks
        gained = np.zeros_like(weight)
        colors = []
        for line, ranked in zip(for_color.numpy(), by_rank, strict=True):
            slope = ranks.by_rank(line[ranks.pixels])
            gained += slope * ranked
            slope *= weight
            of_pairs = ranks.to_faces(slope)
            colors.append(pairs.total(of_pairs).astype(np.float64) if per_face else of_pairs)
        behind = np.zeros_like(weight)
        below = through * for_transmittance.numpy()[ranks.pixels]
        terms = gained * weight
        for part, size in reversed(list(ranks.slices())):
            behind[part] = below[:size]
            below[:size] += terms[part]
        # Nothing is visible behind an opaque pair.
        slope = (gained * before - behind / np.maximum(stays, 1e-30)) * blended
        return (
            torch.from_numpy(ranks.to_faces(slope)),
            torch.from_numpy(np.stack(colors)),
            None,
            None,
            None,
            None,
        )

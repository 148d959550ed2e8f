"""What a method's image formation takes and returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

if TYPE_CHECKING:
    from data_stubs.training.pairs import Pairs

    Parameters = Mapping[str, torch.Tensor]
    """Names as in the official files -> values as in the official files."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """An image (H, W, 3) over its background, not clamped, with derivatives, and the triangles it shows.

    `weight` (P,) is alpha T of each pair. Of `pairs`, `scale` samples are a pixel along each axis, and row
    0 is the image's last if it is `flipped`.
    """

    image: torch.Tensor
    pairs: Pairs
    weight: NDArray[Any]
    scale: int = 1
    flipped: bool = False

    def peaks(self, faces: int) -> NDArray[np.float32]:
        """Return the largest weight of each of `faces` triangles; 0 for those not seen."""
        found = np.zeros(faces, np.float32)
        found[self.pairs.faces] = self.pairs.highest(self.weight)
        return found

    def shares(self, faces: int) -> NDArray[np.float32]:
        """Return how many samples' worth each of `faces` triangles contributes: the sum of its weights."""
        found = np.zeros(faces, np.float32)
        found[self.pairs.faces] = self.pairs.total(self.weight)
        return found


def picture(
    color: torch.Tensor,
    transmittance: torch.Tensor,
    background: NDArray[np.float64],
    width: int,
    height: int,
) -> torch.Tensor:
    """Return colour (3, H W) + T background as (H, W, 3)."""
    behind = torch.as_tensor(background, dtype=color.dtype)[:, None]
    return (color + transmittance * behind).view(3, height, width).permute(1, 2, 0)


def per_pair_dtype(parameters: Parameters) -> Any:
    """Return NumPy's name of the parameters' dtype, which is that of all per-pair arithmetic."""
    one = next(iter(parameters.values()))
    return np.dtype(np.float64 if one.dtype == torch.float64 else np.float32)


def as_float64(values: torch.Tensor) -> NDArray[np.float64]:
    """Return numbers without their derivative."""
    found: NDArray[np.float64] = values.detach().double().numpy()
    return found

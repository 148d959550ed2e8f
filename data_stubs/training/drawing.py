"""Input and output of a method's image formation."""

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
    """The parameters by name. Names and values are those of the official files."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """A differentiable image (H, W, 3) over its background, not clamped, and its visible triangles.

    `weight` (P,) is alpha T of each pair. `pairs` has `scale` samples per pixel along each axis; if
    `flipped`, its row 0 is the last row of the image.
    """

    image: torch.Tensor
    pairs: Pairs
    weight: NDArray[Any]
    scale: int = 1
    flipped: bool = False

    def peaks(self, faces: int) -> NDArray[np.float32]:
        """Return the largest weight of each of `faces` triangles; 0 for invisible ones."""
        found = np.zeros(faces, np.float32)
        found[self.pairs.faces] = self.pairs.highest(self.weight)
        return found

    def shares(self, faces: int) -> NDArray[np.float32]:
        """Return the contribution of each of `faces` triangles: the sum of its weights over all samples."""
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
    """Return the NumPy dtype of the parameters; all per-pair arithmetic uses this dtype."""
    one = next(iter(parameters.values()))
    return np.dtype(np.float64 if one.dtype == torch.float64 else np.float32)


def as_float64(values: torch.Tensor) -> NDArray[np.float64]:
    """Return an array detached from its derivative."""
    found: NDArray[np.float64] = values.detach().double().numpy()
    return found

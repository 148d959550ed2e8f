"""In which order and by which rules of sampling a splatting method's triangles are drawn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msb.reference.tiles import tiles_front_to_back

if TYPE_CHECKING:
    from msb.reference.arithmetic import Reals
    from msb.reference.camera_matrices import SplattingCamera
    from msb.reference.tiles import Rectangles, Tile
    from msb.registry import Order, Sampling


@dataclass(frozen=True)
class Modes:
    """Both choices; the defaults are official.

    Attributes
    ----------
    order : Order
        "tile": by depth, and a triangle is seen in its official tiles alone. "global": by depth, and it is
        seen wherever it reaches. "none": likewise, in the order of the asset.
    sampling : Sampling
        "official", or "engine": see `msb.reference.engine`. There a triangle reaches no farther than its
        edges, so that "tile" and "global" are the same.
    """

    order: Order = "tile"
    sampling: Sampling = "official"

    @property
    def engine(self) -> bool:
        """Whether triangles are sampled as graphics hardware does."""
        return self.sampling == "engine"

    def tiles(
        self, rectangles: Rectangles, depth: Reals, kept: NDArray[np.bool_], view: SplattingCamera
    ) -> Iterator[Tile]:
        """Yield the tiles of the view's raster with the faces each lists, in the order of drawing."""
        everywhere = self.order != "tile" and not self.engine
        key = np.zeros_like(depth) if self.order == "none" else depth
        return tiles_front_to_back(None if everywhere else rectangles, key, kept, view.width, view.height)

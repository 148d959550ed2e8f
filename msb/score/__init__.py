"""Score how near any mesh is to the photographs of the real thing: pose, pictures, structure and flags.

`pose` finds where the asset is in the frame of the capture, `pictures` draws it from the held-out cameras,
`evidence` looks for assets that gain PSNR without being the thing, and `certificate` writes the page.
docs/score.md has the protocol.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.base.lazy import make_lazy

if TYPE_CHECKING:
    from msb.score.comparison import Comparison, compare_scores
    from msb.score.measurement import Score, score

__all__ = ["Comparison", "Score", "compare_scores", "score"]

make_lazy(
    __name__,
    {
        "Comparison": "msb.score.comparison",
        "Score": "msb.score.measurement",
        "compare_scores": "msb.score.comparison",
        "score": "msb.score.measurement",
    },
)

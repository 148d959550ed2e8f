"""Measure why an export of an asset looks worse than its native rendering.

The effect of each cause is measured as a PSNR.

A cause is one difference between an engine and the method's native renderer, such as hard edges. The same
cameras render the asset with and without the cause. All other settings are the same in both images. The page
docs/worse.md shows images of all causes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.base.lazy import make_lazy

if TYPE_CHECKING:
    from msb.why.causes import CAUSES
    from msb.why.measurement import Cause, Causes, why
    from msb.why.total import Total
    from msb.why.views import EQUAL

__all__ = ["CAUSES", "EQUAL", "Cause", "Causes", "Total", "why"]

make_lazy(
    __name__,
    {
        "CAUSES": "msb.why.causes",
        "EQUAL": "msb.why.views",
        "Cause": "msb.why.measurement",
        "Causes": "msb.why.measurement",
        "Total": "msb.why.total",
        "why": "msb.why.measurement",
    },
)

"""Measures why an export looks worse than the native rendering: the PSNR of each cause on an asset.

A cause is one difference between how an engine and how the method draw a model. It is measured by rendering
the same cameras with and without this difference, everything else being equal. docs/worse.md shows images of
all causes.
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

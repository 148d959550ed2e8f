"""Why an export looks worse than the render: each cause by itself, measured on the asset at hand.

A cause is one way in which an engine draws a model differently from its method. Each is measured by drawing
the same cameras with it and without it, everything else alike. docs/worse.md shows every cause in pictures.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.base.lazy import make_lazy

if TYPE_CHECKING:
    from msb.why.causes import CAUSES
    from msb.why.run import Cause, Causes, why
    from msb.why.total import Total
    from msb.why.views import EQUAL

__all__ = ["CAUSES", "EQUAL", "Cause", "Causes", "Total", "why"]

make_lazy(
    __name__,
    {
        "CAUSES": "msb.why.causes",
        "EQUAL": "msb.why.views",
        "Cause": "msb.why.run",
        "Causes": "msb.why.run",
        "Total": "msb.why.total",
        "why": "msb.why.run",
    },
)

"""Make a plain asset of a model: a mesh that any engine draws, supervised by the model's own renderer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.base.lazy import make_lazy

if TYPE_CHECKING:
    from msb.bake.report import Psnr, Report
    from msb.bake.run import Baked, bake

__all__ = ["Baked", "Psnr", "Report", "bake"]

make_lazy(
    __name__,
    {"Baked": "msb.bake.run", "Psnr": "msb.bake.report", "Report": "msb.bake.report", "bake": "msb.bake.run"},
)

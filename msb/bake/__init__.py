"""Make a plain asset of a model: a mesh that any engine draws, taught by the model's own renderer."""

from __future__ import annotations

import sys

from msb.bake.report import Psnr, Report
from msb.bake.run import Baked, bake
from msb.base.callable_packages import CallablePackage

__all__ = ["Baked", "Psnr", "Report", "bake"]

sys.modules[__name__].__class__ = CallablePackage

"""Draw assets: the interface of a renderer, and our renderers in OpenCL."""

from __future__ import annotations

import sys

from msb.base.callable_packages import CallablePackage
from msb.render.frame import Frame
from msb.render.renderer import Renderer, render

__all__ = ["Frame", "Renderer", "render"]

sys.modules[__name__].__class__ = CallablePackage

"""Draw assets: the interface of a renderer, and our renderers in OpenCL."""

from __future__ import annotations

from msb.base.callable_packages import make_callable
from msb.render.frame import Frame
from msb.render.renderer import Renderer, render

__all__ = ["Frame", "Renderer", "render"]

make_callable(__name__, render)

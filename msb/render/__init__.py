"""Rendering of assets: the interface of a renderer, and the built-in renderers in OpenCL."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.base.lazy import make_lazy

if TYPE_CHECKING:
    from msb.render.frame import Frame
    from msb.render.renderer import Renderer, render

__all__ = ["Frame", "Renderer", "render"]

make_lazy(
    __name__,
    {"Frame": "msb.render.frame", "Renderer": "msb.render.renderer", "render": "msb.render.renderer"},
)

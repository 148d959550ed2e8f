"""Draw assets: the interface of a renderer, and our renderers in OpenCL.

The public API has a function of this package's name, so the package itself can be called:
``msb.render(asset, camera)`` is ``msb.render.render(asset, camera)``, whatever was imported first.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from msb.render.frame import Frame
from msb.render.renderer import Renderer, render

__all__ = ["Frame", "Renderer", "render"]


class _Callable(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> Frame:
        return render(*args, **kwargs)


sys.modules[__name__].__class__ = _Callable

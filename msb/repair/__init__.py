"""Repair assets and meshes: the steps of `msb.topology.steps`, with all that vertices and faces hold carried.

The public API has a function of this package's name, so the package itself can be called:
``msb.repair(asset)`` is ``msb.repair.repair(asset)``, whatever was imported first.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from msb.repair.assets import Repaired, repair
from msb.repair.plan import STEPS

__all__ = ["STEPS", "Repaired", "repair"]


class _Callable(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> Repaired:
        return repair(*args, **kwargs)


sys.modules[__name__].__class__ = _Callable

"""Repair assets and meshes with the steps of `msb.topology.steps`. The data of vertices and faces is kept."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.base.lazy import make_lazy

if TYPE_CHECKING:
    from msb.repair.assets import Repaired, repair
    from msb.repair.options import STEPS
    from msb.repair.plan import Options

__all__ = ["STEPS", "Options", "Repaired", "repair"]

make_lazy(
    __name__,
    {
        "STEPS": "msb.repair.options",
        "Options": "msb.repair.plan",
        "Repaired": "msb.repair.assets",
        "repair": "msb.repair.assets",
    },
)

"""Repair assets and meshes by the steps of `msb.topology.steps`; what vertices and faces hold is carried."""

from __future__ import annotations

from msb.base.callable_packages import make_callable
from msb.repair.assets import Repaired, repair
from msb.repair.plan import STEPS, Options

__all__ = ["STEPS", "Options", "Repaired", "repair"]

make_callable(__name__, repair)

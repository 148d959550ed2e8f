"""Repair assets and meshes by the steps of `msb.topology.steps`; what vertices and faces hold is carried."""

from __future__ import annotations

import sys

from msb.base.callable_packages import CallablePackage
from msb.repair.assets import Repaired, repair
from msb.repair.plan import STEPS, Options

__all__ = ["STEPS", "Options", "Repaired", "repair"]

sys.modules[__name__].__class__ = CallablePackage

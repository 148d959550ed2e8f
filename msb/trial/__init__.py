"""Try on a mesh what artists do with meshes, each task with the library they use, in a child process."""

from __future__ import annotations

import sys

from msb.base.callable_packages import CallablePackage
from msb.base.limits import Limits
from msb.trial.run import Trial, trial

__all__ = ["Limits", "Trial", "trial"]

sys.modules[__name__].__class__ = CallablePackage

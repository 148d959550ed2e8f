"""Try on a mesh what artists do with meshes, each task with the library they use, in a child process."""

from __future__ import annotations

from msb.base.callable_packages import make_callable
from msb.base.limits import Limits
from msb.trial.run import Trial, trial

__all__ = ["Limits", "Trial", "trial"]

make_callable(__name__, trial)

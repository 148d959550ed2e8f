"""Try on a mesh what artists do with meshes, each task with the library they would use, in a child process.

The public API has a function of this package's name, so the package itself can be called:
``msb.trial(asset)`` is ``msb.trial.run.trial(asset)``, whatever was imported first.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from msb.trial.limits import Limits
from msb.trial.run import Trial, trial

__all__ = ["Limits", "Trial", "trial"]


class _Callable(ModuleType):
    def __call__(self, *args: Any, **kwargs: Any) -> list[Trial]:
        return trial(*args, **kwargs)


sys.modules[__name__].__class__ = _Callable

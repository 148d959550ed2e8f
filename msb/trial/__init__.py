"""Try typical tasks of artists on a mesh.

Each task runs a library that artists' tools use, in a child process.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msb.base.lazy import make_lazy

if TYPE_CHECKING:
    from msb.base.limits import Limits
    from msb.trial.run import Trial, trial

__all__ = ["Limits", "Trial", "trial"]

make_lazy(__name__, {"Limits": "msb.base.limits", "Trial": "msb.trial.run", "trial": "msb.trial.run"})

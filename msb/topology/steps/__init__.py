"""The steps of a repair. A step is a function that takes arrays and returns a `Change`.

Every repair step takes arrays that `mesh_arrays` has checked. Positions must be finite, and no repair step
moves a vertex. docs/repair.md gives the guarantees of each step. `msb.repair` transfers the attributes of
vertices and faces.
"""

from msb.topology.steps.change import Change
from msb.topology.steps.close import close
from msb.topology.steps.cut import cut
from msb.topology.steps.debris import debris
from msb.topology.steps.dedupe import dedupe
from msb.topology.steps.drop import drop
from msb.topology.steps.orient import orient, turn_faces
from msb.topology.steps.outward import outward
from msb.topology.steps.pair import pair
from msb.topology.steps.weld import weld

__all__ = [
    "Change",
    "close",
    "cut",
    "debris",
    "dedupe",
    "drop",
    "orient",
    "outward",
    "pair",
    "turn_faces",
    "weld",
]

"""The steps of a repair, each a function of arrays that returns a `Change`.

Every step takes arrays that `mesh_arrays` has checked, whose positions are finite, and changes no vertex's
place. docs/repair.md says what each step guarantees. Carrying what vertices and faces hold is `msb.repair`.
"""

from msb.topology.steps.change import Change
from msb.topology.steps.close import close
from msb.topology.steps.cut import cut
from msb.topology.steps.debris import debris
from msb.topology.steps.drop import drop
from msb.topology.steps.orient import orient, turn_faces
from msb.topology.steps.pair import pair
from msb.topology.steps.weld import weld

__all__ = ["Change", "close", "cut", "debris", "drop", "orient", "pair", "turn_faces", "weld"]

"""Triangle Splatting+ is the predecessor of MeshSplatting.

Triangle Splatting+ and MeshSplatting have nearly the same file layout and image formation.
"""

from dataclasses import replace

from msb.methods.mesh_splatting import METHOD as SIBLING
from msb.scenes.datasets.rules import FAMILY, Rules

_FLOOR = replace(SIBLING.settings["opacity_floor"], default=0.9999)
METHOD = replace(
    SIBLING,
    title="Triangle Splatting+",
    paper_name=None,
    settings={**SIBLING.settings, "opacity_floor": _FLOOR},
    rules=Rules(
        "Triangle Splatting+",
        "trianglesplatting2/triangle-splatting2: full_eval.py, utils/camera_utils.py",
        photographs=FAMILY,
    ),
)

"""2DGS: we draw the mesh that its TSDF fusion extracts."""

from dataclasses import replace

from msb.registry import OTHER_LPIPS, extracted_mesh
from msb.scenes.datasets.rules import FAMILY, Rules

_RULES = Rules(
    "2DGS",
    "hbb1/2d-gaussian-splatting: scripts, utils/camera_utils.py",
    photographs=FAMILY,
)
METHOD = replace(extracted_mesh("2DGS mesh", (), _RULES), paper_name="2dgs", paper_notes=(OTHER_LPIPS,))

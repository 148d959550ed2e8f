"""3DGS: its files are recognised and rejected, and the error gives the reason."""

from msb.registry import OTHER_LPIPS, TIERS, Method
from msb.scenes.datasets.rules import FAMILY, Rules

METHOD = Method(
    title="3DGS",
    paper_name="3dgs",
    paper_notes=(OTHER_LPIPS,),
    unsupported=dict.fromkeys(TIERS, "its primitives are Gaussians, not triangles"),
    rules=Rules(
        "3DGS",
        "graphdeco-inria/gaussian-splatting: full_eval.py, utils/camera_utils.py",
        photographs={key: rule for key, rule in FAMILY.items() if key != "dtu"},
    ),
)

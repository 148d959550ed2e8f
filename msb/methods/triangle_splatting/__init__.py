"""Triangle-Splatting: triangle soups whose weight falls off from the incentre to the edges."""

from msb.registry import AWARE, BAKED, BAKED_DC, BLENDED, SH_DEGREE, Method, Native, Retained, Setting
from msb.scenes.datasets.rules import FAMILY, Rules

METHOD = Method(
    title="Triangle-Splatting",
    paper_name="triangle_splatting",
    native=Native(continuous_coverage=True, sh=True, alpha_compositing=True),
    retained={
        "standard": BAKED_DC,
        "dedicated": Retained("Method-aware", "SH", soft_coverage=True, **AWARE),
    },
    settings={
        "sh_degree": SH_DEGREE,
        "view_dir": Setting("broadcast_z", "choice", choices=("broadcast_z", "centroid")),
    },
    passes={"reference": BLENDED, "dedicated": BLENDED, "standard": BAKED},
    coverage="incentre_window",
    rules=Rules(
        "Triangle-Splatting",
        "trianglesplatting/triangle-splatting: full_eval.py, utils/camera_utils.py",
        photographs=FAMILY,
    ),
)

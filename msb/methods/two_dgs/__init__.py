"""2DGS: flat Gaussian discs that are intersected with pixel rays, and the mesh from its TSDF fusion."""

from msb.registry import (
    AWARE,
    BLENDED,
    OTHER_LPIPS,
    SPLAT_RASTERIZER,
    SPLAT_SH_DEGREE,
    Method,
    Native,
    Retained,
)
from msb.scenes.datasets.rules import FAMILY, Rules

METHOD = Method(
    title="2DGS",
    paper_name="2dgs",
    paper_notes=(OTHER_LPIPS,),
    native=Native(continuous_coverage=True, sh=True, alpha_compositing=True),
    retained={
        "standard": Retained("Fallback", "baked color"),
        "dedicated": Retained("Method-aware", "SH", soft_coverage=True, **AWARE),
    },
    settings={"rasterizer": SPLAT_RASTERIZER, "sh_degree": SPLAT_SH_DEGREE},
    passes={"reference": BLENDED, "dedicated": BLENDED, "standard": ("opaque_unlit",)},
    coverage="gaussian_disc",
    primitive="gaussian",
    reads_meshes=True,
    rules=Rules(
        "2DGS",
        "hbb1/2d-gaussian-splatting: scripts, utils/camera_utils.py",
        photographs=FAMILY,
    ),
)

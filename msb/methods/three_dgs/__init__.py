"""3DGS: anisotropic Gaussians, projected by a local affine map and blended front to back."""

from msb.registry import (
    AWARE,
    BLENDED,
    NO_TRIANGLES,
    OTHER_LPIPS,
    SPLAT_RASTERIZER,
    SPLAT_SH_DEGREE,
    Method,
    Native,
    Retained,
    Setting,
)
from msb.scenes.datasets.rules import FAMILY, Rules

# File suffixes of Gaussian viewers and editors.
SUFFIXES = (".spz", ".sog", ".splat", ".ksplat")

METHOD = Method(
    title="3DGS",
    paper_name="3dgs",
    paper_notes=(OTHER_LPIPS,),
    native=Native(continuous_coverage=True, sh=True, alpha_compositing=True),
    retained={"dedicated": Retained("Method-aware", "SH", soft_coverage=True, **AWARE)},
    unsupported={"standard": NO_TRIANGLES},
    settings={
        "rasterizer": SPLAT_RASTERIZER,
        "sh_degree": SPLAT_SH_DEGREE,
        "antialiased": Setting(False, "bool"),
    },
    passes={"reference": BLENDED, "dedicated": BLENDED},
    coverage="gaussian",
    primitive="gaussian",
    files=tuple(f"*{suffix}" for suffix in SUFFIXES),
    bundle=("meta.json", "means_l.webp"),
    rules=Rules(
        "3DGS",
        "graphdeco-inria/gaussian-splatting: full_eval.py, utils/camera_utils.py",
        photographs={key: rule for key, rule in FAMILY.items() if key != "dtu"},
    ),
)

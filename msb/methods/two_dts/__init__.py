"""2DTS: sorted and blended triangle soups; opacity is a Gaussian-like function of eccentricity."""

from dataclasses import replace

from msb.registry import AWARE, BAKED, BAKED_DC, BLENDED, SH_DEGREE, Method, Native, Retained, Setting
from msb.scenes.colors import BLACK, WHITE
from msb.scenes.datasets.catalog import CUSTOM
from msb.scenes.datasets.rules import Photographs, Rules

METHOD = Method(
    title="2DTS",
    paper_name="2dts",
    native=Native(continuous_coverage=True, sh=True, alpha_compositing=True),
    retained={
        "standard": replace(BAKED_DC, notes={"appearance": "ste_threshold hides faces by opacity"}),
        "dedicated": Retained("Method-aware", "SH", soft_coverage=True, **AWARE),
    },
    settings={
        "rasterizer": Setting("2D", "choice", choices=("2D", "3D")),
        "sh_degree": SH_DEGREE,
        "gamma": Setting(1.0, "float", minimum=1.0),
        "back_culling": Setting(False, "bool"),
        "gamma_rescale": Setting(False, "bool"),
        "ste_threshold": Setting(None, "float", minimum=0.0, maximum=1.0, optional=True),
        "render_up_scale": Setting(None, "int", minimum=1, maximum=16, optional=True),
    },
    passes={"reference": BLENDED, "dedicated": BLENDED, "standard": BAKED},
    coverage="gaussian_power",
    files=("ckpt/{n}.ckpt", "point_cloud/{n}.ply"),
    rules=Rules(
        "2DTS",
        "GaodeRender/triangle-splatting: src, config/*_VanillaTS.yaml",
        rounding="floor",
        resampling="bilinear",
        quantized=False,
        photographs={
            "mipnerf360/outdoor": Photographs(resolution=4),
            "mipnerf360/indoor": Photographs(resolution=2),
            "tanksandtemples": Photographs(resolution=1),
            "nerf_synthetic": Photographs(".", 1, "after_resize"),
            CUSTOM: Photographs(),
        },
        backgrounds={"": WHITE, "tanksandtemples": BLACK},
    ),
)

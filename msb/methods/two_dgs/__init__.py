"""2DGS: shown as the mesh that its TSDF fusion extracts."""

from __future__ import annotations

from msb.registry.declare import NO_APPEARANCE, OTHER_LPIPS, Method, Retained
from msb.scenes.datasets.rules import FAMILY, Rules

METHOD = Method(
    title="2DGS mesh",
    paper_name="2dgs",
    paper_notes=(OTHER_LPIPS,),
    retained={"standard": Retained("Fallback", "baked color")},
    unsupported={"reference": NO_APPEARANCE, "dedicated": NO_APPEARANCE},
    passes={"standard": ("opaque_unlit",)},
    reads_meshes=True,
    rules=Rules(
        "2DGS",
        "hbb1/2d-gaussian-splatting: scripts, utils/camera_utils.py",
        photographs=FAMILY,
    ),
)

"""MeshSplatting: triangles with shared vertices, which are nearly opaque after training."""

from msb.registry import AWARE, BAKED, BAKED_DC, BLENDED, SH_DEGREE, Method, Native, Retained, Setting
from msb.scenes.datasets.rules import FAMILY, Rules

METHOD = Method(
    title="MeshSplatting",
    paper_name="mesh_splatting",
    native=Native(connectivity=True, sh=True, alpha_compositing=True),
    retained={"standard": BAKED_DC, "dedicated": Retained("Method-aware", "SH", **AWARE)},
    settings={
        "sh_degree": SH_DEGREE,
        "supersample": Setting(4, "int", minimum=1, maximum=16),
        "opacity_floor": Setting(0.999, "float", minimum=0.0, maximum=1.0),
        "sigma": Setting(1e-4, "float", positive=True),
    },
    passes={
        "reference": (*BLENDED, "downsample"),
        "dedicated": (*BLENDED, "downsample"),
        "standard": BAKED,
    },
    coverage="edge_window",
    reads_meshes=True,
    rules=Rules(
        "MeshSplatting",
        "meshsplatting/mesh-splatting: utils/camera_utils.py",
        photographs=FAMILY,
    ),
)

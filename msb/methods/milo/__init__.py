"""MILo: Gaussians and a mesh that are optimised together. MILo's mesh is drawn with vertex colours."""

from msb.registry import extracted_mesh
from msb.scenes.datasets.rules import FULL_SIZE, Rules

METHOD = extracted_mesh(
    "MILo mesh",
    # The names follow Anttwo/MILo at 0c38aa6: mesh_extract_sdf.py, mesh_extract_integration.py,
    # mesh_extract_regular_tsdf.py.
    (
        "mesh_learnable_sdf.ply",
        "mesh_integration_sdf.ply",
        "mesh_depth_fusion_sdf.ply",
        "mesh_regular_tsdf_res{n}_post.ply",
        "mesh_regular_tsdf_res{n}.ply",
    ),
    Rules("MILo", "Anttwo/MILo: README.md, milo/utils/camera_utils.py", photographs=FULL_SIZE),
)

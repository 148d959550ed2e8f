"""Gaussian Wrapping: oriented Gaussians; we draw the extracted mesh with vertex colours."""

from msb.registry import extracted_mesh
from msb.scenes.datasets.rules import FULL_SIZE, Rules

METHOD = extracted_mesh(
    "Gaussian Wrapping mesh",
    # The names follow diego1401/GaussianWrapping at a064133: texture_mesh.py,
    # pivot_based_mesh_extraction.py, scripts. The post-processed mesh has no colours before its texture is
    # refined.
    (
        "*_texture_refined_*.ply",
        "mesh_*pivots.ply",
        "mesh_*pivots*_searched.ply",
        "mesh_*pivots*.ply",
    ),
    Rules(
        "Gaussian Wrapping",
        "diego1401/GaussianWrapping: scripts/benchmark_mip360_gw_ours.py, utils/camera_utils.py",
        photographs=FULL_SIZE,
    ),
)

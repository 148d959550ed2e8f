"""TriSplat: a network that predicts triangles from a few photographs. TriSplat's exported mesh is drawn."""

from msb.registry import extracted_mesh

METHOD = extracted_mesh(
    "TriSplat mesh",
    # The names follow ziplab/TriSplat at 6a3c9e7: README.md, src/mesh/tsdf_gs2d.py.
    (
        "mesh/DIRECT_triangle_mesh_post.ply",
        "mesh/DIRECT_triangle_mesh.ply",
    ),
    None,  # the network was trained on other datasets, with a few views per scene at 224 or 448 pixels
)

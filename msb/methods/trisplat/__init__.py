"""TriSplat: a network that gives triangles for a few photographs; shown as the mesh it exports."""

from msb.registry import extracted_mesh

METHOD = extracted_mesh(
    "TriSplat mesh",
    # ziplab/TriSplat at 6a3c9e7: README.md, src/mesh/tsdf_gs2d.py.
    (
        "mesh/DIRECT_triangle_mesh_post.ply",
        "mesh/DIRECT_triangle_mesh.ply",
    ),
    None,  # it is trained on other datasets, and reads a few views of a scene at 224 or 448 pixels
)

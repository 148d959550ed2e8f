"""Explanations of other parts of the audit, and of two flags that only the cross-check compares."""

from __future__ import annotations

from msb.topology.explain.entry import Explanation

OTHERS = (
    Explanation(
        name="topology",
        symbol="",
        title="triangle soup or indexed mesh",
        formula='"triangle_soup" if no vertex is used by two faces, else "indexed_mesh"',
        definition=(
            "Read from the indices, never from a file's claim. A face that names a vertex twice uses "
            "it once; a mesh without faces is a soup, as nothing is shared in it."
        ),
        matters=(
            "A soup renders like any mesh, but no operation that needs neighbours works on it until its "
            "vertices are welded."
        ),
        source="decided",
    ),
    Explanation(
        name="is_soup",
        symbol="is_soup",
        title="pure triangle soup",
        formula="F > 0 and every vertex is used by exactly one face, so V = 3 F",
        definition=(
            "Stricter than topology: there is no unreferenced vertex and no repeated index either. "
            "Then V/F is 3, valence 2, the boundary ratio 1 and every face a component of its own."
        ),
        matters="The numbers of a soup say only that it has no indexing; audit it welded to learn more.",
        source="decided",
    ),
    Explanation(
        name="winding_consistent",
        symbol="",
        title="neighbouring faces agree on inside and outside",
        formula="inconsistent_winding_edges = 0",
        definition=(
            "True when both faces of every two-face edge run along it in opposite directions. It does "
            "not say that normals point outwards, nor that the mesh is orientable across non-manifold "
            "edges."
        ),
        matters="When false, shading and back-face culling show seams or holes.",
        source="decided: winding is ignored everywhere else",
        special="true when there are no two-face edges",
        peers={"trimesh": "is_winding_consistent agrees; the pairs of repeated-index rows take part in it"},
    ),
    Explanation(
        name="valence_histogram",
        symbol="",
        title="vertices by number of edges",
        formula="number of edges at a vertex -> number of such vertices",
        definition="Unreferenced vertices are in it with 0. The keys weighted by the values add up to 2 E.",
        matters="A regular mesh peaks at 6; a long tail means vertices that slow down every local operation.",
        source="decided: the distribution behind mean_valence",
    ),
    Explanation(
        name="off_nonmanifold_edges",
        symbol="",
        title="non-manifold vertices away from non-manifold edges",
        formula="V_nm - V_nm_edge_endpoint",
        definition=(
            "Vertices with several fans none of which touches a non-manifold edge: bow-ties and nothing else."
        ),
        matters="It is the number to compare with PyMeshLab.",
        source="auxiliary: PyMeshLab's non_two_manifold_vertices",
        peers={"PyMeshLab": "agrees, except at vertices of repeated-index rows"},
        aliases=("variants.nonmanifold_vertices.off_nonmanifold_edges",),
    ),
    Explanation(
        name="variants",
        symbol="",
        title="the other readings of two ambiguous terms",
        formula="term -> reading -> count; the first reading of each is the headline",
        definition=(
            "nonmanifold_vertices has strict (V_nm), multifan (V_nm_multifan), edge_endpoints "
            "(V_nm_edge_endpoint) and off_nonmanifold_edges; components has all_shared_edges "
            "(components) and manifold_edges_only (components_two_face_edges)."
        ),
        matters="Numbers from other tools can be placed beside the reading they use.",
        source=(
            "the paper's text allows several readings; docs/definitions.md says how the headline was chosen"
        ),
    ),
    Explanation(
        name="welded",
        symbol="weld",
        title="the same numbers after merging vertices in one place",
        formula='"exact": equal float32 coordinates; a length: chains of vertices at most that far apart',
        definition=(
            "Off unless asked for. The exact weld merges rows whose three float32 coordinates are "
            "equal (minus zero equals zero, NaN equals nothing). A length merges whatever steps of at "
            "most that length connect, so the order does not matter. All face rows stay; collapsed "
            "ones become repeated-index rows."
        ),
        matters="For a soup it shows the surface that is there; for an indexed mesh, seams and stray copies.",
        source='decided: the paper keeps "colocated vertices" apart, and so does the audit by default',
        peers={"trimesh": "merge_vertices rounds to a grid, so close vertices may stay apart"},
    ),
    Explanation(
        name="closed",
        symbol="",
        title="every edge has exactly two faces",
        formula="E > 0 and E1 = 0 and E_gt2 = 0",
        definition="What the cross-check compares with flags of other libraries; winding does not matter.",
        matters="A closed mesh may still touch itself in vertices, or be a face stored twice.",
        source="auxiliary: for peers",
        peers={"trimesh": "is_watertight agrees; the pairs of repeated-index rows take part in it"},
    ),
    Explanation(
        name="closed_oriented",
        symbol="",
        title="closed, with consistent winding",
        formula="closed and inconsistent_winding_edges = 0",
        definition="What the cross-check compares with libraries for solids.",
        matters="Needed for volumes and boolean operations.",
        source="auxiliary: for peers",
        peers={
            "manifold3d": (
                "status NoError agrees, except that an edge with as many faces each way passes (two "
                "tetrahedra sharing an edge), and that it wants at least four vertices and faces; it "
                "crashes on some open meshes"
            )
        },
    ),
)

"""Explanations of the ratios and totals; the paper's columns come first, in their order."""

from __future__ import annotations

from msb.topology.explain.entry import KEEPS_ROWS, SECTION, Explanation

_TABLE = f'{SECTION}; table "Per-scene mesh diagnostics"'
_TWO_FACE_NOTE = (
    "joins faces across two-face edges only, which gives a largest component of 0.1 % of the faces where "
    "ours, and the paper's, holds 70 %"
)

METRICS = (
    Explanation(
        name="vf_ratio",
        symbol="v_over_f",
        title="vertices per face",
        formula="V / F",
        definition=(
            "All vertex rows over all face rows, exactly as stored. A closed triangle mesh with full vertex "
            "sharing comes to about 0.5, a triangle soup to exactly 3."
        ),
        matters=(
            "It measures reuse: a high value means more memory, more vertex work and no adjacency to "
            "walk on. It says nothing of quality, and UV seams or material borders raise it "
            "legitimately."
        ),
        source=f"{_TABLE}, column V/F",
        special="null when the mesh has no faces",
        peers={"PyMeshLab": "agrees: vertices_number / faces_number", "trimesh": "agrees with process=False"},
        aliases=("v/f",),
    ),
    Explanation(
        name="mean_valence",
        symbol="valence",
        title="average number of edges at a vertex",
        formula="2 E / V",
        definition=(
            "Every edge has two ends, so twice the number of edges over the number of vertex rows. Vertices "
            "that no face uses count with valence 0."
        ),
        matters=(
            "A closed triangulated surface comes to about 6, a soup to exactly 2. Values well above 6 mean "
            "that surfaces cross or branch; it measures density of adjacency, not correctness."
        ),
        source=f"{_TABLE}, column Valence",
        special="0 when there are vertices but no edges, null when there are no vertices",
        peers={
            "libigl": "agrees from igl.edges; repeated-index rows add edges to it",
            "PyMeshLab": "agrees from edges_number; repeated-index rows add edges to it",
            "trimesh": "agrees from edges_unique; its vertex_degree counts the same neighbours",
        },
    ),
    Explanation(
        name="boundary_edge_ratio",
        symbol="boundary_edge_ratio",
        title="share of edges with one face",
        formula="E1 / E",
        definition="Boundary edges over all edges. It is 0 for a closed mesh and 1 for a triangle soup.",
        matters=(
            "Open edges are legitimate in a partial scene, but a mesh that has them is not a solid: volume, "
            "inside and outside, printing and most collision shapes are undefined."
        ),
        source=f"{_TABLE}, column Boundary edge",
        special="null when there are no edges",
        peers={
            "libigl": "agrees: boundary_facets over edges; both also count repeated-index rows",
            "PyMeshLab": "agrees: boundary_edges over edges_number; both also count repeated-index rows",
            "trimesh": "agrees, counting edges_unique_inverse; also counts repeated-index rows",
        },
    ),
    Explanation(
        name="nonmanifold_edge_ratio",
        symbol="nm_edge_ratio",
        title="share of edges with more than two faces",
        formula="E_gt2 / E",
        definition=(
            "Edges that three or more faces share, over all edges. Duplicated faces count each time; the "
            "direction in which a face runs along the edge does not matter."
        ),
        matters=(
            "At such an edge the surface branches, so there is no inside, no consistent normal and no way to "
            "unfold. Subdivision, remeshing and half-edge tools refuse or split the mesh; unwrapping cuts it."
        ),
        source=f"{_TABLE}, column Non-manif. edge (lower is better)",
        special="null when there are no edges",
        peers={
            "libigl": "agrees by the group sizes of unique_edge_map; is_edge_manifold alone is only a flag",
            "PyMeshLab": (
                "agrees in the first four calls of a process only; from the fifth on "
                "non_two_manifold_edges is the sum of the faces at those edges"
            ),
            "trimesh": "agrees by counts above 2 of edges_unique_inverse",
        },
    ),
    Explanation(
        name="nonmanifold_vertex_ratio",
        symbol="nm_vertex_ratio",
        title="share of vertices whose faces do not form one fan",
        formula="V_nm / V",
        definition=(
            "Vertices around which the faces do not form exactly one open or closed fan, over all "
            "vertex rows. A fan is walked across ordinary two-face edges, so both kinds count: "
            "bow-ties, where surfaces touch in a point, and ends of non-manifold edges."
        ),
        matters=(
            "Normals, curvature, UVs, subdivision, remeshing and collision all assume a disk around each "
            "vertex. Where there is none, these tools fail, split the vertex or give arbitrary results."
        ),
        source=(
            f"{_TABLE}, column Non-manif. vertex (lower is better); of the readings its text allows, "
            "the strict one fits the printed values with an RMS error of 0.025, the next one with "
            "0.22 (docs/definitions.md)"
        ),
        special="null when there are no vertices; a vertex no face uses is not non-manifold",
        peers={
            "libigl": (
                "is_vertex_manifold counts bow-ties only (multifan_vertices): 0 for a three-page book, where "
                "ours is 2; with the endpoints of non-manifold edges added it agrees"
            ),
            "PyMeshLab": (
                "non_two_manifold_vertices leaves out every vertex on a non-manifold edge; with our "
                "nonmanifold_edge_endpoints added it agrees"
            ),
            "trimesh": "has no such count",
            "NetworkX": "agrees when given the vertex links as a graph",
        },
    ),
    Explanation(
        name="lcc_face_ratio",
        symbol="lcc_face",
        title="share of faces in the largest connected piece",
        formula="LCC_faces / F",
        definition=(
            "Faces of the edge-connected component with most faces, over all face rows. Equally large "
            "ones are told apart by their area, then by the smallest face number."
        ),
        matters=(
            "Near 1, the mesh can be handled as one object. A low value means debris or fragments "
            "that must be filtered or processed one by one. It says nothing of self-intersections."
        ),
        source=f"{_TABLE}, column LCC face (higher is better)",
        special="null when no face has three different indices; repeated-index rows stay in F",
        peers={
            "libigl": f"facet_components {KEEPS_ROWS}",
            "trimesh": f"split(only_watertight=False) {_TWO_FACE_NOTE}",
            "NetworkX": "agrees when given the face graph",
        },
    ),
    Explanation(
        name="lcc_area_ratio",
        symbol="lcc_area",
        title="share of the area in the largest connected piece",
        formula="LCC_area / total_area",
        definition=(
            "Area of the component that lcc_face_ratio is about, over the area of all faces: the "
            "component with most faces, even where another has more area. Both are added in the order of the "
            "faces, so it is never above 1, and is 1 where the other components have no area."
        ),
        matters="Beside lcc_face_ratio it tells whether the fragments are tiny or cover real surface.",
        source=(
            f"{_TABLE}, column LCC area (higher is better); that it is of the same component is decided here"
        ),
        special="null when no face has three different indices, or when the total area is 0",
        peers={"libigl": "agrees: doublearea / 2 by facet_components; NaN if any coordinate used is NaN"},
    ),
    Explanation(
        name="euler_characteristic",
        symbol="euler",
        title="Euler characteristic",
        formula="V - E + F",
        definition=(
            "Vertex rows minus edges plus face rows, of everything stored. For a closed manifold mesh with "
            "every vertex used it is 2 per body minus 2 per handle."
        ),
        matters=(
            "On a clean mesh it tells how many holes and handles there are. On any other it only "
            "fingerprints the mesh: unused vertices and repeated-index rows count too."
        ),
        source="decided: over all rows, as V and F are everywhere else here",
        special="repeated-index rows add to F and not to E; unreferenced vertices add to V",
        peers={
            "libigl": "takes the largest index used plus one for V, and counts edges of repeated-index rows",
            "trimesh": "takes only vertices that a face uses for V, and counts edges of repeated-index rows",
        },
    ),
    Explanation(
        name="total_area",
        symbol="total_area",
        title="area of all faces",
        formula="sum over faces of |(b - a) x (c - a)| / 2",
        definition=(
            "Half the norm of the cross product of two sides, in double precision, summed over all faces; "
            "squared length units of the file. Duplicated faces count each time."
        ),
        matters="It is the denominator of lcc_area_ratio and gives the scale of the scene.",
        source="decided: double precision, so that sums of millions of small faces stay exact to 1e-9",
        special="a face whose area is not finite adds 0 and is counted in nonfinite_faces",
        peers={
            "libigl": "agrees to rounding: doublearea / 2; NaN if any coordinate used is NaN",
            "trimesh": "agrees to rounding: area; NaN if any coordinate used is NaN",
        },
    ),
    Explanation(
        name="largest_component_area",
        symbol="LCC_area",
        title="area of the largest connected piece",
        formula="sum of the areas of the LCC_faces faces",
        definition=(
            "Area of the edge-connected component with most faces, in squared length units of the file."
        ),
        matters="It is the numerator of lcc_area_ratio.",
        source="decided: reported so that the ratio can be recomputed",
        special="0 when no face has three different indices",
        peers={"libigl": "agrees: doublearea / 2 by facet_components; NaN if any coordinate used is NaN"},
    ),
)

"""Explanations of the audit's integer counts."""

from __future__ import annotations

from msb.topology.explain.entry import KEEPS_ROWS, SECTION, Explanation

COUNTS = (
    Explanation(
        name="vertices",
        symbol="V",
        title="vertex rows",
        formula="number of rows of the position array",
        definition=(
            "Every stored vertex, whether a face uses it or not. Vertices in the same place are not "
            "merged: two rows are two vertices."
        ),
        matters=(
            "It is the denominator of vf_ratio, mean_valence and nonmanifold_vertex_ratio, and the memory."
        ),
        source=f"decided: {SECTION} averages over all of |V|, so that 2 E / V holds literally",
        peers={
            "PyMeshLab": "agrees: vertices_number",
            "trimesh": "agrees with process=False; merges otherwise",
        },
    ),
    Explanation(
        name="referenced_vertices",
        symbol="V_referenced",
        title="vertices that a proper face uses",
        formula="vertices in at least one row with three different indices",
        definition=(
            "Vertex rows that occur in some face without a repeated index. Together with "
            "unreferenced_vertices it makes V."
        ),
        matters="The rest could be dropped without changing the surface.",
        source="decided: reported beside V, because exporters differ in whether they drop unused vertices",
        peers={"trimesh": "also counts vertices that occur in repeated-index rows only"},
    ),
    Explanation(
        name="unreferenced_vertices",
        symbol="V_unreferenced",
        title="vertices that no proper face uses",
        formula="V - V_referenced",
        definition=(
            "Vertex rows in no face without a repeated index. They count in V and in every ratio over V, and "
            "have no link: they are not non-manifold."
        ),
        matters=(
            "Wasted memory, and bounding boxes that are too large. The MeshSplatting trainer removes them "
            "before it saves."
        ),
        source="decided: kept in V, reported apart",
        peers={
            "PyMeshLab": "vertices that occur in repeated-index rows only are referenced to it",
            "libigl": "takes those below the largest used index for non-manifold vertices",
        },
    ),
    Explanation(
        name="faces",
        symbol="F",
        title="face rows",
        formula="number of rows of the index array",
        definition="Every stored triangle, including duplicates, repeated-index rows and faces without area.",
        matters="It is what a renderer pays for, and the denominator of vf_ratio and lcc_face_ratio.",
        source=f'{SECTION}: fractions "of total faces"',
        peers={"PyMeshLab": "agrees: faces_number", "trimesh": "agrees with process=False"},
    ),
    Explanation(
        name="repeated_index_faces",
        symbol="F_repeated_index",
        title="faces that name a vertex twice",
        formula="rows (a, b, c) with a = b, b = c or a = c",
        definition=(
            "Triangles collapsed to a segment or a point by their indices. They stay in F, but have "
            "no edges, no fans and no component: (a, b, b) would otherwise supply the edge a-b twice "
            "and turn a neighbour's boundary edge into a three-face edge."
        ),
        matters="They draw nothing. Many tools count them as faces, some hang or crash on them.",
        source=f"{SECTION}: excluded from the component graph; that they have no edges is decided here",
        peers={
            "libigl": "keeps their vertex pairs and counts them as components",
            "PyMeshLab": (
                "keeps their vertex pairs; a row (a, b, a) makes its topological measures loop for ever"
            ),
            "trimesh": "keeps their vertex pairs, loops included",
            "manifold3d": "drops them",
        },
    ),
    Explanation(
        name="zero_area_faces",
        symbol="F_zero_area",
        title="faces without area",
        formula="rows with three different indices and area exactly 0",
        definition=(
            "Triangles whose corners lie on a line or in a point, judged by the double-precision "
            "area. They are full members of the topology."
        ),
        matters="They draw nothing and have no normal; tools that divide by the area get NaN from them.",
        source="decided: advisory; a threshold would depend on the scale of the scene",
        special="repeated-index rows are not counted here, nor are faces whose area is not finite",
    ),
    Explanation(
        name="nonfinite_faces",
        symbol="F_nonfinite",
        title="faces with a NaN or infinite area",
        formula="rows whose area is not finite",
        definition=(
            "Triangles with a NaN or infinite coordinate, or so large that the area overflows double "
            "precision. Topology does not look at coordinates, so only areas are affected: such a "
            "face adds 0."
        ),
        matters="The model diverged in training, or the file is damaged; renderers and exports refuse it.",
        source="decided: counted by the audit, an error to validate, export and the renderers",
        peers={"libigl": "total area becomes NaN", "trimesh": "total area becomes NaN"},
    ),
    Explanation(
        name="duplicate_faces",
        symbol="F_duplicate_extra",
        title="faces that repeat an earlier one",
        formula="rows beyond the first of each set with the same three indices",
        definition=(
            "Two rows are duplicates when they hold the same indices in any order or winding. All are "
            "kept and counted everywhere: a face stored twice makes its edges two-face edges."
        ),
        matters=(
            "They cost rendering time, flicker where their colours differ, and make open edges look closed."
        ),
        source="decided: nothing is removed before counting",
        peers={"manifold3d": "refuses a mesh with a face stored twice in the same winding"},
    ),
    Explanation(
        name="edges",
        symbol="E",
        title="edges",
        formula="distinct unordered pairs of vertices next to each other in a proper face",
        definition=(
            "Every pair of vertices that some face without a repeated index joins, counted once however many "
            "faces share it and whichever way they run along it."
        ),
        matters="It is the denominator of boundary_edge_ratio and nonmanifold_edge_ratio.",
        source=f"{SECTION}; that repeated-index rows have none is decided here",
        peers={
            "libigl": "igl.edges agrees; a lone repeated-index row (0, 1, 1) gives 1",
            "PyMeshLab": "edges_number agrees; a lone (0, 1, 1) gives 2",
            "trimesh": "edges_unique agrees; a lone (0, 1, 1) gives 2",
            "NetworkX": "agrees as a graph of vertices",
        },
    ),
    Explanation(
        name="boundary_edges",
        symbol="E1",
        title="open edges",
        formula="edges with exactly one face",
        definition="Edges that a single face has: the rim of a hole, or the outline of an open sheet.",
        matters="A mesh with any is not a solid. Legitimate in partial scenes.",
        source=SECTION,
        peers={
            "libigl": f"boundary_facets {KEEPS_ROWS}",
            "PyMeshLab": f"boundary_edges {KEEPS_ROWS}",
            "trimesh": f"count of 1 in edges_unique_inverse {KEEPS_ROWS}",
        },
    ),
    Explanation(
        name="manifold_edges",
        symbol="E2",
        title="ordinary edges",
        formula="edges with exactly two faces",
        definition="Edges that two faces share, whichever way each of them runs along it.",
        matters="Only across these can a surface be walked, unfolded or subdivided without a choice.",
        source=SECTION,
        peers={"libigl": f"unique_edge_map {KEEPS_ROWS}", "trimesh": f"edges_unique_inverse {KEEPS_ROWS}"},
    ),
    Explanation(
        name="nonmanifold_edges",
        symbol="E_gt2",
        title="edges where surfaces branch",
        formula="edges with more than two faces",
        definition=(
            "Edges that three or more faces share. A face stored three times has three of them; a book of n "
            "pages has one, its spine."
        ),
        matters="Each is a place where a surface has no single other side: tools refuse it, cut it or guess.",
        source=SECTION,
        peers={
            "libigl": f"unique_edge_map {KEEPS_ROWS}; is_edge_manifold is only a flag",
            "PyMeshLab": (
                "non_two_manifold_edges agrees in the first four calls of a process, and is the sum of "
                "multiplicities from the fifth on: the cross-check asks it in a fresh process"
            ),
            "trimesh": f"count above 2 in edges_unique_inverse {KEEPS_ROWS}",
        },
    ),
    Explanation(
        name="max_edge_faces",
        symbol="E_max_faces",
        title="most faces at one edge",
        formula="largest number of faces that share an edge",
        definition="The size of the largest group of faces at one edge; 2 at most on a manifold mesh.",
        matters=(
            "It tells a few branching sheets from faces piled onto one edge, which slows many tools down."
        ),
        source="decided: not in the paper",
        special="0 when there are no edges",
        peers={"libigl": f"unique_edge_map {KEEPS_ROWS}", "trimesh": f"edges_unique_inverse {KEEPS_ROWS}"},
    ),
    Explanation(
        name="nonmanifold_vertices",
        symbol="V_nm",
        title="vertices whose faces do not form one fan",
        formula="vertices whose link is not exactly one path or one cycle",
        definition=(
            "The link of a vertex has a node for each edge at it and an arc for each face. One path "
            "is an open fan, one cycle a closed fan; anything else is non-manifold. Equivalently: "
            "more than one fan across two-face edges, or: a bow-tie or an end of a non-manifold edge."
        ),
        matters="Each is a place where normals, UVs, subdivision and collision have no single answer.",
        source=(
            f'{SECTION}: "fail to form one connected fan"; the strict reading, fitted to the printed values'
        ),
        special=(
            "a vertex without faces is not counted; the two copies of a face stored twice form one closed fan"
        ),
        peers={
            "libigl": (
                "is_vertex_manifold joined with the endpoints of non-manifold edges agrees; alone it is less"
            ),
            "PyMeshLab": "non_two_manifold_vertices = V_nm - V_nm_edge_endpoint exactly",
            "NetworkX": "agrees when given the vertex links as a graph",
        },
        aliases=("variants.nonmanifold_vertices", "variants.nonmanifold_vertices.strict", "strict"),
    ),
    Explanation(
        name="multifan_vertices",
        symbol="V_nm_multifan",
        title="bow-tie vertices",
        formula="vertices whose faces, joined through any shared edge there, stay in several groups",
        definition=(
            "The weaker reading of a non-manifold vertex: faces that meet at a non-manifold edge "
            "count as joined, so the ends of a book's spine are not counted. What is left is surfaces "
            "touching in a point."
        ),
        matters="Splitting the vertex repairs it, unless it also lies on a non-manifold edge.",
        source="auxiliary: what most libraries call a non-manifold vertex",
        peers={
            "libigl": "is_vertex_manifold agrees once unreferenced vertices are taken out",
            "PyMeshLab": "leaves out those that are also on a non-manifold edge",
            "NetworkX": "agrees: vertex links in several pieces",
        },
        aliases=("variants.nonmanifold_vertices.multifan", "bow_ties"),
    ),
    Explanation(
        name="nonmanifold_edge_endpoints",
        symbol="V_nm_edge_endpoint",
        title="vertices on a non-manifold edge",
        formula="vertices that are an end of an edge with more than two faces",
        definition="Each vertex once, however many non-manifold edges end in it. All of them are in V_nm.",
        matters="They cannot be repaired at the vertex: the edge must be taken apart.",
        source="auxiliary: with multifan_vertices it makes up V_nm",
        peers={"libigl": "agrees: the vertices of crowded groups of unique_edge_map"},
        aliases=("variants.nonmanifold_vertices.edge_endpoints",),
    ),
    Explanation(
        name="inconsistent_winding_edges",
        symbol="",
        title="edges across which the winding flips",
        formula="two-face edges that both faces run along in the same direction",
        definition=(
            "Neighbouring faces agree on inside and outside when they run along their common edge in "
            "opposite directions. Edges with one face or more than two are not looked at."
        ),
        matters="Normals flip across it: shading shows seams, back-face culling shows holes.",
        source="decided: reported apart, because winding is ignored everywhere else",
        peers={"trimesh": "is_winding_consistent tells only whether there is one"},
    ),
    Explanation(
        name="boundary_loops",
        symbol="",
        title="closed rims",
        formula="cycles of boundary edges that follow each other around boundary fans",
        definition=(
            "Two boundary edges follow each other where one open fan has both as its sides. Followed to the "
            "end they close to a loop, or stop at a non-manifold edge (open_boundary_chains). Where several "
            "fans meet in one vertex, their loops touch but stay apart."
        ),
        matters=(
            "On a manifold mesh it is the number of holes to fill, the outline of an open sheet included."
        ),
        source=(
            "decided: not in the paper; the usual definition on manifold meshes, made exact for all others"
        ),
        peers={
            "libigl": "boundary_loop_all agrees on manifold meshes with consistent winding, and only there",
            "PyMeshLab": "number_holes agrees on manifold meshes and is -1 on others",
        },
    ),
    Explanation(
        name="open_boundary_chains",
        symbol="",
        title="rims that end at a non-manifold edge",
        formula="paths of boundary edges that do not close",
        definition=(
            "Runs of boundary edges whose last fan has a non-manifold edge as its other side. A book "
            "of three pages has three, the outline of each page."
        ),
        matters="Hole filling cannot follow these.",
        source="decided: see boundary_loops",
        special="0 on a mesh without non-manifold edges",
    ),
    Explanation(
        name="components",
        symbol="components",
        title="connected pieces",
        formula="connected components of the faces, adjacent when they share a whole edge",
        definition=(
            "Faces are joined across every shared edge, however many faces share it; touching in a "
            "corner does not join. Every piece counts, a single face too; repeated-index rows are "
            "left out."
        ),
        matters=(
            "Many pieces mean debris: each must be selected, unwrapped, simplified or deleted on its own."
        ),
        source=(
            f"{SECTION}; that non-manifold edges join is fitted: joining across two-face edges only "
            "would give the paper's meshes a largest component of 0.1 %, not 70 %"
        ),
        special="0 when no face has three different indices",
        peers={
            "libigl": f"facet_components {KEEPS_ROWS}",
            "PyMeshLab": f"connected_components_number {KEEPS_ROWS}",
            "trimesh": (
                "body_count joins through vertices (1 for a bow-tie, ours 2) and counts unreferenced "
                "vertices; split joins across two-face edges only"
            ),
            "NetworkX": "agrees, joining consecutive faces of each edge",
        },
        aliases=("variants.components", "variants.components.all_shared_edges"),
    ),
    Explanation(
        name="components_manifold_edges",
        symbol="components_two_face_edges",
        title="pieces joined across ordinary edges only",
        formula="connected components of the faces, adjacent when they share a two-face edge",
        definition=(
            "The same as components, but a non-manifold edge joins nothing: a book of three pages is three."
        ),
        matters="It is the number of pieces after cutting the mesh open at every branching edge.",
        source="auxiliary: the other reading, and what trimesh counts",
        special="0 when no face has three different indices",
        peers={
            "trimesh": f"face_adjacency {KEEPS_ROWS}",
            "NetworkX": "agrees",
        },
        aliases=("variants.components.manifold_edges_only",),
    ),
    Explanation(
        name="largest_component_faces",
        symbol="LCC_faces",
        title="faces in the largest connected piece",
        formula="most faces of any component",
        definition=(
            "Size of the component with most faces; of equally large ones the one with more area, "
            "then the one holding the smallest face number."
        ),
        matters="What is left if only the main piece is kept.",
        source=f"{SECTION}; that faces decide and not area is decided here, as the graph is over faces",
        special="0 when no face has three different indices",
        peers={"libigl": f"the largest of facet_components {KEEPS_ROWS}", "NetworkX": "agrees"},
        aliases=("lcc",),
    ),
)

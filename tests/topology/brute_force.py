"""A second implementation of the audit, with dictionaries and loops instead of NumPy, written from the
definitions.

It is slow and simple on purpose, and shares neither code nor methods with msb/topology. The strict count
tests whether each vertex link is one path or one cycle. Components are found by flooding, and boundary loops
by walking from fan to fan.
"""

import math
from typing import Any

import pytest

Face = tuple[int, int, int]
Point = tuple[float, float, float]


def audit(points: list[Point], faces: list[Face]) -> dict[str, Any]:
    """Return every field of Counts and Metrics, and further findings of the audit, by JSON name."""
    proper = [f for f, row in enumerate(faces) if len(set(row)) == 3]
    faces_at_edge = edge_faces(faces, proper)
    corners: dict[int, list[int]] = {}
    for f in proper:
        for v in faces[f]:
            corners.setdefault(v, []).append(f)
    areas = [area(points, row) for row in faces]
    component = flood(proper, faces, faces_at_edge, lambda count: count > 1)
    two_face = flood(proper, faces, faces_at_edge, lambda count: count == 2)
    largest = largest_component(component, areas)
    lcc_area = sum(areas[f] for f in largest if math.isfinite(areas[f]))
    total = sum(a for a in areas if math.isfinite(a))
    ends = {v for edge, group in faces_at_edge.items() if len(group) > 2 for v in edge}
    strict = {v for v in corners if not link_is_path_or_cycle(link(v, corners[v], faces))}
    multifan = {v for v in corners if len(pieces(link(v, corners[v], faces))) > 1}
    sizes = [len(group) for group in faces_at_edge.values()]
    loops, chains = boundary(faces, faces_at_edge)
    n_v, n_f, n_e = len(points), len(faces), len(faces_at_edge)
    degrees = [sum(v in edge for edge in faces_at_edge) for v in range(n_v)]
    return {
        "vertices": n_v,
        "referenced_vertices": len(corners),
        "unreferenced_vertices": n_v - len(corners),
        "faces": n_f,
        "repeated_index_faces": n_f - len(proper),
        "zero_area_faces": sum(areas[f] == 0 for f in proper),
        "nonfinite_faces": sum(not math.isfinite(a) for a in areas),
        "duplicate_faces": n_f - len({tuple(sorted(row)) for row in faces}),
        "edges": n_e,
        "boundary_edges": sizes.count(1),
        "manifold_edges": sizes.count(2),
        "nonmanifold_edges": sum(size > 2 for size in sizes),
        "max_edge_faces": max(sizes, default=0),
        "nonmanifold_vertices": len(strict),
        "multifan_vertices": len(multifan),
        "nonmanifold_edge_endpoints": len(ends),
        "inconsistent_winding_edges": winding_flips(faces, faces_at_edge),
        "boundary_loops": loops,
        "open_boundary_chains": chains,
        "components": len(set(component.values())),
        "components_manifold_edges": len(set(two_face.values())),
        "largest_component_faces": len(largest),
        "seam_vertices": 0,  # seams need UVs or colours
        "vf_ratio": ratio(n_v, n_f),
        "mean_valence": ratio(2 * n_e, n_v),
        "boundary_edge_ratio": ratio(sizes.count(1), n_e),
        "nonmanifold_edge_ratio": ratio(sum(size > 2 for size in sizes), n_e),
        "nonmanifold_vertex_ratio": ratio(len(strict), n_v),
        "lcc_face_ratio": ratio(len(largest), n_f) if largest else None,
        "lcc_area_ratio": lcc_area / total if largest and total > 0 else None,
        "euler_characteristic": n_v - n_e + n_f,
        "total_area": total,
        "largest_component_area": lcc_area,
        "valence_histogram": {d: degrees.count(d) for d in set(degrees)},
        "is_soup": n_f > 0 and n_v == 3 * n_f and len({v for row in faces for v in row}) == n_v,
        "topology": "indexed_mesh" if vertex_is_shared(faces) else "triangle_soup",
    }


def assert_agrees(report: Any, points: Any, faces: Any) -> dict[str, Any]:
    """Assert that an audit equals the result of this module, with real numbers equal to 1e-9.

    Return the result.
    """
    expected = audit([tuple(p) for p in points.tolist()], [tuple(f) for f in faces.tolist()])
    got = {**vars(report.counts), **vars(report.metrics)}
    got |= {key: getattr(report, key) for key in ("valence_histogram", "is_soup", "topology")}
    assert set(got) == set(expected)
    for key, value in expected.items():
        wanted = pytest.approx(value, rel=1e-9) if isinstance(value, float) else value
        assert got[key] == wanted, (key, faces.tolist(), points.tolist())
    return expected


def edge_faces(faces: list[Face], proper: list[int]) -> dict[tuple[int, int], list[int]]:
    """Return the faces at each edge."""
    faces_of: dict[tuple[int, int], list[int]] = {}
    for f in proper:
        a, b, c = faces[f]
        for u, w in ((a, b), (b, c), (c, a)):
            faces_of.setdefault((min(u, w), max(u, w)), []).append(f)
    return faces_of


def area(points: list[Point], row: Face) -> float:
    """Return half the norm of the cross product of two sides."""
    a, b, c = (points[v] for v in row)
    p = [b[i] - a[i] for i in range(3)]
    q = [c[i] - a[i] for i in range(3)]
    cross = (p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0])
    return 0.5 * math.sqrt(sum(x * x for x in cross)) if all(map(math.isfinite, cross)) else math.nan


def flood(proper: list[int], faces: list[Face], faces_at_edge: Any, joins: Any) -> dict[int, int]:
    """Return for each proper face the lowest face that is connected to it across edges for which `joins` is
    true.
    """
    label: dict[int, int] = {}
    for start in proper:
        if start in label:
            continue
        label[start] = start
        todo = [start]
        while todo:
            a, b, c = faces[todo.pop()]
            for u, w in ((a, b), (b, c), (c, a)):
                group = faces_at_edge[min(u, w), max(u, w)]
                if joins(len(group)):
                    for other in group:
                        if other not in label:
                            label[other] = start
                            todo.append(other)
    return label


def largest_component(component: dict[int, int], areas: list[float]) -> list[int]:
    """Return the faces of the component with most faces.

    Of equal ones, the larger area wins, then the lowest face.
    """
    groups: dict[int, list[int]] = {}
    for face, label in component.items():
        groups.setdefault(label, []).append(face)

    def rank(label: int) -> tuple[int, float, int]:
        held = sum(areas[f] for f in sorted(groups[label]) if math.isfinite(areas[f]))
        return len(groups[label]), held, -label

    return sorted(groups[max(groups, key=rank)]) if groups else []


def link(vertex: int, around: list[int], faces: list[Face]) -> list[tuple[int, int]]:
    """Return the arcs of the link of a vertex. An arc is the two other vertices of a face."""
    arcs = []
    for f in around:
        a, b = (v for v in faces[f] if v != vertex)
        arcs.append((a, b))
    return arcs


def pieces(arcs: list[tuple[int, int]]) -> list[set[int]]:
    """Return the connected pieces of a graph as sets of nodes."""
    groups: list[set[int]] = []
    for arc in arcs:
        joined = set(arc)
        apart = []
        for piece in groups:
            if piece & joined:
                joined |= piece
            else:
                apart.append(piece)
        groups = [*apart, joined]
    return groups


def link_is_path_or_cycle(arcs: list[tuple[int, int]]) -> bool:
    """Return whether a walk uses every arc exactly once. It begins at an end, or at any node of a cycle."""
    degree: dict[int, int] = {}
    for arc in arcs:
        for node in arc:
            degree[node] = degree.get(node, 0) + 1
    if max(degree.values()) > 2:
        return False
    left = list(arcs)
    here = next((node for node, d in degree.items() if d == 1), arcs[0][0])
    while True:
        step = next((arc for arc in left if here in arc), None)
        if step is None:
            return not left
        left.remove(step)
        here = step[0] if step[1] == here else step[1]


def ratio(part: float, whole: float) -> float | None:
    """Return the quotient, or None for a zero denominator."""
    return part / whole if whole else None


def winding_flips(faces: list[Face], faces_at_edge: dict[tuple[int, int], list[int]]) -> int:
    """Return the number of two-face edges along which both faces run in the same direction."""
    pairs = [(edge, group) for edge, group in faces_at_edge.items() if len(group) == 2]
    return sum(
        runs_along(faces[first], edge) == runs_along(faces[second], edge) for edge, (first, second) in pairs
    )


def runs_along(row: Face, edge: tuple[int, int]) -> bool:
    """Return whether the face runs along the edge from its low to its high vertex."""
    a, b, c = row
    return edge in ((a, b), (b, c), (c, a))


def boundary(faces: list[Face], faces_at_edge: dict[tuple[int, int], list[int]]) -> tuple[int, int]:
    """Return the numbers of closed loops and open chains of boundary edges, found by walking around fans."""
    rims = [edge for edge, group in faces_at_edge.items() if len(group) == 1]
    seen: set[tuple[int, int]] = set()
    loops = chains = 0
    for start in rims:
        if start in seen:
            continue
        closed = False
        for first in start:  # walk in both directions, unless the first walk returns to the start
            edge, vertex = start, first
            while not closed:
                seen.add(edge)
                after = follower(edge, vertex, faces, faces_at_edge)
                if after is None:
                    break
                closed = after == start
                edge, vertex = after, next(v for v in after if v != vertex)
        loops, chains = loops + closed, chains + (not closed)
    return loops, chains


def follower(
    edge: tuple[int, int], vertex: int, faces: list[Face], faces_at_edge: dict[tuple[int, int], list[int]]
) -> tuple[int, int] | None:
    """Return the boundary edge at the other end of the fan at `vertex` that begins with a boundary edge."""
    (face,) = faces_at_edge[edge]
    while True:
        apex = next(v for v in faces[face] if v not in edge)
        edge = (min(vertex, apex), max(vertex, apex))
        group = faces_at_edge[edge]
        if len(group) == 1:
            return edge
        if len(group) > 2:
            return None
        face = group[1] if group[0] == face else group[0]


def vertex_is_shared(faces: list[Face]) -> bool:
    """Return whether two faces use a common vertex."""
    use: dict[int, int] = {}
    for row in faces:
        for v in set(row):
            use[v] = use.get(v, 0) + 1
    return any(count > 1 for count in use.values())

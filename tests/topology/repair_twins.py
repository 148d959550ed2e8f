"""A second implementation of the repair steps, with dictionaries and loops, written from docs/repair.md."""

import math
from itertools import combinations
from typing import Any

from tests.topology.brute_force import Face, Point, area, edge_faces, flood, runs_along

# A face and one of its vertices.
Corner = tuple[int, int]


def proper_faces(faces: list[Face]) -> list[int]:
    return [f for f, row in enumerate(faces) if len(set(row)) == 3]


def winding_clashes(first: Face, second: Face, edge: tuple[int, int]) -> bool:
    """Return whether both faces run along the edge in the same direction."""
    return runs_along(first, edge) == runs_along(second, edge)


def orient(faces: list[Face]) -> tuple[list[bool], bool]:
    """Return which faces are turned, and whether a component is one-sided.

    The faces to turn are arbitrary in a one-sided component.
    """
    proper = proper_faces(faces)
    at_edge = edge_faces(faces, proper)
    turned, strange = [False] * len(faces), False
    component = flood(proper, faces, at_edge, lambda count: count == 2)
    for start in set(component.values()):
        side, todo = {start: False}, [start]
        while todo:
            face = todo.pop()
            for edge, group in at_edge.items():
                if len(group) != 2 or face not in group:
                    continue
                other = group[1] if group[0] == face else group[0]
                wanted = side[face] ^ winding_clashes(faces[face], faces[other], edge)
                if other not in side:
                    side[other] = wanted
                    todo.append(other)
                strange |= side[other] != wanted
        minority = 2 * sum(side.values()) > len(side)
        for face, other_side in side.items():
            turned[face] = other_side ^ minority
    return turned, strange


def glue(faces: list[Face], joined: list[tuple[tuple[int, int], int, int]]) -> dict[Corner, int]:
    """Return the new vertex of each corner if faces stay together only at the joined triples (edge, face,
    face).
    """
    proper = proper_faces(faces)
    leader: dict[Corner, Corner] = {(f, v): (f, v) for f in proper for v in faces[f]}

    def find(corner: Corner) -> Corner:
        while leader[corner] != corner:
            corner = leader[corner]
        return corner

    for edge, near, far in joined:
        for v in edge:
            leader[find((near, v))] = find((far, v))
    number: dict[Corner, int] = {}
    taken: set[int] = set()
    copies = 1 + max((v for row in faces for v in row), default=-1)
    result: dict[Corner, int] = {}
    for f in proper:
        for v in faces[f]:
            root = find((f, v))
            if root not in number:
                number[root] = v if v not in taken else copies
                copies += v in taken
                taken.add(v)
            result[f, v] = number[root]
    return result


def two_face_joints(faces: list[Face]) -> list[tuple[tuple[int, int], int, int]]:
    at_edge = edge_faces(faces, proper_faces(faces))
    return [(edge, *group) for edge, group in at_edge.items() if len(group) == 2]


def cut(faces: list[Face]) -> dict[Corner, int]:
    return glue(faces, two_face_joints(faces))


def pair(points: list[Point], faces: list[Face], colors: list[Point], weight: float) -> dict[Corner, int]:
    """Return the new vertex of each corner after pairing. All costs must be different."""
    at_edge = edge_faces(faces, proper_faces(faces))
    chosen: list[tuple[float, tuple[int, int], int, int]] = []
    for edge, group in at_edge.items():
        if len(group) > 2:
            costs = sorted(
                (fold(points, faces, edge, near, far, colors, weight), near, far)
                for near, far in combinations(group, 2)
            )
            free = set(group)
            for cost, near, far in costs:
                if {near, far} <= free:
                    free -= {near, far}
                    chosen.append((cost, edge, near, far))
    joints = two_face_joints(faces)
    # Kruskal's algorithm, with the side of each face relative to its leader.
    leader = {f: (f, False) for f in range(len(faces))}

    def find(face: int) -> tuple[int, bool]:
        side = False
        while leader[face][0] != face:
            face, flip = leader[face]
            side ^= flip
        return face, side

    for edge, near, far in joints:
        (a, side_a), (b, side_b) = find(near), find(far)
        if a != b:
            leader[a] = (b, side_a ^ side_b ^ winding_clashes(faces[near], faces[far], edge))
    kept = []
    for _, edge, near, far in sorted(chosen):
        (a, side_a), (b, side_b) = find(near), find(far)
        clash = winding_clashes(faces[near], faces[far], edge)
        if a != b:
            leader[a] = (b, side_a ^ side_b ^ clash)
        if a != b or side_a ^ side_b == clash:
            kept.append((edge, near, far))
    new = glue(faces, joints + kept)
    crowd: dict[Any, int] = {}
    for (u, w), group in at_edge.items():
        for f in group:
            ends = new[f, u], new[f, w]
            crowd[ends] = crowd.get(ends, 0) + 1
    alone = [(e, near, far) for e, near, far in kept if crowd[new[near, e[0]], new[near, e[1]]] == 2]
    return glue(faces, joints + alone)


def fold(
    points: list[Point],
    faces: list[Face],
    edge: tuple[int, int],
    near: int,
    far: int,
    colors: list[Point],
    weight: float,
) -> float:
    """Return the cost of joining two faces: 0 if flat and of equal colour, 1 if folded."""
    low, high = (points[v] for v in edge)
    along = unit([h - g for h, g in zip(high, low, strict=True)])
    sides, apexes = [], []
    for face in (near, far):
        apex = next(v for v in faces[face] if v not in edge)
        apexes.append(apex)
        out = [x - y for x, y in zip(points[apex], low, strict=True)]
        height = sum(x * y for x, y in zip(out, along, strict=True))
        sides.append(unit([x - height * y for x, y in zip(out, along, strict=True)]))
    angle = sum(x * y for x, y in zip(*sides, strict=True))
    return (1 + angle) / 2 + weight * math.dist(colors[apexes[0]], colors[apexes[1]]) / math.sqrt(3)


def unit(vector: list[float]) -> list[float]:
    size = math.hypot(*vector)
    return [x / size for x in vector] if size else [0.0] * 3


def fewest_dropped(faces: list[Face]) -> int:
    """Return the smallest number of removed faces for which no edge has more than two faces.

    All sets are tried.
    """
    proper = proper_faces(faces)
    crowded = {f for group in edge_faces(faces, proper).values() if len(group) > 2 for f in group}
    for count in range(len(crowded) + 1):
        for gone in combinations(sorted(crowded), count):
            left = [f for f in proper if f not in gone]
            if all(len(group) <= 2 for group in edge_faces(faces, left).values()):
                return count
    raise AssertionError


def weld(points: list[Point], faces: list[Face]) -> tuple[list[int], list[Face]]:
    """Return the remaining faces. A corner is the lowest old vertex in its position."""
    first: dict[Point, int] = {}
    leader = [first.setdefault((p[0] + 0.0, p[1] + 0.0, p[2] + 0.0), v) for v, p in enumerate(points)]
    new = [(leader[a], leader[b], leader[c]) for a, b, c in faces]
    stay = [f for f, row in enumerate(faces) if len(set(row)) < 3 or len(set(new[f])) == 3]
    return stay, [new[f] for f in stay]


def debris(points: list[Point], faces: list[Face], least_faces: int, least_share: float) -> list[int]:
    """Return the remaining faces."""
    proper = proper_faces(faces)
    component = flood(proper, faces, edge_faces(faces, proper), lambda count: count >= 2)
    areas = {f: area(points, faces[f]) for f in proper}
    size, weight = dict.fromkeys(component.values(), 0), dict.fromkeys(component.values(), 0.0)
    for f in proper:
        size[component[f]] += 1
        weight[component[f]] += areas[f]
    bar = least_share * sum(areas.values())
    gone = {label for label in size if size[label] < least_faces or weight[label] < bar}
    return [f for f in range(len(faces)) if component.get(f) not in gone]


def holes(points: list[Point], faces: list[Face], edges: int, share: float) -> list[list[tuple[int, int]]]:
    """Return the edges of each closed rim, in the direction of the adjacent faces."""
    proper = proper_faces(faces)
    at_edge = edge_faces(faces, proper)
    component = flood(proper, faces, at_edge, lambda count: count >= 2)

    def sides(f: int) -> list[tuple[int, int]]:
        a, b, c = faces[f]
        return [(a, b), (b, c), (c, a)]

    def after(f: int, rim: tuple[int, int]) -> tuple[int, tuple[int, int]] | None:
        """Turn around the end of a rim edge to the next rim edge. Return None if the rim ends there."""
        pivot, come = rim[1], rim
        while True:
            leave = next(side for side in sides(f) if pivot in side and {*side} != {*come})
            group = at_edge[(min(leave), max(leave))]
            if len(group) == 1:
                return (f, leave) if leave[0] == pivot else None
            if len(group) > 2:
                return None
            f, come = group[0] if group[1] == f else group[1], leave

    rims, seen = [], set()
    for f in proper:
        for side in sides(f):
            if side in seen or len(at_edge[(min(side), max(side))]) > 1:
                continue
            walk, here = [(f, side)], after(f, side)
            while here is not None and here != walk[0]:
                walk.append(here)
                here = after(*here)
            rim = [edge for _, edge in walk]
            seen.update(rim)
            if here is None or len(rim) > edges or len({a for a, _ in rim}) < len(rim):
                continue
            middle = [sum(points[a][i] for a, _ in rim) / len(rim) for i in range(3)]
            corners = [*points, (middle[0], middle[1], middle[2])]
            cap = sum(area(corners, (a, b, len(points))) for a, b in rim)
            whole = {component[face] for face, _ in walk}
            if cap <= share * sum(area(points, faces[face]) for face in proper if component[face] in whole):
                rims.append(rim)
    return rims

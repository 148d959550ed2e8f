"""The order of faces in which meshopt's codecs of triangles and vertices write the fewest bytes.

The codec (mode TRIANGLES of EXT_meshopt_compression) writes a face in a byte if it goes on from one of the
last edges, or begins with a vertex that no face had yet and has two of the last vertices in places that it
knows. What else a face needs takes more bytes. Vertices are numbered as faces first use them, and each is
written as its difference from the one before.
"""

from __future__ import annotations

from math import inf
from operator import sub
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_EDGES, _VERTICES = 15, 16
"""How many of the last edges and vertices the codec knows."""
_NAMED, _THIRD = 14, range(2, 14)
"""Which of these, counted from 1, a face can name: one that goes on from no edge, and one that does."""
_PAIRS = frozenset(bytes.fromhex("0076875667 78a9866589 68980169"))
"""Places of the second and third vertex, 0 for a new one, that the codec writes with the face."""
_UNNAMED = 15
"""Stands for the place of a vertex that has none."""
_NEW, _DONE, _BIT = 2.0, 0.8, 0.1
"""What a face costs beyond its bytes by a new vertex, what it gains by a vertex that no other face needs, and
what it costs by each bit in which a new vertex differs from the one before. Found by trying."""


def compact_order(faces: NDArray[np.int64], rows: NDArray[np.int64], start: NDArray[np.int64]) -> list[int]:
    """Return an order of `faces` (F, 3), chosen face by face, that takes few bytes.

    `rows` (V, K) are what is stored of vertices, in whole numbers; `start` (F,) is an order that says where
    to go on when no face is left at the last vertices. A face takes about 50 microseconds.
    """
    corners: list[list[int]] = faces.tolist()
    values: list[list[int]] = rows.tolist()
    around: list[set[int]] = [set() for _ in values]
    for face, vertices in enumerate(corners):
        for vertex in vertices:
            around[vertex].add(face)
    gains = [0.0, *(_DONE / count**0.5 for count in range(1, 1 + max(map(len, around))))]
    gain = [gains[len(faces_there)] for faces_there in around]
    numbers, count, named = [-1] * len(values), 0, 0
    edges: list[tuple[int, int]] = []
    recent: list[int] = []
    order, rest, before = [], iter(start.tolist()), values[0]

    def begun(face: int) -> list[int]:
        """Return the vertices of a face as the codec begins it: with a known edge, else with a new vertex."""
        a, b, c = vertices = corners[face]
        if (a, b) in ends:
            return vertices
        if (b, c) in ends:
            return [b, c, a]
        if (c, a) in ends:
            return [c, a, b]
        if numbers[a] < 0:
            return vertices
        return [b, c, a] if numbers[b] < 0 else [c, a, b] if numbers[c] < 0 else vertices

    def cost(face: int, least: float) -> float:
        """Return what a face costs, of which `least` is known."""
        a, b, c = begun(face)
        total = least
        if (a, b) in ends:
            written = [] if numbers[c] < 0 or place.get(c) in _THIRD else [c]
        else:
            at = [0 if numbers[each] < 0 else place.get(each, _UNNAMED) for each in (b, c)]
            if numbers[a] >= 0 or at[0] << 4 | at[1] not in _PAIRS:
                total += 1
            written = [] if numbers[a] < 0 else [a]
            written += [each for each, where in zip((b, c), at, strict=True) if where == _UNNAMED]
        for vertex in written:
            far = abs(numbers[vertex] - named)
            total += 1 + (far >= 64) + (far >= 8192)
        last = before
        for vertex in (a, b, c):
            if numbers[vertex] < 0:
                total += _BIT * sum(map(int.bit_length, map(sub, values[vertex], last)))
                last = values[vertex]
        return total

    for _ in corners:
        ends, place = set(edges), {vertex: 1 + k for k, vertex in enumerate(recent[:_NAMED])}
        best, lowest = -1, inf
        looked_at: set[int] = set()
        for vertex in recent:
            for face in around[vertex] - looked_at:
                a, b, c = corners[face]
                fresh = (numbers[a] < 0) + (numbers[b] < 0) + (numbers[c] < 0)
                least = 1.0 + _NEW * fresh - gain[a] - gain[b] - gain[c]
                if least < lowest and (total := cost(face, least)) < lowest:
                    best, lowest = face, total
            looked_at |= around[vertex]
        if best < 0:
            best = next(face for face in rest if face in around[corners[face][0]])
        order.append(best)
        a, b, c = begun(best)
        goes_on = (a, b) in ends
        edges = [(a, c), (c, b), *([] if goes_on else [(b, a)]), *edges][:_EDGES]
        for vertex in (c,) if goes_on else (a, b, c):
            if numbers[vertex] < 0:
                numbers[vertex], before = count, values[vertex]
                count += 1
            elif place.get(vertex, 0) in _THIRD if goes_on else vertex in place and vertex != a:
                continue
            else:
                named = numbers[vertex]
            recent.insert(0, vertex)
        del recent[_VERTICES:]
        for vertex in (a, b, c):
            around[vertex].discard(best)
            gain[vertex] = gains[len(around[vertex])]
    return order

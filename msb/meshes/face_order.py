"""The order of faces in which meshopt's codecs of triangles and vertices write the fewest bytes.

The codec (mode TRIANGLES of EXT_meshopt_compression) writes a face in a byte if it goes on from one of the
last edges, or begins with a vertex that no face had yet and has two of the last vertices in places that it
knows. What else a face needs takes more bytes. Vertices are numbered as faces first use them, and each is
written as its difference from the one before.

Why meshopt's own order is not enough: this one saves bytes where the faces of an indexed mesh meet at random,
as those of MeshSplatting do: 4.5 % of the file of the demo asset, 1.5 and 2.5 % of two trained models.
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
    search = _Search(faces.tolist(), rows.tolist())
    order, rest = [], iter(start.tolist())
    for _ in search.corners:
        # 1. The cheapest face at one of the last vertices, else the next of `start`.
        best = search.cheapest()
        if best < 0:
            best = next(face for face in rest if face in search.around[search.corners[face][0]])
        # 2. What the codec knows after that face.
        search.write(best)
        order.append(best)
    return order


class _Search:
    """What the codec knows after the faces so far, and the faces that are left.

    Attributes
    ----------
    around : list of set
        Of each vertex: the faces at it that are left.
    gain : list of float
        Of each vertex: what a face gains by using it, which is more if few faces are left there.
    numbers : list of int
        Of each vertex: its number in the file, -1 if no face used it yet.
    edges, recent : list
        The last edges and vertices, newest first; `ends` and `place` are the same to look up.
    named : int
        The number of the vertex that was last written by its number; the next one is its difference.
    before : list of int
        The row of the newest vertex.
    """

    def __init__(self, corners: list[list[int]], values: list[list[int]]) -> None:
        self.corners, self.values = corners, values
        self.around: list[set[int]] = [set() for _ in values]
        for face, vertices in enumerate(corners):
            for vertex in vertices:
                self.around[vertex].add(face)
        most = max(map(len, self.around))
        self.gains = [0.0, *(_DONE / count**0.5 for count in range(1, 1 + most))]
        self.gain = [self.gains[len(faces_there)] for faces_there in self.around]
        self.numbers, self.count, self.named = [-1] * len(values), 0, 0
        self.edges: list[tuple[int, int]] = []
        self.recent: list[int] = []
        self.before = values[0]
        self.ends: set[tuple[int, int]] = set()
        self.place: dict[int, int] = {}

    def cheapest(self) -> int:
        """Return the face at one of the last vertices that costs least; -1 if none is left there."""
        best, lowest = -1, inf
        numbers, gain = self.numbers, self.gain
        looked_at: set[int] = set()
        for vertex in self.recent:
            for face in self.around[vertex] - looked_at:
                a, b, c = self.corners[face]
                fresh = (numbers[a] < 0) + (numbers[b] < 0) + (numbers[c] < 0)
                least = 1.0 + _NEW * fresh - gain[a] - gain[b] - gain[c]
                if least < lowest and (total := self._cost(face, least)) < lowest:
                    best, lowest = face, total
            looked_at |= self.around[vertex]
        return best

    def write(self, face: int) -> None:
        """Change what the codec knows as it does when it writes a face."""
        numbers, place = self.numbers, self.place
        a, b, c = self._begun(face)
        # A face that goes on from an edge brings two new edges, any other three.
        goes_on = (a, b) in self.ends
        self.edges = [(a, c), (c, b), *([] if goes_on else [(b, a)]), *self.edges][:_EDGES]
        # Vertices become the most recent ones, unless the face names them by their place.
        for vertex in (c,) if goes_on else (a, b, c):
            if numbers[vertex] < 0:
                numbers[vertex], self.before = self.count, self.values[vertex]
                self.count += 1
            elif place.get(vertex, 0) in _THIRD if goes_on else vertex in place and vertex != a:
                continue
            else:
                self.named = numbers[vertex]
            self.recent.insert(0, vertex)
        del self.recent[_VERTICES:]
        # The face is no longer left at its vertices.
        for vertex in (a, b, c):
            self.around[vertex].discard(face)
            self.gain[vertex] = self.gains[len(self.around[vertex])]
        self.ends = set(self.edges)
        self.place = {vertex: 1 + k for k, vertex in enumerate(self.recent[:_NAMED])}

    def _begun(self, face: int) -> list[int]:
        """Return the vertices of a face as the codec begins it: with a known edge, else with a new vertex."""
        ends, numbers = self.ends, self.numbers
        a, b, c = vertices = self.corners[face]
        if (a, b) in ends:
            return vertices
        if (b, c) in ends:
            return [b, c, a]
        if (c, a) in ends:
            return [c, a, b]
        if numbers[a] < 0:
            return vertices
        return [b, c, a] if numbers[b] < 0 else [c, a, b] if numbers[c] < 0 else vertices

    def _cost(self, face: int, least: float) -> float:
        """Return what a face costs, of which `least` is known."""
        numbers, place = self.numbers, self.place
        a, b, c = self._begun(face)
        total = least
        # Which vertices are written by their numbers.
        if (a, b) in self.ends:
            written = [] if numbers[c] < 0 or place.get(c) in _THIRD else [c]
        else:
            at = [0 if numbers[each] < 0 else place.get(each, _UNNAMED) for each in (b, c)]
            if numbers[a] >= 0 or at[0] << 4 | at[1] not in _PAIRS:
                total += 1
            written = [] if numbers[a] < 0 else [a]
            written += [each for each, where in zip((b, c), at, strict=True) if where == _UNNAMED]
        # A number takes one to three bytes: seven bits each of the difference, with its sign.
        for vertex in written:
            far = abs(numbers[vertex] - self.named)
            total += 1 + (far >= 64) + (far >= 8192)
        # The bits in which the rows of new vertices differ from those before.
        last = self.before
        for vertex in (a, b, c):
            if numbers[vertex] < 0:
                row = self.values[vertex]
                total += _BIT * sum(map(int.bit_length, map(sub, row, last)))
                last = row
        return total

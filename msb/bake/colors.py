"""Static colours by least squares: those with which the faces, drawn opaque, are nearest to the lessons.

With w the weights of a face's corners at a pixel and t what the lesson shows there, its colours c minimise
the sum of (w . c - t)^2 over the pixels that show it: a system of 3 x 3 for each face that shares no
vertex, and a sparse one for all vertices of a mesh. Both also weigh differences along edges and the
distance to the colours that the faces have, so that what few pixels show, or none, stays near what it was.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msb.bake.arrays import Floats, Ints, Mask, Singles

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from msb.bake.raster import Seen

SMOOTH = 0.3  # weight of differences along edges, in pixels
PRIOR = 0.05  # weight of the previous colours, in pixels
# Corner colours stay within mean +- 8 sigma + 0.05 of the face's pixels. Corners of fully visible faces
# reach three sigma; limits below eight cost dB.
_REACH, _LEAST = 8.0, 0.05
_STRIP = 3  # rings of faces around unseen ones that are solved again
_FAINT = 1e-6  # weight of the previous colours where no neighbour is seen
_ROUNDS = 4  # times that colours beyond the bounds are clamped and the others solved again
_STEPS, _TOLERANCE = 400, 1e-6
_AT_ONCE = 1 << 16  # faces solved together; bounds the memory


def products(sums: Singles) -> tuple[Floats, Floats]:
    """Return (F, 3, 3) sums of products of weights, and (F, 3, 3) of weights (rows) times colours."""
    wide = sums.astype(np.float64)
    squares = wide[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return squares, wide[:, 6:].reshape(-1, 3, 3)


def pixels(seen: Seen) -> Floats:
    """Return (F,) how many pixels show each face: the weights of one are 1 in all."""
    found: Floats = seen.sums[:, :6] @ np.array([1.0, 2.0, 2.0, 1.0, 2.0, 1.0])
    return found


def of_soup(seen: Seen, colors: Singles, wanted: Mask | None = None) -> Singles:
    """Return the best colours (F, 3, 3) in [0, 1] of faces that share no vertices and have `colors`.

    A face of which nothing was seen, or that is not `wanted`, keeps its own.
    """
    shown = seen.sums[:, :6].any(axis=1)
    faces = np.flatnonzero(shown if wanted is None else shown & wanted)
    made = colors.copy()
    for first in range(0, len(faces), _AT_ONCE):
        some = faces[first : first + _AT_ONCE]
        made[some] = _of_faces(*products(seen.sums[some]), colors[some])
    return made


def _of_faces(squares: Floats, sides: Floats, colors: Singles) -> Floats:
    """Return the best colours (n, 3, 3) of faces with these sums."""
    system = squares + SMOOTH * (3 * np.eye(3) - 1) + PRIOR * np.eye(3)
    sides = sides + PRIOR * colors
    found = np.clip(np.linalg.solve(system, sides), -1, 2)
    low, high = _bounds(squares, found)
    for channel in range(3):
        x, least, most = found[..., channel], low[:, None, channel], high[:, None, channel]
        rows = np.flatnonzero(((x < least) | (x > most)).any(axis=1))
        found[rows, :, channel] = _held(
            system[rows], sides[rows, :, channel], x[rows], least[rows], most[rows]
        )
    bounded: Floats = np.clip(found, low[:, None], high[:, None])
    return bounded


def _bounds(squares: Floats, found: Floats) -> tuple[Floats, Floats]:
    """Return the least and the most (n, 3) that corners may have of each channel.

    They are in 0 to 1, and not far from the mean of the pixels, as the corners `found` (n, 3, 3) show them:
    what shows a tip alone would have the rest guessed, and glow from elsewhere.
    """
    share = squares.sum(axis=2)
    count = np.maximum(share.sum(axis=1, keepdims=True), 1e-12)
    mean = (share[:, None] @ found)[:, 0] / count
    off = found - mean[:, None]
    reach = _REACH * np.sqrt(np.maximum((off * (squares @ off)).sum(axis=1) / count, 0)) + _LEAST
    return np.clip(mean - reach, 0, 1), np.clip(mean + reach, 0, 1)


def _held(system: Floats, side: Floats, x: Floats, low: Floats, high: Floats) -> Floats:
    """Return x (n, 3) with what leaves its bounds (n, 1) held there, and the others solved again."""
    held = np.zeros(x.shape, bool)
    for _ in range(_ROUNDS):
        held |= (x < low) | (x > high)
        x = np.clip(x, low, high)
        free = ~held
        rest = side - np.einsum("nij,nj->ni", system, np.where(held, x, 0.0))
        own = np.where(free[:, :, None] & free[:, None, :], system, 0.0) + held[:, :, None] * np.eye(3)
        solved = np.linalg.solve(own, np.where(free, rest, 0.0)[..., None])[..., 0]
        x = np.where(held, x, solved)
    return x


def of_mesh(seen: Seen, faces: Ints, colors: Singles, edges: csr_matrix) -> Singles:
    """Return the best colours (V, 3) in [0, 1] of vertices that `faces` (F, 3) share and that have `colors`;
    `edges` is the `laplacian` of the faces."""
    import scipy.sparse as sparse

    count = len(colors)
    squares, sides = products(seen.sums)
    rows, columns = np.repeat(faces, 3, axis=1).reshape(-1), np.tile(faces, (1, 3)).reshape(-1)
    system = sparse.coo_matrix((squares.reshape(-1), (rows, columns)), shape=(count, count)).tocsr()
    system = system + SMOOTH * edges + PRIOR * sparse.identity(count, format="csr")
    right = PRIOR * colors.astype(np.float64)
    for corner in range(3):
        for channel in range(3):
            one = sides[:, corner, channel]
            right[:, channel] += np.bincount(faces[:, corner], one, minlength=count)
    found = np.stack(
        [_solved(system, right[:, k], colors[:, k].astype(np.float64)) for k in range(3)], axis=1
    )
    low, high = _vertex_bounds(squares, faces, found)
    bounded = [_bounded(system, right[:, k], found[:, k], low[k], high[k]) for k in range(3)]
    return np.stack(bounded, axis=1).astype(np.float32)


def _vertex_bounds(squares: Floats, faces: Ints, found: Floats) -> tuple[Floats, Floats]:
    """Return the least and the most (3, V) of each channel that one of a vertex's faces allows, of those that
    are seen; if none is, all that there is."""
    low, high = np.ones((3, len(found))), np.zeros((3, len(found)))
    seen = np.flatnonzero(squares.any(axis=(1, 2)))
    for first in range(0, len(seen), _AT_ONCE):
        some = seen[first : first + _AT_ONCE]
        least, most = _bounds(squares[some], found[faces[some]])
        for channel in range(3):
            for corner in faces[some].T:
                np.minimum.at(low[channel], corner, least[:, channel])
                np.maximum.at(high[channel], corner, most[:, channel])
    free = low > high
    return np.where(free, 0.0, low), np.where(free, 1.0, high)


def continued(colors: Singles, faces: Ints, shown: Floats) -> Singles:
    """Return `colors` (V, 3) in which what no pixels (F,) show goes on as what is seen around it.

    That begins some rings of faces beside: next to what nobody sees, pictures show as much of the background.
    """
    import scipy.sparse as sparse

    loose = np.zeros(len(colors), bool)
    loose[faces[shown == 0]] = True
    for _ in range(_STRIP):
        loose[faces[loose[faces].any(axis=1)]] = True
    rows = np.flatnonzero(loose)
    if len(rows) in (0, len(colors)):
        return colors
    edges = laplacian(faces, len(colors))[rows]
    system = (edges[:, rows] + _FAINT * sparse.identity(len(rows))).tocsr()
    before = colors.astype(np.float64)
    right = _FAINT * before[rows] - edges[:, ~loose] @ before[~loose]
    made = colors.copy()
    for channel in range(3):
        made[rows, channel] = _solved(system, right[:, channel], before[rows, channel])
    return made


def laplacian(faces: Ints, count: int) -> csr_matrix:
    """Return the Laplacian of the edges: each edge once."""
    import scipy.sparse as sparse

    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    ends = ends[ends[:, 0] != ends[:, 1]]
    both = sparse.coo_matrix((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count)).tocsr()
    both = both + both.T
    both.data[:] = 1  # however many faces have an edge
    return sparse.diags(np.asarray(both.sum(axis=1)).ravel()).tocsr() - both


def _bounded(system: csr_matrix, right: Floats, x: Floats, low: Floats, high: Floats) -> Floats:
    """Return x with what leaves its bounds held there, and the others solved again."""
    held = np.zeros(len(x), bool)
    for _ in range(_ROUNDS):
        out = (x < low) | (x > high)
        x = np.clip(x, low, high)
        if not (out & ~held).any():
            break
        held |= out
        free = np.flatnonzero(~held)
        rest = right - system @ np.where(held, x, 0.0)
        x[free] = _solved(system[free][:, free].tocsr(), rest[free], x[free])
    return np.clip(x, low, high)


def _solved(system: csr_matrix, right: Floats, x: Floats) -> Floats:
    """Return x of system @ x = right: conjugate gradients, Jacobi's preconditioner.

    SciPy's own would wake the threads of its linear algebra, which then spin beside the kernels.
    """
    scale = 1 / system.diagonal()
    rest = right - system @ x
    step = scale * rest
    size = _dot(rest, step)
    stop = _TOLERANCE**2 * max(_dot(right * scale, right), 1e-30)
    for _ in range(_STEPS):
        if size <= stop:
            break
        moved = system @ step
        share = size / max(_dot(step, moved), 1e-300)
        x = x + share * step
        rest -= share * moved
        turned = scale * rest
        before, size = size, _dot(rest, turned)
        step *= size / max(before, 1e-300)
        step += turned
    return x


def _dot(a: Floats, b: Floats) -> float:
    return float(np.einsum("i,i->", a, b))

"""Fit static colours by least squares, so that opaque faces match images best.

Let w be the barycentric weights of a face's corners at a pixel, and t the colour of the image there. The
corner colours c minimise the sum of (w . c - t)^2 over the pixels that show the face. A triangle soup needs
one 3 x 3 system per face. A connected mesh needs one sparse system for all vertices. Two small terms are
added to the sum: differences along edges, and the distance to the previous colours. These terms keep corners
with few or no pixels near their previous colours.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msb.bake.arrays import Floats, Ints, Mask, Singles

if TYPE_CHECKING:
    from scipy.sparse import csr_matrix

    from msb.bake.soup_renderer import FaceSums

# Weight of the squared colour differences along edges, relative to a pixel. Smoothing colours with this
# weight affects faces below one pixel, and is negligible for larger faces.
SMOOTHNESS = 0.3
# Weight of the distance to the previous colours, relative to a pixel. With this small weight, the previous
# colours only make the equations solvable.
PRIOR = 0.05
# Corner colours are limited to the range mean +- (_MAX_SIGMA sigma + _MARGIN) of the face's pixels. Without
# limits on colours, a face with one visible tip is extrapolated to black or white. Corners of fully visible
# faces reach 3 sigma, and limits below 8 sigma reduce the PSNR.
_MAX_SIGMA, _MARGIN = 8.0, 0.05
# Number of rings of visible faces that are coloured together with adjacent unseen faces. In these rings, half
# of the pixels near a face may show the background, so the fitted colours are unreliable.
_STRIP_RINGS = 3
# Weight of the previous colours when colours are extended to unseen faces. The previous colours only matter
# for a part without any visible neighbour.
_FAINT_PRIOR = 1e-6
# Number of rounds. Each round clamps colours to their limits and solves the equations of the other colours
# again. Further rounds of clamping change little.
_CLAMP_ROUNDS = 4
# Largest number of conjugate-gradient steps, and the relative residual at which they end. A residual of this
# size is far below one of 256 colour levels.
_MAX_STEPS, _TOLERANCE = 400, 1e-6
# Number of faces of a soup whose equations are solved together. Solving this number of faces together limits
# the memory to about 30 MB per array.
_CHUNK = 1 << 16


def split_sums(sums: Singles) -> tuple[Floats, Floats]:
    """Return the sums of w w^T (F, 3, 3) and of w t^T (F, 3, 3) from `sums` (F, 15).

    The sums have one row per corner.
    """
    wide = sums.astype(np.float64)
    products = wide[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    return products, wide[:, 6:].reshape(-1, 3, 3)


def count_pixels(sums: FaceSums) -> Floats:
    """Return the number of pixels (F,) that show each face.

    The three weights at a pixel sum to 1, so the sum of their products counts the pixels.
    """
    count: Floats = sums.sums[:, :6] @ np.array([1.0, 2.0, 2.0, 1.0, 2.0, 1.0])
    return count


def fit_soup_colors(sums: FaceSums, colors: Singles, selected: Mask | None = None) -> Singles:
    """Return the best corner colours (F, 3, 3) in [0, 1] of faces that share no vertices.

    Faces that no pixel shows and faces that are not `selected` keep their previous `colors` (F, 3, 3).
    """
    is_seen = sums.sums[:, :6].any(axis=1)
    faces = np.flatnonzero(is_seen if selected is None else is_seen & selected)
    result = colors.copy()
    for first in range(0, len(faces), _CHUNK):
        chunk = faces[first : first + _CHUNK]
        result[chunk] = _solve_faces(*split_sums(sums.sums[chunk]), colors[chunk])
    return result


def _solve_faces(products: Floats, targets: Floats, colors: Singles) -> Floats:
    """Return the best corner colours (n, 3, 3) of faces, given their sums over pixels."""
    # Set up the normal equations (n, 3, 3). Two terms are added: smoothness along the three edges, and the
    # previous colours.
    system = products + SMOOTHNESS * (3 * np.eye(3) - 1) + PRIOR * np.eye(3)
    targets = targets + PRIOR * colors
    solution = np.clip(np.linalg.solve(system, targets), -1, 2)
    # Solve the systems again for faces with colours beyond their limits, one channel after the other.
    low, high = _find_color_limits(products, solution)
    for channel in range(3):
        x, least, most = solution[..., channel], low[:, None, channel], high[:, None, channel]
        rows = np.flatnonzero(((x < least) | (x > most)).any(axis=1))
        solution[rows, :, channel] = _solve_faces_within(
            system[rows], targets[rows, :, channel], x[rows], least[rows], most[rows]
        )
    limited: Floats = np.clip(solution, low[:, None], high[:, None])
    return limited


def _find_color_limits(products: Floats, colors: Floats) -> tuple[Floats, Floats]:
    """Return the smallest and the largest allowed colour (n, 3) of a face's corners.

    The limits follow from the mean and the standard deviation of the colour over the pixels of the face. The
    argument `colors` (n, 3, 3) contains the colours of the face's corners. The limits lie within [0, 1].
    """
    share = products.sum(axis=2)
    count = np.maximum(share.sum(axis=1, keepdims=True), 1e-12)
    mean = (share[:, None] @ colors)[:, 0] / count
    offset = colors - mean[:, None]
    variance = np.maximum((offset * (products @ offset)).sum(axis=1) / count, 0)
    reach = _MAX_SIGMA * np.sqrt(variance) + _MARGIN
    return np.clip(mean - reach, 0, 1), np.clip(mean + reach, 0, 1)


def _solve_faces_within(system: Floats, targets: Floats, x: Floats, low: Floats, high: Floats) -> Floats:
    """Clamp values of the solutions x (n, 3) to limits (n, 1), and solve for the unclamped values again."""
    clamped = np.zeros(x.shape, bool)
    for _ in range(_CLAMP_ROUNDS):
        clamped |= (x < low) | (x > high)
        x = np.clip(x, low, high)
        free = ~clamped
        # Move clamped values to the right side of the equations. Replace the rows of clamped values by rows
        # of the identity matrix.
        rest = targets - np.einsum("nij,nj->ni", system, np.where(clamped, x, 0.0))
        reduced = np.where(free[:, :, None] & free[:, None, :], system, 0.0) + clamped[:, :, None] * np.eye(3)
        solution = np.linalg.solve(reduced, np.where(free, rest, 0.0)[..., None])[..., 0]
        x = np.where(clamped, x, solution)
    return x


def fit_mesh_colors(sums: FaceSums, faces: Ints, colors: Singles, laplacian: csr_matrix) -> Singles:
    """Return the best vertex colours (V, 3) in [0, 1] of a mesh with faces (F, 3) and previous `colors`.

    The argument `laplacian` is the result of `make_edge_laplacian` for the faces.
    """
    import scipy.sparse as sparse

    # Add up the products of all faces in a sparse matrix (V, V). The right sides have the shape (V, 3).
    count = len(colors)
    products, targets = split_sums(sums.sums)
    rows, columns = np.repeat(faces, 3, axis=1).reshape(-1), np.tile(faces, (1, 3)).reshape(-1)
    system = sparse.coo_matrix((products.reshape(-1), (rows, columns)), shape=(count, count)).tocsr()
    system = system + SMOOTHNESS * laplacian + PRIOR * sparse.identity(count, format="csr")
    right = PRIOR * colors.astype(np.float64)
    for corner in range(3):
        for channel in range(3):
            values = targets[:, corner, channel]
            right[:, channel] += np.bincount(faces[:, corner], values, minlength=count)
    # Solve each channel without limits, then again with the limits of the pixels.
    solution = np.stack(
        [_solve(system, right[:, k], colors[:, k].astype(np.float64)) for k in range(3)], axis=1
    )
    low, high = _find_vertex_limits(products, faces, solution)
    limited = [_solve_within(system, right[:, k], solution[:, k], low[k], high[k]) for k in range(3)]
    return np.stack(limited, axis=1).astype(np.float32)


def _find_vertex_limits(products: Floats, faces: Ints, colors: Floats) -> tuple[Floats, Floats]:
    """Return the smallest and largest allowed vertex colours (3, V).

    A vertex has the widest limits of its adjacent faces. Only visible faces limit the colours of vertices.
    Vertices without a visible face have the limits 0 and 1.
    """
    low, high = np.ones((3, len(colors))), np.zeros((3, len(colors)))
    seen = np.flatnonzero(products.any(axis=(1, 2)))
    for first in range(0, len(seen), _CHUNK):
        chunk = seen[first : first + _CHUNK]
        least, most = _find_color_limits(products[chunk], colors[faces[chunk]])
        for channel in range(3):
            for corner in faces[chunk].T:
                np.minimum.at(low[channel], corner, least[:, channel])
                np.maximum.at(high[channel], corner, most[:, channel])
    is_unseen = low > high
    return np.where(is_unseen, 0.0, low), np.where(is_unseen, 1.0, high)


def extend_colors(colors: Singles, faces: Ints, pixels: Floats) -> Singles:
    """Return vertex colours (V, 3).

    Faces without `pixels` (F,) get colours that continue the surrounding colours. A few rings of visible
    faces around unseen faces are coloured again (`_STRIP_RINGS`).
    """
    import scipy.sparse as sparse

    loose = np.zeros(len(colors), bool)
    loose[faces[pixels == 0]] = True
    for _ in range(_STRIP_RINGS):
        loose[faces[loose[faces].any(axis=1)]] = True
    rows = np.flatnonzero(loose)
    if len(rows) in (0, len(colors)):
        return colors
    # Solve Laplace's equation for the vertices (n,) without a colour. The colours of the other vertices are
    # boundary values.
    laplacian = make_edge_laplacian(faces, len(colors))[rows]
    system = (laplacian[:, rows] + _FAINT_PRIOR * sparse.identity(len(rows))).tocsr()
    before = colors.astype(np.float64)
    right = _FAINT_PRIOR * before[rows] - laplacian[:, ~loose] @ before[~loose]
    result = colors.copy()
    for channel in range(3):
        result[rows, channel] = _solve(system, right[:, channel], before[rows, channel])
    return result


def make_edge_laplacian(faces: Ints, count: int) -> csr_matrix:
    """Return the graph Laplacian (V, V) of the edges of faces (F, 3) for `count` vertices.

    An edge counts once, even if several faces share it.
    """
    import scipy.sparse as sparse

    ends = faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    ends = ends[ends[:, 0] != ends[:, 1]]
    adjacency = sparse.coo_matrix(
        (np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count)
    ).tocsr()
    adjacency = adjacency + adjacency.T
    adjacency.data[:] = 1
    return sparse.diags(np.asarray(adjacency.sum(axis=1)).ravel()).tocsr() - adjacency


def _solve_within(system: csr_matrix, right: Floats, x: Floats, low: Floats, high: Floats) -> Floats:
    """Clamp values of the solution x (V,) to their limits (V,), and solve for the unclamped values again."""
    clamped = np.zeros(len(x), bool)
    for _ in range(_CLAMP_ROUNDS):
        outside = (x < low) | (x > high)
        x = np.clip(x, low, high)
        if not (outside & ~clamped).any():
            break
        clamped |= outside
        free = np.flatnonzero(~clamped)
        rest = right - system @ np.where(clamped, x, 0.0)
        x[free] = _solve(system[free][:, free].tocsr(), rest[free], x[free])
    return np.clip(x, low, high)


def _solve(system: csr_matrix, right: Floats, x: Floats) -> Floats:
    """Solve system @ x = right from a first guess x by conjugate gradients with Jacobi's preconditioner.

    SciPy's solver is not used, because the threads of its linear algebra library would slow down the kernels.
    """
    scale = 1 / system.diagonal()
    residual = right - system @ x
    direction = scale * residual
    size = _dot(residual, direction)
    stop = _TOLERANCE**2 * max(_dot(right * scale, right), 1e-30)
    for _ in range(_MAX_STEPS):
        if size <= stop:
            break
        # Move to the minimum along the direction, then compute the next conjugate direction.
        product = system @ direction
        length = size / max(_dot(direction, product), 1e-300)
        x = x + length * direction
        residual -= length * product
        scaled = scale * residual
        before, size = size, _dot(residual, scaled)
        direction *= size / max(before, 1e-300)
        direction += scaled
    return x


def _dot(a: Floats, b: Floats) -> float:
    return float(np.einsum("i,i->", a, b))

"""Closed meshes with UVs by corner. The same meshes with one UV per vertex, as files store them."""

import numpy as np
from numpy.typing import NDArray

from msb.asset.texture import Sampler
from msb.meshes import Mesh

_QUADS = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
# V = 8, F = 12, wound outwards.
CUBE = (
    np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32),
    np.array([(quad[0], *quad[k : k + 2]) for quad in _QUADS for k in (1, 2)], np.int64),
)
_SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]], np.float32)
# UVs (3F, 2) with one chart per side. Each corner of the cube is then in three charts.
CUBE_UVS = np.concatenate([(_SQUARE * 0.9 + [side, 0]) / [6, 1] for side in range(6)]).astype(np.float32)
TEXTURE = np.random.default_rng(1).integers(0, 256, (8, 48, 3), np.uint8)


def torus(around: int = 8, along: int = 12) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Return a closed mesh of 2 * `around` * `along` faces."""
    i, j = (axis.reshape(-1) for axis in np.mgrid[:around, :along])
    turn, way = 2 * np.pi * i / around, 2 * np.pi * j / along
    out = 2 + np.cos(turn)
    points = np.stack([out * np.cos(way), out * np.sin(way), np.sin(turn)], axis=1).astype(np.float32)
    a, b = i * along + j, (i + 1) % around * along + j
    c, d = (i + 1) % around * along + (j + 1) % along, i * along + (j + 1) % along
    return points, np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)])


def doubled(
    points: NDArray[np.float32], faces: NDArray[np.int64], values: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float32]]:
    """Return the mesh with `values` (3F, n) stored by vertex, without repeated rows."""
    corners = faces.reshape(-1)
    rows = np.concatenate([corners[:, None], values.astype(np.float64)], axis=1)
    rows, number = np.unique(rows, axis=0, return_inverse=True)
    return points[rows[:, 0].astype(int)], number.reshape(-1, 3), rows[:, 1:].astype(np.float32)


def textured_cube(by: str, faces: slice = slice(None)) -> Mesh:
    """Return the cube, or some of its faces, with a texture and UVs by "corner" or by "vertex"."""
    points, triangles = CUBE[0], CUBE[1][faces]
    uvs = CUBE_UVS.reshape(-1, 3, 2)[faces].reshape(-1, 2)
    more = {"textures": (TEXTURE,), "sampler": Sampler(wrap_u="clamp")}
    if by == "corner":
        return Mesh(points, triangles, corner_uvs=uvs, **more)  # type: ignore[arg-type]
    points, triangles, uvs = doubled(points, triangles, uvs)
    return Mesh(points, triangles, vertex_uvs=uvs, **more)  # type: ignore[arg-type]

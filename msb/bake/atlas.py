"""Where each face lies in a texture: faces that share nothing in cells of their own, surfaces by xatlas."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.base.children import run_apart
from msb.base.extras import need_extra
from msb.base.limits import Limits
from msb.errors import MeshError, UsageError

if TYPE_CHECKING:
    from msb.base.children import Arrays

LEVELS = (2, 1)
"""How many times a texture of a soup can be halved before its faces run into each other: the first of these
that leaves a face `_ENOUGH` of the texels that it needs, along a side, and the last where none does."""
_ENOUGH = 0.7
_SLACK = 1 / 64
"""Texels that a face is smaller than its cell allows, more than a float32 of texture coordinates rounds."""
_STEPS = 40
_CHILD = Limits(seconds=900.0, memory=None)
_PADDING = 4
"""Texels between charts."""
_LEAST = 1 / 4
"""How much finer or coarser than usual a chart may be."""


class _Kind(NamedTuple):
    """Cells of one size, and the faces in them, some to each cell. A block is a texel of the last level."""

    width: int
    height: int
    each: int
    leg: int
    """Blocks along the legs of a face; 0: a face is a point in the middle of a texel."""
    faces: NDArray[np.int64]

    @property
    def cells(self) -> int:
        return -(-len(self.faces) // self.each)


def soup_atlas(pixels: NDArray[np.float64], size: int) -> NDArray[np.float32]:
    """Return texture coordinates (3F, 2) of faces that share no vertex, in a square texture of `size` texels.

    A face is a right triangle of as many texels as it needs, `pixels` (F,), or of the largest share of them
    that there is room for. Cells keep apart in the smaller levels, too, as `LEVELS` says. A face without
    pixels is a point in the middle of a texel, and so is one that is too small for a cell: it has one colour.

    Raises
    ------
    UsageError
        USAGE: not even a texel is left for each face.
    """
    legs = np.sqrt(2 * np.maximum(pixels, 0))
    for levels in LEVELS:
        block = 1 << levels
        factor, kinds, places = _packed(legs / block, size // block, block)
        if factor >= _ENOUGH:
            break
    if places is None:
        text = f"{len(pixels):,} faces do not fit into a texture of {size} x {size} texels"
        raise UsageError("USAGE", text)
    made = np.zeros((len(pixels), 3, 2))
    for kind, place in zip(kinds, places, strict=True):
        cell, which = np.divmod(np.arange(len(kind.faces)), kind.each)
        made[kind.faces] = block * place[cell, None] + _within(kind, which, block)
    return np.asarray((made / size).reshape(-1, 2), np.float32)


def _packed(
    legs: NDArray[np.float64], blocks: int, block: int
) -> tuple[float, list[_Kind], list[NDArray[np.int64]] | None]:
    """Return a factor, 1 at most, cells of so much of the legs (F,) that fit, and their places."""
    low, high = 0.0, 2.0
    for _ in range(_STEPS):
        factor = (low + high) / 2
        if _shelves(_kinds(factor * legs, block), blocks) is None:
            high = factor
        elif factor == 1:
            low = 1.0
            break
        else:
            low = factor
    kinds = _kinds(low * legs, block)
    return low, kinds, _shelves(kinds, blocks)


def _kinds(legs: NDArray[np.float64], block: int) -> list[_Kind]:
    """Return cells, the highest first, for faces with legs (F,) of so many blocks, rounded.

    A level is read between the middles of its texels, so a face keeps half a block from what is not its own.
    From three blocks on two faces share a cell: the blocks on one side of its diagonal are one's.
    """
    whole = np.rint(legs).astype(np.int64)
    order = np.argsort(-whole, kind="stable")
    sizes, starts = np.unique(-whole[order], return_index=True)
    kinds = []
    for size, faces in zip((-sizes).tolist(), np.split(order, starts[1:]), strict=True):
        if size >= 3:
            kinds.append(_Kind(size + 3, size + 2, 2, size, faces))
        elif size:
            kinds.append(_Kind(size + 1, size + 1, 1, size, faces))
        else:
            kinds.append(_Kind(1, 1, block * block, 0, faces))
    return kinds


def _shelves(kinds: Sequence[_Kind], blocks: int) -> list[NDArray[np.int64]] | None:
    """Return the places (cells, 2) of each kind, in blocks, side by side and row by row; None: no room."""
    x = y = shelf = 0
    places = []
    for kind in kinds:
        beside = min(kind.cells, (blocks - x) // kind.width) if shelf else 0
        number = np.arange(kind.cells)
        place = np.stack([x + kind.width * number, np.full(kind.cells, y)], axis=1)
        x += beside * kind.width
        if beside < kind.cells:
            if kind.width > blocks:
                return None
            row, column = np.divmod(number[beside:] - beside, blocks // kind.width)
            place[beside:] = np.stack([kind.width * column, y + shelf + kind.height * row], axis=1)
            x, y, shelf = int(kind.width * (column[-1] + 1)), int(place[-1, 1]), kind.height
            if y + shelf > blocks:
                return None
        places.append(place)
    return places


def _within(kind: _Kind, which: NDArray[np.int64], block: int) -> NDArray[np.float64]:
    """Return the corners (n, 3, 2), in texels, of the `which`-th faces (n,) of cells."""
    if not kind.leg:
        row, column = np.divmod(which, block)
        return np.repeat(np.stack([column, row], axis=1)[:, None] + 0.5, 3, axis=1)
    leg = block * kind.leg - _SLACK
    corners = block / 2 + leg * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    turned = block * np.array([kind.width, kind.height]) - corners
    return np.where(which[:, None, None] > 0, turned, corners)


def connected_atlas(
    vertices: NDArray[Any], faces: NDArray[np.int64], pixels: NDArray[np.float64], size: int
) -> NDArray[np.float32]:
    """Return texture coordinates (3F, 2) of the charts that xatlas cuts a surface into, in a square texture.

    Parameters
    ----------
    vertices : (V, 3) float
    faces : (F, 3) int64
    pixels : (F,) float64
        Those that each face needs; charts are scaled by what their faces need together.
    size : int
        Texels along a side.

    Raises
    ------
    UsageError
        EXTRA_MISSING: xatlas is not installed.
    MeshError
        MESH_ARRAY: xatlas makes nothing of this mesh.
    """
    need_extra("trial", "xatlas", what="a texture on a surface", instead="vertex colours need nothing")
    # xatlas drops faces of less than 1e-7: it is given a unit in which the mean face has an area of 1.
    points = vertices.astype(np.float64)
    area = float(_areas(points[faces]).mean())
    points = (points - points[faces].mean(axis=(0, 1))) / np.sqrt(area if area > 0 else 1)
    arrays = {
        "vertices": points.astype(np.float32),
        "faces": faces.astype(np.uint32),
        "pixels": np.asarray(pixels, np.float64),
    }
    reply = run_apart(unwrapped, str(size), arrays, _CHILD)
    if reply.why:
        raise MeshError("MESH_ARRAY", f"xatlas cannot unwrap these {len(faces):,} faces: {reply.why}")
    return np.asarray(reply.arrays["uv"])


def unwrapped(word: str, arrays: Arrays) -> tuple[Any, Arrays]:
    """Unwrap a mesh for a texture of `word` texels; a `Work` of `msb.base.children`."""
    import xatlas

    packing = xatlas.PackOptions()
    packing.resolution, packing.padding, packing.bilinear = int(word), _PADDING, True
    cut = xatlas.Atlas()
    cut.add_mesh(arrays["vertices"], arrays["faces"])
    cut.generate()
    _, faces, uv = cut[0]
    chart = np.asarray(cut.get_mesh_vertex_assignment(0)[1]).astype(np.int64)
    plane = uv.astype(np.float64) * (cut.width, cut.height)
    of_face = chart[faces[:, 0]]
    area, pixels = (
        np.bincount(of_face, values, len(uv)) for values in (_areas(plane[faces]), arrays["pixels"])
    )
    scale = np.sqrt(pixels / np.where(area > 0, area, 1))
    usual = float(np.median(scale[pixels > 0])) if pixels.any() else 1.0
    scale = np.clip(scale, _LEAST * usual, usual / _LEAST)
    packed = xatlas.Atlas()
    packed.add_uv_mesh(
        (plane * scale[chart][:, None]).astype(np.float32), faces, of_face[:, None].astype(np.uint32)
    )
    packed.generate(pack_options=packing)
    _, faces, uv = packed[0]
    # It is about as large as was asked, in texels of its own; one scale keeps charts undistorted.
    sides = np.array([packed.width, packed.height])
    placed = (uv.astype(np.float64) * sides / sides.max())[faces]
    return {"charts": int(packed.chart_count)}, {"uv": placed.reshape(-1, 2).astype(np.float32)}


def _areas(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the areas (F,) of triangles (F, 3, 2 | 3)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    squares = (a * a).sum(axis=1) * (b * b).sum(axis=1) - np.square((a * b).sum(axis=1))
    return np.asarray(np.sqrt(np.maximum(squares, 0)) / 2)

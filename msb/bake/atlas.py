"""Where each face lies in a texture: faces that share nothing in cells of their own, surfaces by xatlas."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.bake.arrays import Floats, Ints, Singles
from msb.base.children import run_apart
from msb.base.extras import need_extra
from msb.base.limits import Limits
from msb.errors import MeshError, UsageError

if TYPE_CHECKING:
    from msb.base.children import Arrays


# Mip levels that must not mix two faces of a soup: the first entry that leaves each face `_ENOUGH` of the
# texels it needs, along a side, else the last.
LEVELS = (2, 1)
_ENOUGH = 0.7
_SLACK = 1 / 64  # texels by which a face is smaller than its cell; more than rounding of float32 coordinates
_STEPS = 16
_SLIMMEST = 4.0  # largest ratio of the two legs of a face
_CHILD = Limits(seconds=900.0, memory=None)
_PADDING = 4  # texels between charts
_PARTS = 65535  # positions of a chart's corner along a side; files store them in two bytes
_LEAST = 1 / 4  # smallest scale of a chart relative to the median; its inverse is the largest
_AT_ONCE = 8192  # faces per call of xatlas, whose time grows with the square of their number


class _Cells(NamedTuple):
    """Rectangles of a texture and which faces lie in them, in blocks: texels of the last level kept apart."""

    # (C, 2) width and height.
    sides: Ints
    # (F, 2) of each face; 0: it is a point in the middle of a texel.
    legs: Ints
    # (F,) the cell of each face.
    of: Ints
    # (F,) of each face among those of its cell.
    number: Ints


def soup_atlas(corners: NDArray[Any], pixels: Floats, size: int) -> Singles:
    """Return texture coordinates (3F, 2) of faces that share no vertex, in a square texture of `size` texels.

    A face is a right triangle whose legs are to each other as its shorter sides. It has a texel for each
    pixel that it needs, or the largest share of them that there is room for. Cells keep apart in smaller
    levels, too, as `LEVELS` says. A face that needs none, or is too small for a cell, is a point: one colour.

    Parameters
    ----------
    corners : (F, 3, 3) float
    pixels : (F,) float64
        How many each face needs.
    size : int
        Texels along a side.

    Raises
    ------
    UsageError
        USAGE: not even a texel is left for each face.
    """
    points = corners.astype(np.float64)
    sides = np.linalg.norm(points[:, [1, 2, 0]] - points[:, [2, 0, 1]], axis=2)
    # The right angle is at the corner across from the longest side, and the longer leg lies along a row.
    order = np.argsort(-sides, axis=1, kind="stable")[:, [0, 2, 1]]
    short, long = np.sort(sides, axis=1)[:, :2].T
    slim = np.clip(np.divide(long, short, out=np.ones_like(long), where=short > 0), 1, _SLIMMEST)
    legs = np.sqrt(2 * np.maximum(pixels, 0)[:, None] * np.stack([slim, 1 / slim], axis=1))
    for levels in LEVELS:
        block = 1 << levels
        factor, cells, places = _packed(legs / block, size // block, block)
        if factor >= _ENOUGH:
            break
    if places is None:
        text = f"{len(pixels):,} faces do not fit into a texture of {size} x {size} texels"
        raise UsageError("USAGE", text)
    uvs = np.zeros((len(pixels), 3, 2))
    np.put_along_axis(uvs, order[..., None], _placed(cells, places, block) / size, axis=1)
    return uvs.reshape(-1, 2).astype(np.float32)


def _packed(legs: Floats, blocks: int, block: int) -> tuple[float, _Cells, Ints | None]:
    """Return a factor, 1 at most, cells of so much of the legs (F, 2) that fit, and their places."""
    low, high = 0.0, 2.0
    for _ in range(_STEPS):
        factor = (low + high) / 2
        if _shelves(_cells(factor * legs, block).sides, blocks) is None:
            high = factor
        else:
            low = factor
            if factor == 1:
                break
    cells = _cells(low * legs, block)
    return low, cells, _shelves(cells.sides, blocks)


def _cells(legs: Floats, block: int) -> _Cells:
    """Return cells for faces with legs (F, 2) of so many blocks, rounded.

    A level is read between the middles of its texels: a face alone needs half a block around it, and two that
    share a cell two more blocks each way between them.
    """
    whole = np.rint(legs).astype(np.int64)
    whole = np.where(whole[:, :1] > 0, np.maximum(whole, 1), 0)
    is_point = whole[:, 0] == 0
    is_paired = (whole + 3).prod(axis=1) < 2 * (whole + 1).prod(axis=1)
    sides = []
    of, number, count = np.zeros(len(legs), np.int64), np.zeros(len(legs), np.int64), 0
    for chosen, each, gap in (
        (is_paired, 2, 3),
        (~is_paired & ~is_point, 1, 1),
        (is_point, block * block, 1),
    ):
        faces = np.flatnonzero(chosen)
        faces = faces[np.lexsort((-whole[faces, 0], -whole[faces, 1]))]
        of[faces], number[faces] = np.divmod(np.arange(len(faces)), each)
        of[faces] += count
        starts = np.arange(0, len(faces), each)
        if len(starts):
            sides.append(np.maximum.reduceat(whole[faces], starts, axis=0) + gap)
        count += len(starts)
    return _Cells(np.concatenate(sides), whole, of, number)


def _shelves(sides: Ints, blocks: int) -> Ints | None:
    """Return the places (C, 2) of cells, side by side and row by row, the highest first; None: no room."""
    order = np.lexsort((-sides[:, 0], -sides[:, 1]))
    width, height = sides[order].T
    ends = np.cumsum(width)
    places = np.zeros_like(sides)
    first = y = 0
    while first < len(sides):
        left = ends[first] - width[first]
        last = int(np.searchsorted(ends, left + blocks, side="right"))
        if last == first or y + height[first] > blocks:
            return None
        row = slice(first, last)
        places[order[row], 0] = ends[row] - width[row] - left
        places[order[row], 1] = y
        y += int(height[first])
        first = last
    return places


def _placed(cells: _Cells, places: Ints, block: int) -> Floats:
    """Return the corners (F, 3, 2) of faces in texels: that of the right angle, then those along x and y."""
    place, sides = (block * each[cells.of][:, None] for each in (places, cells.sides))
    legs = block * cells.legs[:, None]
    corners = block / 2 + (legs - _SLACK) * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    turned = np.where(cells.number[:, None, None] > 0, sides - corners, corners)
    points = np.stack([cells.number % block, cells.number // block], axis=1)[:, None] + 0.5
    return np.asarray(place + np.where(legs > 0, turned, points))


def connected_atlas(vertices: NDArray[Any], faces: Ints, pixels: Floats, size: int) -> Singles:
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
    need_xatlas()
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


def need_xatlas() -> None:
    """Raise a UsageError, EXTRA_MISSING, if what cuts surfaces into charts is not installed."""
    need_extra("trial", "xatlas", what="a texture on a surface", instead="vertex colours need nothing")


def unwrapped(word: str, arrays: Arrays) -> tuple[Any, Arrays]:
    """Unwrap a mesh for a texture of `word` texels; a `Work` of `msb.base.children`."""
    import xatlas

    packing = xatlas.PackOptions()
    packing.resolution, packing.padding, packing.bilinear = int(word), _PADDING, True
    plane, faces, chart = _cut(arrays["vertices"], arrays["faces"])
    of_face = chart[faces[:, 0]]
    area, pixels = (
        np.bincount(of_face, values, len(plane)) for values in (_areas(plane[faces]), arrays["pixels"])
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
    placed = np.rint(uv.astype(np.float64) * sides / sides.max() * _PARTS)[faces] / _PARTS
    return {"charts": int(packed.chart_count)}, {"uv": placed.reshape(-1, 2).astype(np.float32)}


def _cut(vertices: Singles, faces: NDArray[np.uint32]) -> tuple[Floats, Ints, Ints]:
    """Return charts laid flat: places (n, 2) of vertices, faces (F, 3) of these, the chart (n,) of each."""
    import xatlas

    cut = xatlas.Atlas()
    blocks = _blocks(vertices[faces].mean(axis=1))
    for block in blocks:
        used, own = np.unique(faces[block], return_inverse=True)
        cut.add_mesh(vertices[used], own.reshape(-1, 3).astype(np.uint32))
    cut.generate()
    laid = np.zeros(faces.shape, np.int64)
    places: list[Floats] = []
    charts: list[Ints] = []
    count = 0
    for number, block in enumerate(blocks):
        _, own, uv = cut[number]
        laid[block] = own.astype(np.int64) + count
        count += len(uv)
        places.append(uv.astype(np.float64) * (cut.width, cut.height))
        charts.append(np.asarray(cut.get_mesh_vertex_assignment(number)[1]).astype(np.int64))
    chart = np.concatenate(charts)
    # That of no chart is a huge number: faces without area, which none shows.
    chart[chart >= cut.chart_count] = 0
    return np.concatenate(places), laid, chart


def _blocks(middles: Singles) -> list[Ints]:
    """Return the faces with these middles (F, 3), in halves of halves, none of them large."""
    blocks = [np.arange(len(middles))]
    while len(blocks[0]) > _AT_ONCE:
        halves = []
        for block in blocks:
            longest = np.ptp(middles[block], axis=0).argmax()
            along = block[np.argsort(middles[block, longest], kind="stable")]
            halves += [np.sort(half) for half in np.array_split(along, 2)]
        blocks = halves
    return blocks


def _areas(corners: Floats) -> Floats:
    """Return the areas (F,) of triangles (F, 3, 2 | 3)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    squares = (a * a).sum(axis=1) * (b * b).sum(axis=1) - np.square((a * b).sum(axis=1))
    return np.asarray(np.sqrt(np.maximum(squares, 0)) / 2)

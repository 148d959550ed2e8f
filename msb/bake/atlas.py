"""This module makes texture coordinates.

A triangle soup gets one texture cell per face. The library xatlas cuts a connected mesh into charts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msb.bake.arrays import Floats, Ints, Singles
from msb.bake.chart_merging import merge_small_charts
from msb.base.children import run_in_child
from msb.base.extras import need_extra
from msb.base.limits import Limits
from msb.errors import MeshError, UsageError
from msb.topology.faces import UNWRAP_FACES, split_into_blocks

if TYPE_CHECKING:
    from msb.base.children import Arrays

# Texture cells of a triangle soup.
#
# Number of smaller mip levels in which no texel mixes the colours of two faces. A second level doubles the
# margins around the faces. With two smaller mip levels, the faces may not fit. If two levels would shrink the
# sides of the faces below `_MIN_SCALE` of the requested lengths, only one level is used.
MIP_LEVELS = (2, 1)
_MIN_SCALE = 0.7
# Both legs of a face are shortened by this number of texels. Rounding to float32 then cannot move a corner
# into another texture cell.
_SLACK = 1 / 64
# Number of bisection steps for the largest scale that fits. With 16 steps, the scale is exact to 2^-15.
_BISECTIONS = 16
# Largest ratio of the two legs of a face in the texture. A narrower face would need too many texels for its
# margin.
_MAX_LEG_RATIO = 4.0

# Texture charts of a connected mesh.
#
# Time limit of xatlas in seconds. The benchmark meshes need far less time.
_UNWRAP_LIMITS = Limits(seconds=900.0, memory=None)
# Number of texels between two charts of the texture atlas. A distance of this size keeps texture charts
# separate in two smaller mip levels.
_PADDING = 4
# Texture coordinates are multiples of 1 / 65535, which files store in two bytes without loss.
_COORDINATE_STEPS = 65535
# Smallest scale of a chart relative to the median chart. The largest scale of a chart is the inverse of this
# value. Without limits on the scale, charts that a camera views from very near would fill the whole texture.
_MIN_CHART_SCALE = 1 / 4


class _Cells(NamedTuple):
    """Rectangular cells of a texture and the faces in them.

    All lengths are measured in blocks. A block is one texel of the smallest mip level that keeps faces
    separate.
    """

    # (C, 2) the width and height of each cell.
    sides: Ints
    # (F, 2) the lengths of the legs of each face. The length is 0 if the face is only a point.
    legs: Ints
    # (F,) the index of the cell that holds each face.
    cell: Ints
    # (F,) the index of each face among the faces of its cell.
    number: Ints


def make_soup_atlas(corners: NDArray[Any], pixels: Floats, size: int) -> Singles:
    """Return texture coordinates (3F, 2) of faces that share no vertices, in a texture of size x size texels.

    In the texture, each face is a right triangle. The ratio of the triangle's two legs is the ratio of the
    two shorter sides of the face. The triangle's area in texels is the number of pixels that show the face.
    If the texture is too small, all areas are reduced by the same factor. A face that no pixel shows becomes
    a point with one colour. A face whose longer leg is below half a block also becomes a point.

    Parameters
    ----------
    corners : (F, 3, 3) float
    pixels : (F,) float64
        The number of pixels that show each face.
    size : int
        Texels along a side.

    Raises
    ------
    UsageError
        USAGE: the texture has fewer texels than there are faces.
    """
    points = corners.astype(np.float64)
    sides = np.linalg.norm(points[:, [1, 2, 0]] - points[:, [2, 0, 1]], axis=2)
    # The right angle is at the corner across from the longest side. The longer leg lies along a row of
    # texels.
    order = np.argsort(-sides, axis=1, kind="stable")[:, [0, 2, 1]]
    # Legs (F, 2) in texels. The product of the two legs is twice the number of pixels, and their ratio is
    # limited.
    short, long = np.sort(sides, axis=1)[:, :2].T
    ratio = np.clip(np.divide(long, short, out=np.ones_like(long), where=short > 0), 1, _MAX_LEG_RATIO)
    legs = np.sqrt(2 * np.maximum(pixels, 0)[:, None] * np.stack([ratio, 1 / ratio], axis=1))
    for levels in MIP_LEVELS:
        block = 1 << levels
        scale, cells, places = _pack(legs / block, size // block, block)
        if scale >= _MIN_SCALE:
            break
    if places is None:
        text = f"{len(pixels):,} faces do not fit into a texture of {size} x {size} texels"
        raise UsageError("USAGE", f"{text}; pass a larger value of --texture")
    uvs = np.zeros((len(pixels), 3, 2))
    np.put_along_axis(uvs, order[..., None], _place_corners(cells, places, block) / size, axis=1)
    return uvs.reshape(-1, 2).astype(np.float32)


def _pack(legs: Floats, blocks: int, block: int) -> tuple[float, _Cells, Ints | None]:
    """Find the largest possible scale of the faces. Return the scale, the cells, and the places (C, 2) of the
    cells.

    The scale is at most 1. The places are None if no scale fits.
    """
    low, high = 0.0, 2.0
    for _ in range(_BISECTIONS):
        scale = (low + high) / 2
        if _fill_rows(_make_cells(scale * legs, block).sides, blocks) is None:
            high = scale
        else:
            low = scale
            if scale == 1:
                break
    cells = _make_cells(low * legs, block)
    return low, cells, _fill_rows(cells.sides, blocks)


def _make_cells(legs: Floats, block: int) -> _Cells:
    """Return the cells for faces with the legs (F, 2) in blocks. Each cell is rounded up to whole blocks.

    Sampling a mip level interpolates between texel centres. A single face in a texture therefore needs a
    margin of half a block on all sides.
    """
    whole = np.rint(legs).astype(np.int64)
    whole = np.where(whole[:, :1] > 0, np.maximum(whole, 1), 0)
    # If pairing needs less space, two faces share a cell, and one of these faces is rotated by 180 degrees.
    is_point = whole[:, 0] == 0
    is_paired = (whole + 3).prod(axis=1) < 2 * (whole + 1).prod(axis=1)
    sides = []
    cell, number, count = np.zeros(len(legs), np.int64), np.zeros(len(legs), np.int64), 0
    # For pairs of faces, single faces and points: the mask of the faces, the number of faces per cell, and
    # the margin in blocks.
    for chosen, per_cell, margin in (
        (is_paired, 2, 3),
        (~is_paired & ~is_point, 1, 1),
        (is_point, block * block, 1),
    ):
        # Sort the faces by size, so that faces with similar legs share a cell.
        faces = np.flatnonzero(chosen)
        faces = faces[np.lexsort((-whole[faces, 0], -whole[faces, 1]))]
        cell[faces], number[faces] = np.divmod(np.arange(len(faces)), per_cell)
        cell[faces] += count
        starts = np.arange(0, len(faces), per_cell)
        if len(starts):
            sides.append(np.maximum.reduceat(whole[faces], starts, axis=0) + margin)
        count += len(starts)
    return _Cells(np.concatenate(sides), whole, cell, number)


def _fill_rows(sides: Ints, blocks: int) -> Ints | None:
    """Place texture cells in rows, the highest first.

    Return the places (C, 2) of the cells. Return None if the cells do not fit.
    """
    order = np.lexsort((-sides[:, 0], -sides[:, 1]))
    width, height = sides[order].T
    ends = np.cumsum(width)
    places = np.zeros_like(sides)
    first = y = 0
    while first < len(sides):
        # A row holds as many cells as fit in its width. A row is as high as its first cell.
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


def _place_corners(cells: _Cells, places: Ints, block: int) -> Floats:
    """Return the corners (F, 3, 2) of faces in texels, first the corner with the right angle."""
    place, sides = (block * values[cells.cell][:, None] for values in (places, cells.sides))
    legs = block * cells.legs[:, None]
    corners = block / 2 + (legs - _SLACK) * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    # Rotate the second face of a cell by 180 degrees. Place faces without size at texel centres.
    turned = np.where(cells.number[:, None, None] > 0, sides - corners, corners)
    points = np.stack([cells.number % block, cells.number // block], axis=1)[:, None] + 0.5
    return np.asarray(place + np.where(legs > 0, turned, points))


def make_chart_atlas(vertices: NDArray[Any], faces: Ints, pixels: Floats, size: int) -> Singles:
    """Cut a mesh into charts with xatlas. Return texture coordinates (3F, 2) in a square texture.

    Parameters
    ----------
    vertices : (V, 3) float
    faces : (F, 3) int64
    pixels : (F,) float64
        The number of pixels that show each face. The area of a chart in texels is proportional to the pixels
        of its faces.
    size : int
        Texels along a side.

    Raises
    ------
    UsageError
        EXTRA_MISSING: xatlas is not installed.
    MeshError
        MESH_ARRAY: xatlas fails.
    """
    need_xatlas()
    # xatlas drops faces with an area below 1e-7, so scale the mesh to an average face area of 1.
    points = vertices.astype(np.float64)
    area = float(_measure_areas(points[faces]).mean())
    points = (points - points[faces].mean(axis=(0, 1))) / np.sqrt(area if area > 0 else 1)
    arrays = {
        "vertices": points.astype(np.float32),
        "faces": faces.astype(np.uint32),
        "pixels": np.asarray(pixels, np.float64),
    }
    reply = run_in_child(unwrap_in_child, str(size), arrays, _UNWRAP_LIMITS)
    if reply.why:
        raise MeshError("MESH_ARRAY", f"xatlas cannot unwrap these {len(faces):,} faces: {reply.why}")
    return np.asarray(reply.arrays["uv"])


def need_xatlas() -> None:
    """Raise a UsageError, EXTRA_MISSING, if xatlas is not installed."""
    need_extra(
        "trial", "xatlas", what="a texture on a closed surface", instead="vertex colours need no library"
    )


def unwrap_in_child(word: str, arrays: Arrays) -> tuple[Any, Arrays]:
    """Unwrap a mesh for a texture of `word` texels along a side, as a `Work` of `msb.base.children`."""
    import xatlas

    packing = xatlas.PackOptions()
    packing.resolution, packing.padding, packing.bilinear = int(word), _PADDING, True
    plane, faces, chart = _merge_charts(arrays, *_cut_charts(arrays["vertices"], arrays["faces"]))
    # Scale each chart so that its area in texels is the number of pixels of its faces, within limits.
    face_chart = chart[faces[:, 0]]
    area, pixels = (
        np.bincount(face_chart, values, len(plane))
        for values in (_measure_areas(plane[faces]), arrays["pixels"])
    )
    scale = np.sqrt(pixels / np.where(area > 0, area, 1))
    median = float(np.median(scale[pixels > 0])) if pixels.any() else 1.0
    scale = np.clip(scale, _MIN_CHART_SCALE * median, median / _MIN_CHART_SCALE)
    packed = xatlas.Atlas()
    packed.add_uv_mesh(
        (plane * scale[chart][:, None]).astype(np.float32), faces, face_chart[:, None].astype(np.uint32)
    )
    packed.generate(pack_options=packing)
    _, faces, uv = packed[0]
    # xatlas matches the requested atlas size only approximately. Scale all charts by one factor to the exact
    # size, so that they stay undistorted.
    sides = np.array([packed.width, packed.height])
    places = np.rint(uv.astype(np.float64) * sides / sides.max() * _COORDINATE_STEPS)[faces]
    uvs = (places / _COORDINATE_STEPS).reshape(-1, 2).astype(np.float32)
    return {"charts": int(packed.chart_count)}, {"uv": uvs}


def _merge_charts(arrays: Arrays, plane: Floats, faces: Ints, chart: Ints) -> tuple[Floats, Ints, Ints]:
    """Return flat charts like `_cut_charts`, with small charts merged into their neighbours."""
    vertices, whole = arrays["vertices"].astype(np.float64), arrays["faces"].astype(np.int64)
    corners, face_chart = merge_small_charts(vertices, whole, plane[faces], chart[faces[:, 0]])
    # Merge corners with the same vertex and the same place in a chart into one vertex of the chart.
    keys = np.column_stack([np.repeat(face_chart, 3), whole.reshape(-1), corners.reshape(-1, 2)])
    rows, joined = np.unique(keys, axis=0, return_inverse=True)
    # Renumber the charts consecutively.
    numbers = np.unique(rows[:, 0], return_inverse=True)[1]
    return (
        np.ascontiguousarray(rows[:, 2:]),
        joined.reshape(-1, 3).astype(np.int64),
        numbers.reshape(-1).astype(np.int64),
    )


def _cut_charts(vertices: Singles, faces: NDArray[np.uint32]) -> tuple[Floats, Ints, Ints]:
    """Return flat charts. A chart has vertex coordinates (n, 2) and faces (F, 3), and each vertex (n,) has
    the index of its chart."""
    import xatlas

    cut = xatlas.Atlas()
    blocks = split_into_blocks(vertices[faces].mean(axis=1), UNWRAP_FACES)
    for block in blocks:
        used, local = np.unique(faces[block], return_inverse=True)
        cut.add_mesh(vertices[used], local.reshape(-1, 3).astype(np.uint32))
    cut.generate()
    # Join the blocks again. Number the vertices one block after the other.
    joined = np.zeros(faces.shape, np.int64)
    places: list[Floats] = []
    charts: list[Ints] = []
    count = 0
    for number, block in enumerate(blocks):
        _, local, uv = cut[number]
        joined[block] = local.astype(np.int64) + count
        count += len(uv)
        places.append(uv.astype(np.float64) * (cut.width, cut.height))
        charts.append(np.asarray(cut.get_mesh_vertex_assignment(number)[1]).astype(np.int64))
    chart = np.concatenate(charts)
    # xatlas puts faces without an area in no chart, and gives the faces a huge chart number. Any chart is
    # suitable, because faces without an area are invisible.
    chart[chart >= cut.chart_count] = 0
    return np.concatenate(places), joined, chart


def _measure_areas(corners: Floats) -> Floats:
    """Return the areas (F,) of triangles (F, 3, 2 | 3)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    squares = (a * a).sum(axis=1) * (b * b).sum(axis=1) - np.square((a * b).sum(axis=1))
    return np.asarray(np.sqrt(np.maximum(squares, 0)) / 2)

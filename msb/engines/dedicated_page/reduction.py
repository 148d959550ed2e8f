"""Reduces assets for pages: rounds values, and keeps only the faces that contribute most.

A reduced asset is still an asset of its method, so any renderer can measure the loss of quality. `storage`
compresses the rounded values well, because positions lie on a grid and other columns have at most 256
distinct values.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.engines.dedicated_page.storage import CHUNK, LEVELS, find_exponents

# Largest extent of a position chunk, in grid steps. The extent is below 65,535, because rounding may add one
# step.
GRID = 65000
# Buffers whose values are rounded to 256 values per column.
_ROUNDED = ("f_dc", "f_rest", "opacity", "sigma")
# Feature lattices with values from 0 to 1. Lattice values are rounded to bytes, as in the official web
# export.
_BYTES = ("features.lattice", "features.opacity")
# Number of histogram bins for choosing the 256 values.
_BINS = 4096
# Columns with more rows than this are rounded without counting their distinct values.
_FEW = 4 * LEVELS


def quantise(asset: Asset) -> Asset:
    """Return `asset` with positions rounded to 16 bits per chunk of neighbours, and other values to 8 bits.

    Faces and vertices are reordered along a space-filling curve, so that neighbours share a chunk. Reordering
    may change the blending order of faces at exactly equal depths.
    """
    buffers = dict(asset.buffers)
    _reorder_along_curve(asset, buffers)
    # Round the positions (V, 3) to multiples of a step. The step of a chunk is a power of two. Adding 0
    # changes -0 to 0.
    positions = buffers["positions"]
    steps = np.exp2(find_exponents(positions, GRID).astype(np.float64))[
        np.arange(len(positions)) // CHUNK, None
    ]
    buffers["positions"] = (np.rint(positions / steps) * steps).astype(np.float32) + np.float32(0)
    for name in _ROUNDED:
        if name in buffers:
            rows = buffers[name].reshape(len(buffers[name]), -1)
            columns = [_round_to_levels(rows[:, k]) for k in range(rows.shape[1])]
            buffers[name] = np.stack(columns, axis=1).reshape(buffers[name].shape)
    for name in _BYTES:
        if name in buffers and buffers[name].dtype != np.uint8:
            buffers[name] = np.rint(np.clip(buffers[name], 0, 1) * np.float32(255)).astype(np.uint8)
    return _with_buffers(asset, buffers)


def _round_to_levels(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return values (N,) rounded to 256 levels.

    The levels are distributed with the cube root of the value density. The cube root minimises the squared
    error (Panter and Dite, 1951). The minimum and the maximum of the values do not change.
    """
    finite = values[np.isfinite(values)]
    if not len(finite):
        return values
    low, high = float(finite.min()), float(finite.max())
    if (len(values) <= _FEW or low == high) and len(np.unique(values)) <= LEVELS:
        return values
    # Integrate the cube root of the histogram, and space the levels equally in this integral.
    edges = np.linspace(low, high, _BINS + 1)
    count = np.histogram(finite, edges)[0].astype(np.float64)
    integral = np.concatenate([[0], np.cumsum(np.cbrt(count))])
    # Four of the 256 levels are reserved: minus infinity, plus infinity, the minimum and the maximum.
    inner = np.interp(np.linspace(0, integral[-1], 2 * (LEVELS - 4) + 1)[1::2], integral, edges)
    levels = np.unique(np.concatenate([[low], inner, [high]]).astype(np.float32))
    nearest = np.searchsorted((levels[1:] + levels[:-1]) / 2, values)
    return np.where(np.isfinite(values), levels[nearest], values)


def _reorder_along_curve(asset: Asset, buffers: dict[str, NDArray[Any]]) -> None:
    """Sort faces by their centroids along a Morton curve, and vertices by their first use, in place."""
    positions, indices = buffers["positions"], buffers["indices"].astype(np.int64)
    corners = positions[indices]
    order = np.argsort(_morton_keys(corners.mean(axis=1)), kind="stable")
    indices = indices[order]
    # Sort the vertices by their first use in the sorted faces; unused vertices come last.
    used, first = np.unique(indices, return_index=True)
    vertices = np.concatenate([used[np.argsort(first)], np.setdiff1d(np.arange(len(positions)), used)])
    number = np.zeros(len(positions), np.int64)
    number[vertices] = np.arange(len(positions))
    buffers["indices"] = number[indices].astype(np.uint32)
    # Reorder the rows of all other buffers.
    for name, spec in asset.manifest.buffers.items():
        if name == "indices":
            continue
        rows = {"face": order, "vertex": vertices}.get(spec.domain)
        if rows is not None:
            buffers[name] = buffers[name][rows]
        elif spec.domain == "corner":
            per_face = buffers[name].reshape(len(order), 3, -1)[order]
            buffers[name] = per_face.reshape(buffers[name].shape)


def _morton_keys(points: NDArray[np.float32]) -> NDArray[np.uint64]:
    """Return the index (N,) of each point (N, 3) along a Morton curve, with 16 bits per axis.

    The curve fills a box from the 1st to the 99th percentile of each coordinate. The percentiles
    exclude a few distant faces, which would reduce the resolution of the curve.
    """
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    share = np.clip((points - low) / np.maximum(high - low, 1e-30), 0, 1)
    cells = (share * 65535).astype(np.uint64)
    # Interleave the bits of the three integer coordinates.
    key = np.zeros(len(points), np.uint64)
    for bit in range(16):
        for axis in range(3):
            key |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return key


def select_faces(asset: Asset, faces: NDArray[np.integer[Any]]) -> Asset:
    """Return `asset` reduced to the faces with the indices `faces`, in this order, and to their vertices."""
    buffers = dict(asset.buffers)
    indices = buffers["indices"][faces].astype(np.int64)
    vertices, number = np.unique(indices, return_inverse=True)
    buffers["indices"] = number.reshape(-1, 3).astype(np.uint32)
    for name, spec in asset.manifest.buffers.items():
        if name == "indices":
            continue
        if spec.domain == "vertex":
            buffers[name] = buffers[name][vertices]
        elif spec.domain == "face":
            buffers[name] = buffers[name][faces]
        elif spec.domain == "corner":
            corners = buffers[name].reshape(asset.manifest.face_count, 3, -1)[faces]
            buffers[name] = corners.reshape(-1, *buffers[name].shape[1:])
    return _with_buffers(asset, buffers)


def _with_buffers(asset: Asset, buffers: Mapping[str, NDArray[Any]]) -> Asset:
    """Return a copy of `asset` with read-only buffers, and a manifest for these buffers."""
    specs = {
        name: replace(spec, shape=tuple(buffers[name].shape), dtype=buffers[name].dtype.name)
        for name, spec in asset.manifest.buffers.items()
    }
    arrays = {name: np.ascontiguousarray(array) for name, array in buffers.items()}
    for array in arrays.values():
        array.flags.writeable = False
    manifest = replace(
        asset.manifest,
        buffers=specs,
        face_count=len(arrays["indices"]),
        vertex_count=len(arrays["positions"]),
    )
    return replace(asset, manifest=manifest, buffers=MappingProxyType(arrays))

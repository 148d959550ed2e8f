"""Smaller assets for pages: rounded values, and only the faces that contribute most.

Rounding keeps an asset an asset of the same method, so that any renderer says what it costs. What it leaves
is what `stored` packs without a loss: positions on a grid by chunks, and few values a column.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset import Asset
from msb.engines.dedicated_page.stored import CHUNK, LEVELS, exponents

# Steps that a chunk's positions span at most: fewer than 16 bits have: rounding may add one.
GRID = 65000
_ROUNDED = ("f_dc", "f_rest", "opacity", "sigma")
# Lattices of numbers from 0 to 1: those of the official web export are bytes, too.
_BYTES = ("features.lattice", "features.opacity")
_BINS = 4096
_FEW = 4 * LEVELS


def quantised(asset: Asset) -> Asset:
    """Return `asset` with positions of 16 bits a chunk of neighbours, and 8 bits of everything else.

    Faces, and the vertices of meshes, come in another order: along a curve through space, so that neighbours
    share a chunk. Faces whose depths are exactly equal may then be blended in another order.
    """
    buffers = dict(asset.buffers)
    _along_a_curve(asset, buffers)
    positions = buffers["positions"]
    steps = np.exp2(exponents(positions, GRID).astype(np.float64))[np.arange(len(positions)) // CHUNK, None]
    # A zero without a sign, as the grid gives it.
    buffers["positions"] = (np.rint(positions / steps) * steps).astype(np.float32) + np.float32(0)
    for name in _ROUNDED:
        if name in buffers:
            rows = buffers[name].reshape(len(buffers[name]), -1)
            columns = [_rounded(rows[:, k]) for k in range(rows.shape[1])]
            buffers[name] = np.stack(columns, axis=1).reshape(buffers[name].shape)
    for name in _BYTES:
        if name in buffers and buffers[name].dtype != np.uint8:
            buffers[name] = np.rint(np.clip(buffers[name], 0, 1) * np.float32(255)).astype(np.uint8)
    return _with(asset, buffers)


def _rounded(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return values rounded to 256 of them, which lie as densely as the cube root of the values' density.

    That makes the squared error least (Panter and Dite, 1951). The smallest and largest value stay.
    """
    finite = values[np.isfinite(values)]
    if not len(finite):
        return values
    low, high = float(finite.min()), float(finite.max())
    if (len(values) <= _FEW or low == high) and len(np.unique(values)) <= LEVELS:
        return values
    edges = np.linspace(low, high, _BINS + 1)
    count = np.histogram(finite, edges)[0].astype(np.float64)
    grown = np.concatenate([[0], np.cumsum(np.cbrt(count))])
    # Of 256 levels, two are reserved for infinities and two for low and high.
    inner = np.interp(np.linspace(0, grown[-1], 2 * (LEVELS - 4) + 1)[1::2], grown, edges)
    levels = np.unique(np.concatenate([[low], inner, [high]]).astype(np.float32))
    nearest = np.searchsorted((levels[1:] + levels[:-1]) / 2, values)
    return np.where(np.isfinite(values), levels[nearest], values)


def _along_a_curve(asset: Asset, buffers: dict[str, NDArray[Any]]) -> None:
    """Put the faces in the order of their centroids along a Morton curve; vertices in that of their faces."""
    positions, indices = buffers["positions"], buffers["indices"].astype(np.int64)
    corners = positions[indices]
    order = np.argsort(_morton(corners.mean(axis=1)), kind="stable")
    indices = indices[order]
    # Vertices in the order in which faces name them, those that no face names last.
    named, first = np.unique(indices, return_index=True)
    vertices = np.concatenate([named[np.argsort(first)], np.setdiff1d(np.arange(len(positions)), named)])
    place = np.zeros(len(positions), np.int64)
    place[vertices] = np.arange(len(positions))
    buffers["indices"] = place[indices].astype(np.uint32)
    for name, spec in asset.manifest.buffers.items():
        if name == "indices":
            continue
        rows = {"face": order, "vertex": vertices}.get(spec.domain)
        if rows is not None:
            buffers[name] = buffers[name][rows]
        elif spec.domain == "corner":
            per_face = buffers[name].reshape(len(order), 3, -1)[order]
            buffers[name] = per_face.reshape(buffers[name].shape)


def _morton(points: NDArray[np.float32]) -> NDArray[np.uint64]:
    """Return the positions of points along a Morton curve through their box, 16 bits an axis.

    The box leaves out the farthest hundredth of each side, so that a few faces far away cost no resolution.
    """
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    share = np.clip((points - low) / np.maximum(high - low, 1e-30), 0, 1)
    cells = (share * 65535).astype(np.uint64)
    key = np.zeros(len(points), np.uint64)
    for bit in range(16):
        for axis in range(3):
            key |= ((cells[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return key


def with_faces(asset: Asset, faces: NDArray[np.integer[Any]]) -> Asset:
    """Return `asset` with these faces alone, in their order, and the vertices that they have."""
    buffers = dict(asset.buffers)
    indices = buffers["indices"][faces].astype(np.int64)
    vertices, place = np.unique(indices, return_inverse=True)
    buffers["indices"] = place.reshape(-1, 3).astype(np.uint32)
    for name, spec in asset.manifest.buffers.items():
        if name == "indices":
            continue
        if spec.domain == "vertex":
            buffers[name] = buffers[name][vertices]
        elif spec.domain == "face":
            buffers[name] = buffers[name][faces]
        elif spec.domain == "corner":
            kept = buffers[name].reshape(asset.manifest.face_count, 3, -1)[faces]
            buffers[name] = kept.reshape(-1, *buffers[name].shape[1:])
    return _with(asset, buffers)


def _with(asset: Asset, buffers: Mapping[str, NDArray[Any]]) -> Asset:
    """Return an asset in memory of these buffers, described as `asset` is."""
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

"""A model on the device: faces in an order that suits drawing, with bounding spheres.

Checkpoints hold faces in the order in which training made them, so what a view keeps is scattered over all
of memory. Here faces of about the same size that are close together in space lie together. Nobody sees that:
faces keep their numbers, and those of equal depth are blended in the order of the asset.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msb.cl.sort import sort_pairs

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from msb.cl import Buffer, Device, Program
    from msb.render.tenancy import Tenancy

LANES = {"cpu": 8, "gpu": 1}
"""Faces, or samples of a row, that a work-item takes at once. Never 16: PoCL crashes (docs/opencl.md)."""
WORK_GROUP = 64
_GROUP = 64
"""GROUP in splat_bounds.cl."""
_AXIS_BITS = 18
"""AXIS_BITS in splat_order.cl."""
_KEY_BITS = 3 * _AXIS_BITS + 8
_PIECE = 1 << 14
"""Rows that are put in order at a time: what is read and written of them stays in the cache."""
_NOTHING = np.zeros(1, np.float32)
"""Stands for an array the kernels of a method do not read."""


def keep_model(
    tenancy: Tenancy,
    program: Program,
    count: int,
    arrays: Mapping[str, NDArray[np.generic] | None],
    *,
    ordered: bool,
) -> None:
    """Keep what the kernels read of a model.

    Parameters
    ----------
    tenancy : Tenancy
        Gets all of the arrays by their names, "numbers" (uint32, of the face in each row), "bounds" and, for
        the CPU style, "groups" (splat_bounds.cl says what they hold).
    program : Program
        Of the method.
    count : int
        F, of faces.
    arrays : mapping of str to array or None
        "positions" and "indices" among them.
    ordered : bool
        All of the arrays have F rows, and are kept in drawing order. Else they are kept as they are: faces of
        a mesh share vertices, and to fetch those is what costs.
    """
    kept, device = tenancy.kept, tenancy.device
    for name in ("positions", "indices") if ordered else arrays:
        array = arrays[name]
        tenancy.keep(name, _NOTHING if array is None else array)
    kept["bounds"] = device.allocate((4, _lanes_up(tenancy, count)), np.float32, "bounds")
    _bound_faces(tenancy, program, count)
    order = np.arange(count, dtype=np.uint32)
    if ordered:
        order = _drawing_order(device, kept["bounds"], count)
        kept["positions"].release()
        for name, array in arrays.items():
            kept[name] = device.share(_NOTHING if array is None else _in_order(array, order), name)
        _bound_faces(tenancy, program, count)
    tenancy.keep("numbers", order)
    if device.style == "cpu":
        _bound_groups(tenancy, program, count)


def _lanes_up(tenancy: Tenancy, count: int) -> int:
    lanes = LANES[tenancy.device.style]
    return -(-count // lanes) * lanes


def _bound_faces(tenancy: Tenancy, program: Program, count: int) -> None:
    """Find every face's bounding sphere, by which most of those out of view are dropped."""
    kept, stride = tenancy.kept, tenancy.kept["bounds"].shape[1]
    arguments = kept["positions"], kept["indices"], kept["bounds"], np.uint32(stride), np.uint32(count)
    program.bound_faces(stride // LANES[tenancy.device.style], WORK_GROUP, *arguments)


def _bound_groups(tenancy: Tenancy, program: Program, count: int) -> None:
    """Find bounding spheres of groups of faces, by which most of those are dropped."""
    groups = -(-count // _GROUP)
    bounds, stride = tenancy.kept["bounds"], _lanes_up(tenancy, groups)
    tenancy.kept["groups"] = made = tenancy.device.allocate((4, stride), np.float32, "groups")
    sizes = map(np.uint32, (bounds.shape[1], stride, count))
    program.bound_groups(groups, WORK_GROUP, bounds, made, *sizes)


def _drawing_order(device: Device, bounds: Buffer, count: int) -> NDArray[np.uint32]:
    """Return the number of the face in each row; `bounds` are those of the faces by number."""
    with bounds.mapped() as found:
        low, high = found[:3, :count].min(axis=1), found[:3, :count].max(axis=1)
    span = np.max(high.astype(np.float64) - low)
    scale = np.float32(((1 << _AXIS_BITS) - 1) / span if 0 < span < np.inf else 0)
    keys = device.scratch("splat order keys", count, np.uint64)
    sizes = np.uint32(bounds.shape[1]), np.uint32(count)
    device.program("splat_order").order_keys(count, WORK_GROUP, bounds, keys, *sizes, *low, scale)
    _, numbers = sort_pairs(device, keys, bits=_KEY_BITS, name="splat face sort")
    order: NDArray[np.uint32] = numbers.read()
    device.release_scratch("splat order keys")
    device.release_scratch("splat face sort")
    return order


def _in_order(array: NDArray[np.generic], order: NDArray[np.uint32]) -> NDArray[np.generic]:
    found = np.zeros(array.shape, array.dtype)
    for start in range(0, len(order), _PIECE):
        here = slice(start, start + _PIECE)
        np.take(array, order[here], axis=0, out=found[here], mode="clip")
    return found

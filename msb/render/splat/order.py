"""A model on the device: faces in an order that suits drawing, with bounding spheres.

Checkpoints hold faces in the order in which training made them, so what a view keeps is scattered over all
of memory. Here what is close together in space lies together, in soups faces of about the same size. Nobody
sees that: faces keep their numbers, and those of equal depth are blended in the order of the asset.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from msb.cl.sort import sort_pairs
from msb.errors import DeviceError
from msb.render.splat.launch import LANES, WORK_GROUP

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from msb.cl import Buffer, Device, Program
    from msb.render.backend import Group
    from msb.render.device_scope import DeviceScope

_GROUP = 64
"""GROUP in splat_bounds.cl."""
_AXIS_BITS = 18
"""AXIS_BITS in splat_order.cl."""
_SIZE_BITS = 8
_PIECE = 1 << 14
"""Rows that are put in order at a time: what is read and written of them stays in the cache."""
_NOTHING = np.zeros(1, np.float32)
"""Stands for an array the kernels of a method do not read."""
_MOST = 4
"""A model that takes more than one in so many of the device's bytes is left as it is."""

Arrays = Mapping[str, "NDArray[np.generic] | None"]
"""What the kernels read of a model, "positions" and "indices" among it."""


def keep_model(scope: DeviceScope, program: Program, count: int, arrays: Arrays) -> None:
    """Keep a model of `count` faces as it is stored.

    The scope gets all of the arrays by their names, "numbers" (uint32, of the face in each row), "bounds"
    and, for the CPU style, "groups" (splat_bounds.cl says what they hold). `program` is the method's.
    """
    kept, device = scope.kept, scope.device
    for name, array in arrays.items():
        group: Group = "appearance" if name in ("f_dc", "f_rest") else "geometry"
        scope.keep(name, _NOTHING if array is None else array, group)
    scope.keep("numbers", np.arange(count, dtype=np.uint32))
    kept["bounds"] = device.allocate((4, _lanes_up(device, count)), np.float32, "bounds", "geometry")
    if device.style == "cpu":
        kept["groups"] = device.allocate(
            (4, _lanes_up(device, -(-count // _GROUP))), np.float32, "groups", "geometry"
        )
    _bound(scope, program, count)


def order_model(scope: DeviceScope, program: Program, count: int, arrays: Arrays) -> bool:
    """Put a model that is kept in drawing order: `count` faces, and with them what belongs to each.

    Of a mesh that are the indices alone; its vertices, with what belongs to them, follow the same curve. The
    model becomes a copy of what may have been a mapped file. Return False, and leave everything as it is,
    where there is little room for that.
    """
    kept, device = scope.kept, scope.device
    given = {name: array for name, array in arrays.items() if array is not None}
    if _MOST * sum(array.nbytes for array in given.values()) > device.record.global_memory:
        return False
    indices = given.pop("indices", None)
    try:
        faces = rows = _curve_order(device, kept["bounds"], count, by_size=indices is None)
        if indices is not None:
            rows = _vertex_order(device, given["positions"])
        ordered = {name: _in_order(array, rows) for name, array in given.items()}
        if indices is not None:
            ordered["indices"] = _renumbered(_in_order(indices, faces), rows)
    except MemoryError:
        return False
    except DeviceError as error:
        if error.code != "DEVICE_MEMORY":
            raise
        return False
    finally:
        device.release_scratch("splat order ")
        device.release_scratch("splat face sort")
    for name, array in {**ordered, "numbers": faces}.items():
        kept[name].release()
        kept[name] = device.share(array, name, kept[name].group)
    _bound(scope, program, count)
    return True


def _lanes_up(device: Device, count: int) -> int:
    lanes = LANES[device.style]
    return -(-count // lanes) * lanes


def _bound(scope: DeviceScope, program: Program, count: int) -> None:
    """Find the bounding spheres of faces, by which most of those out of view are dropped, and of groups."""
    kept, style = scope.kept, scope.device.style
    bounds = kept["bounds"]
    faces, stride = np.uint32(count), np.uint32(bounds.shape[1])
    items = bounds.shape[1] // LANES[style]
    program.bound_faces(items, WORK_GROUP, kept["positions"], kept["indices"], bounds, stride, faces)
    if style == "cpu":
        groups = kept["groups"]
        strides = stride, np.uint32(groups.shape[1])
        program.bound_groups(-(-count // _GROUP), WORK_GROUP, bounds, groups, *strides, faces)


def _curve_order(device: Device, points: Buffer, count: int, *, by_size: bool) -> NDArray[np.uint32]:
    """Return the number of the face or vertex in each row; `points` are (4, n) and have coordinates first."""
    with points.mapped() as found:
        low, high = found[:3, :count].min(axis=1), found[:3, :count].max(axis=1)
    span = np.max(high.astype(np.float64) - low)
    scale = np.float32(((1 << _AXIS_BITS) - 1) / span if 0 < span < np.inf else 0)
    keys = device.scratch("splat order keys", count, np.uint64)
    sizes = np.uint32(points.shape[1]), np.uint32(count)
    order_keys = device.program("splat_order").order_keys
    order_keys(count, WORK_GROUP, points, keys, *sizes, *low, scale, np.uint32(by_size))
    bits = 3 * _AXIS_BITS + (_SIZE_BITS if by_size else 0)
    return sort_pairs(device, keys, bits=bits, name="splat face sort")[1].read()


def _vertex_order(device: Device, positions: NDArray[np.generic]) -> NDArray[np.uint32]:
    count = len(positions)
    points = device.scratch("splat order points", (4, count), np.float32)
    points.write(np.ascontiguousarray(positions.T))
    return _curve_order(device, points, count, by_size=False)


def _renumbered(indices: NDArray[np.generic], order: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return `indices` into rows that were put in that order."""
    places = np.zeros_like(order)
    places[order] = np.arange(len(order), dtype=np.uint32)
    found: NDArray[np.uint32] = places[indices]
    return found


def _in_order(array: NDArray[np.generic], order: NDArray[np.uint32]) -> NDArray[np.generic]:
    # In huge pages, unlike zeros.
    found = np.empty(array.shape, array.dtype)  # noqa: TID251 - filled below
    for start in range(0, len(order), _PIECE):
        here = slice(start, start + _PIECE)
        np.take(array, order[here], axis=0, out=found[here], mode="clip")
    return found

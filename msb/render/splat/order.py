"""The faces of a model on the device, in an order that makes rendering fast, and their bounding spheres.

Checkpoints store faces in the order of training, so the faces in view are scattered over the whole memory.
This module sorts faces along a space-filling curve. In triangle soups, faces of similar size also become
neighbours. Results do not change. Faces keep their numbers, and faces of equal depth are blended in the order
of the asset.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np
from numpy.typing import NDArray

from msb.cl import Buffer, Device, Program
from msb.cl.sort import sort_pairs
from msb.errors import DeviceError
from msb.render.backend import Group
from msb.render.device_scope import DeviceScope
from msb.render.splat.bins import LANES, WORK_GROUP

# Number of faces that share a bounding sphere in CPU style.
FACE_GROUP = 64
# Bits of a sort key for each axis. Three axes take 54 of 64 bits. The other bits are for the exponent of the
# face size.
_AXIS_BITS = 18
# Bits of a sort key for the face size, which is the exponent of the inradius.
_SIZE_BITS = 8
# Number of rows that are permuted at a time; this number of rows fits into the processor's cache.
_PIECE = 1 << 14
# Placeholder for an array that the kernels of a method do not read.
_NOTHING = np.zeros(1, np.float32)
# A model is sorted only if it takes at most this share of the device's memory, because sorting needs a copy.
_MODEL_SHARE = 1 / 4

# The arrays of the model that kernels read, by name; "positions" and "indices" always exist.
Arrays = Mapping[str, "NDArray[np.generic] | None"]

_few: ContextVar[bool] = ContextVar("_few", default=False)


@contextmanager
def few_frames() -> Iterator[None]:
    """Do not sort models within this ``with`` block.

    Use this block to draw few frames, when sorting would take longer than it saves.
    """
    token = _few.set(True)
    try:
        yield
    finally:
        _few.reset(token)


def keep_model(scope: DeviceScope, program: Program, count: int, arrays: Arrays) -> None:
    """Keep a model of `count` faces on the device in stored order.

    The scope receives every array under its name. The scope also receives "numbers", the face number of each
    row as uint32. The scope further receives "bounds" and, in CPU style, "groups", which splat_bounds.cl
    describes. `program` is the method's program.
    """
    kept, device = scope.kept, scope.device
    for name, array in arrays.items():
        group: Group = "appearance" if name in ("f_dc", "f_rest") else "geometry"
        scope.keep(name, _NOTHING if array is None else array, group)
    scope.keep("numbers", np.arange(count, dtype=np.uint32))
    kept["bounds"] = device.allocate((4, _round_to_lanes(device, count)), np.float32, "bounds", "geometry")
    if device.style == "cpu":
        kept["groups"] = device.allocate(
            (4, _round_to_lanes(device, -(-count // FACE_GROUP))), np.float32, "groups", "geometry"
        )
    _compute_bounds(scope, program, count)


def order_model(scope: DeviceScope, program: Program, count: int, arrays: Arrays) -> bool:
    """Sort the `count` faces of a model that the scope keeps. Return whether the faces were sorted.

    In a triangle soup all per-face arrays are permuted together. In an indexed mesh the index rows are
    permuted, and the vertex arrays are sorted along the same curve. The kept model becomes a copy in
    memory, even if its arrays were mapped files. The function returns False, and changes nothing, within
    `few_frames` or if memory is too small for a copy.
    """
    if _few.get():
        return False
    kept, device = scope.kept, scope.device
    given = {name: array for name, array in arrays.items() if array is not None}
    if sum(array.nbytes for array in given.values()) > _MODEL_SHARE * device.record.global_memory:
        return False
    indices = given.pop("indices", None)
    try:
        # Compute the new order of the faces, and in indexed meshes the new order of the vertices.
        positions = given["positions"]
        faces = rows = _curve_order(device, kept["bounds"], count, by_size=indices is None)
        if indices is not None:
            rows = _vertex_order(device, positions)
        ordered = {name: _permute(array, rows) for name, array in given.items()}
        if indices is not None:
            ordered["indices"] = _renumber(indices, faces, rows)
    except MemoryError:
        return False
    except DeviceError as error:
        if error.code != "DEVICE_MEMORY":
            raise
        return False
    finally:
        device.release_scratch("splat order ")
        device.release_scratch("splat face sort")
    # Replace the arrays on the device by the sorted copies.
    for name, array in {**ordered, "numbers": faces}.items():
        kept[name].release()
        kept[name] = device.share(array, name, kept[name].group)
    _compute_bounds(scope, program, count)
    return True


def _round_to_lanes(device: Device, count: int) -> int:
    """Return `count` rounded up to a whole number of the device's lanes."""
    lanes = LANES[device.style]
    return -(-count // lanes) * lanes


def _compute_bounds(scope: DeviceScope, program: Program, count: int) -> None:
    """Compute the bounding spheres of faces and groups of faces, which cull most faces outside the view."""
    kept, style = scope.kept, scope.device.style
    bounds = kept["bounds"]
    faces, stride = np.uint32(count), np.uint32(bounds.shape[1])
    items = bounds.shape[1] // LANES[style]
    program.bound_faces(items, WORK_GROUP, kept["positions"], kept["indices"], bounds, stride, faces)
    if style == "cpu":
        groups = kept["groups"]
        strides = stride, np.uint32(groups.shape[1])
        program.bound_groups(-(-count // FACE_GROUP), WORK_GROUP, bounds, groups, *strides, faces)


def _curve_order(device: Device, points: Buffer, count: int, *, by_size: bool) -> NDArray[np.uint32]:
    """Return the face or vertex number for each row of the new order.

    The first three rows of `points` (4, n) are x, y and z. With `by_size` the faces are first sorted by size.
    """
    with points.mapped() as rows:
        low, high = rows[:3, :count].min(axis=1), rows[:3, :count].max(axis=1)
    # Scale all axes alike, so that the longest side of the bounding box uses all bits.
    span = np.max(high.astype(np.float64) - low)
    scale = np.float32(((1 << _AXIS_BITS) - 1) / span if 0 < span < np.inf else 0)
    keys = device.scratch("splat order keys", count, np.uint64)
    sizes = np.uint32(points.shape[1]), np.uint32(count)
    order_keys = device.program("splat_order", {"AXIS_BITS": _AXIS_BITS}).order_keys
    order_keys(count, WORK_GROUP, points, keys, *sizes, *low, scale, np.uint32(by_size))
    bits = 3 * _AXIS_BITS + (_SIZE_BITS if by_size else 0)
    return sort_pairs(device, keys, bits=bits, name="splat face sort")[1].read()


def _vertex_order(device: Device, positions: NDArray[np.generic]) -> NDArray[np.uint32]:
    """Return the numbers of the vertices in the order of the curve."""
    count = len(positions)
    points = device.scratch("splat order points", (4, count), np.float32)
    points.write(np.ascontiguousarray(positions.T))
    return _curve_order(device, points, count, by_size=False)


def _renumber(
    indices: NDArray[np.generic], faces: NDArray[np.uint32], order: NDArray[np.uint32]
) -> NDArray[np.uint32]:
    """Return `indices` in the order of `faces`, with vertex numbers replaced by their rows in `order`."""
    places = np.zeros_like(order)
    places[order] = np.arange(len(order), dtype=np.uint32)
    renumbered: NDArray[np.uint32] = places[_permute(indices, faces)]
    return renumbered


def _permute(array: NDArray[np.generic], order: NDArray[np.uint32]) -> NDArray[np.generic]:
    """Return the rows of `array` in the given order."""
    # numpy.empty allocates huge pages, but numpy.zeros does not.
    ordered = np.empty(array.shape, array.dtype)  # noqa: TID251 - filled below
    for start in range(0, len(order), _PIECE):
        here = slice(start, start + _PIECE)
        np.take(array, order[here], axis=0, out=ordered[here], mode="clip")
    return ordered

"""Carry the data of vertices, faces and corners through a change of the mesh."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from msb.errors import Unsupported
from msb.topology.halfedge import NONE

if TYPE_CHECKING:
    from msb.topology.steps.change import Change, Rims

    Buffers = Mapping[str, NDArray[Any]]

# Face buffers whose values do not depend on the order of the corners.
_ORDER_FREE = {"color", "f_dc", "f_rest", "opacity", "sigma", "face_texture"}
# Names of corner buffers. The values of these buffers are interpolated along an edge for added faces.
_INTERPOLATED = {"uv", "color"}
# Names of DiffSoup's buffers with samples on a barycentric lattice. The samples are permuted when a face is
# turned.
_LATTICES = {"features.lattice", "features.opacity"}


def carry(
    buffers: Buffers, domains: Mapping[str, str], change: Change, level: int | None = None
) -> dict[str, NDArray[Any]]:
    """Return the buffers of the changed mesh.

    Rows of unchanged vertices and faces are copied. A new vertex gets the average of the surrounding
    vertices, which are its rim (`Rims`). Each added face gets the values of an adjacent face. An added face
    has two corners in common with an adjacent face, and copies the values there. At its third corner, the
    added face gets the average of these two values.

    The argument `domains` gives the domain of each buffer: "vertex", "face", "corner" or "global". The
    argument `level` is the level of DiffSoup's lattice, if the mesh has one.
    """
    known = {**domains, "positions": "vertex", "indices": "face"}
    return {
        name: change.faces.astype(array.dtype)
        if name == "indices"
        else _carry_corners(name, array, change, buffers["indices"])
        if known[name] == "corner"
        else _carry_rows(name, array, known[name], change, level)
        for name, array in buffers.items()
    }


def _carry_rows(
    name: str, array: NDArray[Any], domain: str, change: Change, level: int | None
) -> NDArray[Any]:
    """Return a vertex, face or global buffer of the changed mesh."""
    if domain == "vertex":
        kept = array[change.vertex_map[: len(change.vertex_map) - change.rims.count]]
        if change.rims.count == 0:
            return np.asarray(kept)
        return np.concatenate([kept, _average_rims(name, array, change.rims)])
    if domain == "face":
        return _carry_faces(name, array, change, level)
    return array


def _carry_faces(name: str, array: NDArray[Any], change: Change, level: int | None) -> NDArray[Any]:
    """Return a face buffer of the changed mesh. Values that depend on the order of corners are permuted."""
    is_order_free = name in _ORDER_FREE
    if len(change.added_from) and not is_order_free:
        _reject(name, "method-specific face values", "added")
    values = array[np.concatenate([change.face_map[change.face_map != NONE], change.added_from])]
    if is_order_free or not change.turned.any():
        return np.asarray(values)
    # Only lattices with the expected number of samples can be turned.
    samples = None if level is None else (2**level + 1) * (2**level + 2) // 2
    if name not in _LATTICES or level is None or values.ndim < 2 or values.shape[1] != samples:
        _reject(name, "method-specific face values", "turned")
    values[change.turned] = values[change.turned][:, build_lattice_permutation(2**level)]
    return np.asarray(values)


def _carry_corners(name: str, array: NDArray[Any], change: Change, faces: NDArray[Any]) -> NDArray[Any]:
    """Return a corner buffer of the changed mesh.

    The argument `faces` (F, 3) has the faces before the change. Values of an added face are interpolated
    along the edge to the adjacent face. The third vertex of the adjacent face is not used, because its values
    may belong to another UV chart.
    """
    added = len(change.added_from)
    kept = array[change.corner_map[: 3 * (len(change.faces) - added)]]
    if not added:
        return np.asarray(kept)
    if name not in _INTERPOLATED:
        _reject(name, "corner values that cannot be interpolated", "added")
    # `same` (n, 3, 3) compares the corners of an added face with the corners of the adjacent face. A value is
    # true if the two corners have the same vertex.
    old_vertices = change.vertex_map[change.faces[-added:]]
    same = old_vertices[:, :, None] == faces[change.added_from].astype(np.int64)[:, None]
    # Copy the values of shared corners. The remaining corner gets the average of the copied values.
    values = array.reshape(len(faces), 3, -1)[change.added_from].astype(np.float64)
    values = np.take_along_axis(values, same.argmax(axis=2)[:, :, None], axis=1)
    shared = same.any(axis=2, keepdims=True)
    values = np.where(shared, values, (values * shared).sum(axis=1, keepdims=True) / shared.sum(1)[:, None])
    return np.concatenate([kept, _convert_type(values, array.dtype).reshape(-1, *array.shape[1:])])


def build_lattice_permutation(sides: int) -> NDArray[np.intp]:
    """Return the permutation of lattice samples for swapping the second and third corner of a face.

    In the following formulas, n is `sides`. Sample ``s (s + 1) / 2 + y`` has the barycentric coordinates b0 =
    (s - y) / n, b1 = y / n and b2 = (n - s) / n. After the swap, each sample has the value of the old sample
    at (b0, b2, b1). The indices of this old sample are y' = n - s and s' = n - y.
    """
    s, y = np.tril_indices(sides + 1)
    s, y = sides - y, sides - s
    return np.asarray(s * (s + 1) // 2 + y)


def _average_rims(name: str, array: NDArray[Any], rims: Rims) -> NDArray[Any]:
    """Return the average value of each rim.

    If an average is not finite, for example for infinite opacities, return the first value of the rim
    instead.
    """
    if array.dtype.kind != "f" and array.dtype != np.uint8:
        _reject(name, f"{array.dtype} vertex values that cannot be averaged", "added")
    values = array[rims.vertices].astype(np.float64)
    starts = rims.offsets[:-1]
    sizes = np.diff(rims.offsets).reshape(-1, *(1,) * (array.ndim - 1))
    with np.errstate(invalid="ignore", over="ignore"):
        means = np.add.reduceat(values, starts, axis=0) / sizes
    return _convert_type(np.where(np.isfinite(means), means, values[starts]), array.dtype)


def _convert_type(means: NDArray[np.float64], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return averages in the type of their buffer, rounded for integers."""
    return np.asarray(means.astype(dtype) if dtype.kind == "f" else np.rint(means).astype(dtype))


def _reject(name: str, content: str, change: str) -> NoReturn:
    """Raise UNSUPPORTED_REPAIR. The argument `change` names the faces whose values in this buffer are
    undefined ("turned" or "added").
    """
    step = "orient" if change == "turned" else "close"
    text = f"buffer {name} has {content}, which are undefined for {change} faces; omit {step} from the plan"
    raise Unsupported("UNSUPPORTED_REPAIR", text, pointer=name)

"""Carry what vertices, faces and corners hold through a change of the mesh."""

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

# Buffers whose face values do not depend on the order of the corners.
_OF_THE_WHOLE_FACE = {"color", "f_dc", "f_rest", "opacity", "sigma", "face_texture"}
# Corner buffers that are linear along an edge, so that an added face can continue them.
_BETWEEN_CORNERS = {"uv", "color"}
# DiffSoup's samples of a barycentric lattice, which turn with the face.
_LATTICES = {"features.lattice", "features.opacity"}


def carry(
    buffers: Buffers, domains: Mapping[str, str], change: Change, level: int | None = None
) -> dict[str, NDArray[Any]]:
    """Return the buffers of the changed mesh.

    Values are copied, bit for bit. A new vertex has the mean of its rim; an added face has the values of the
    face beside it, at its third corner the mean of the two that both have. `domains` are "vertex", "face",
    "corner" or "global"; `level` is that of DiffSoup's lattice.
    """
    known = {**domains, "positions": "vertex", "indices": "face"}
    return {
        name: change.faces.astype(array.dtype)
        if name == "indices"
        else _of_corners(name, array, change, buffers["indices"])
        if known[name] == "corner"
        else _carried(name, array, known[name], change, level)
        for name, array in buffers.items()
    }


def _carried(name: str, array: NDArray[Any], domain: str, change: Change, level: int | None) -> NDArray[Any]:
    if domain == "vertex":
        kept = array[change.vertex_map[: len(change.vertex_map) - change.rims.count]]
        if change.rims.count == 0:
            return np.asarray(kept)
        return np.concatenate([kept, _means(name, array, change.rims)])
    if domain == "face":
        return _of_faces(name, array, change, level)
    return array


def _of_faces(name: str, array: NDArray[Any], change: Change, level: int | None) -> NDArray[Any]:
    whole = name in _OF_THE_WHOLE_FACE
    if len(change.added_from) and not whole:
        _refuse(name, "values for each face whose meaning is the method's own", "added")
    values = array[np.concatenate([change.face_map[change.face_map != NONE], change.added_from])]
    if whole or not change.turned.any():
        return np.asarray(values)
    samples = None if level is None else (2**level + 1) * (2**level + 2) // 2
    if name not in _LATTICES or level is None or values.ndim < 2 or values.shape[1] != samples:
        _refuse(name, "values for each face whose meaning is the method's own", "turned")
    values[change.turned] = values[change.turned][:, turned_lattice(2**level)]
    return np.asarray(values)


def _of_corners(name: str, array: NDArray[Any], change: Change, faces: NDArray[Any]) -> NDArray[Any]:
    """Return the values of corners; an added face shows all over what there is along the edge it grew from.

    Its third corner could be in another chart, and between the corners of a hole a texture holds nothing.
    `faces` are those before the change.
    """
    added = len(change.added_from)
    kept = array[change.corner_map[: 3 * (len(change.faces) - added)]]
    if not added:
        return np.asarray(kept)
    if name not in _BETWEEN_CORNERS:
        _refuse(name, "a value for each corner", "added")
    was = change.vertex_map[change.faces[-added:]]
    same = was[:, :, None] == faces[change.added_from].astype(np.int64)[:, None]
    values = array.reshape(len(faces), 3, -1)[change.added_from].astype(np.float64)
    values = np.take_along_axis(values, same.argmax(axis=2)[:, :, None], axis=1)
    shared = same.any(axis=2, keepdims=True)
    values = np.where(shared, values, (values * shared).sum(axis=1, keepdims=True) / shared.sum(1)[:, None])
    return np.concatenate([kept, _typed(values, array.dtype).reshape(-1, *array.shape[1:])])


def turned_lattice(sides: int) -> NDArray[np.intp]:
    """Return which sample each one is, when the second and the third corner of a face change places.

    Sample ``s (s + 1) / 2 + y`` lies at b0 = (s - y) / n, b1 = y / n, so b2 = (n - s) / n, n being `sides`.
    Its place in the face before was (b0, b2, b1), that is y = n - s and s = n - y.
    """
    s, y = np.tril_indices(sides + 1)
    s, y = sides - y, sides - s
    return np.asarray(s * (s + 1) // 2 + y)


def _means(name: str, array: NDArray[Any], rims: Rims) -> NDArray[Any]:
    """Return the mean over each rim; the first value where that is not finite, as of infinite opacities."""
    if array.dtype.kind != "f" and array.dtype != np.uint8:
        _refuse(name, f"{array.dtype} values for each vertex, which have no mean,", "added")
    values = array[rims.vertices].astype(np.float64)
    starts = rims.offsets[:-1]
    sizes = np.diff(rims.offsets).reshape(-1, *(1,) * (array.ndim - 1))
    with np.errstate(invalid="ignore", over="ignore"):
        means = np.add.reduceat(values, starts, axis=0) / sizes
    return _typed(np.where(np.isfinite(means), means, values[starts]), array.dtype)


def _typed(means: NDArray[np.float64], dtype: np.dtype[Any]) -> NDArray[Any]:
    return np.asarray(means.astype(dtype) if dtype.kind == "f" else np.rint(means).astype(dtype))


def _refuse(name: str, what: str, done: str) -> NoReturn:
    how = "orient turns faces" if done == "turned" else "close adds faces"
    text = f"buffer {name} holds {what} and cannot be carried where faces are {done}: leave out the step by "
    raise Unsupported("UNSUPPORTED_REPAIR", f"{text}which {how}", pointer=name)

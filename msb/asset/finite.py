"""Remove the faces of a model whose values are NaN or infinite."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.asset.drawable import first_bad


def find_bad_rows(array: NDArray[Any], *, infinite: bool = False) -> NDArray[np.bool_] | None:
    """Return a mask (N,) of the rows of `array` (N, ...) with NaN or infinity.

    Return None if no row has such values. With `infinite`, infinite values are allowed.
    """
    if array.dtype.kind != "f" or first_bad(array, infinite=infinite) is None:
        return None
    bad = np.isnan(array) if infinite else ~np.isfinite(array)
    rows: NDArray[np.bool_] = bad.reshape(len(array), -1).any(axis=1)
    return rows


def find_bad_faces(
    buffers: Mapping[str, NDArray[Any]], domains: Mapping[str, str]
) -> tuple[NDArray[np.bool_], list[str]]:
    """Return a mask (F,) of the faces with values that are not finite, and the names of the buffers with such
    values.

    Infinite opacities are valid, because they are the logits of 0 and 1. Ignore values that belong to no
    face.
    """
    faces = buffers["indices"]
    bad, names = np.zeros(len(faces), bool), []
    for name, array in buffers.items():
        rows = find_bad_rows(array, infinite=name == "opacity")
        domain = "vertex" if name == "positions" else domains.get(name)
        if rows is None or domain not in ("vertex", "face", "corner"):
            continue
        # Collect the values `of_face` (F, k): whether a value, vertex or corner of the face is not finite.
        of_face = rows[faces] if domain == "vertex" else rows.reshape(len(faces), -1)
        bad |= of_face.any(axis=1)
        names += [name] if of_face.any() else []
    return bad, names


def select_vertices(
    positions: NDArray[Any], faces: NDArray[Any], keep: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Return a mask (V,) of the vertices of the faces `keep` (F,).

    Also return the new index (V,) of each of these vertices. Vertices that are not finite are dropped.
    Vertices that are used only by dropped faces are dropped as well.
    """
    is_kept = np.isfinite(positions).all(axis=1)
    orphan = np.zeros(len(positions), bool)
    orphan[faces[~keep]] = True
    orphan[faces[keep]] = False
    is_kept &= ~orphan
    return is_kept, np.cumsum(is_kept) - 1


def keep_faces(
    buffers: Mapping[str, NDArray[Any]], domains: Mapping[str, str], keep: NDArray[np.bool_]
) -> dict[str, NDArray[Any]]:
    """Return the buffers of a model with only the faces `keep` (F,), in stored order."""
    vertices, numbers = select_vertices(buffers["positions"], buffers["indices"], keep)
    rows = {"vertex": vertices, "face": keep, "corner": np.repeat(keep, 3)}
    own = {**domains, "positions": "vertex", "indices": "face"}
    kept = {
        name: array[rows[own[name]]] if own.get(name) in rows else array for name, array in buffers.items()
    }
    return kept | {"indices": numbers[kept["indices"]].astype(buffers["indices"].dtype)}

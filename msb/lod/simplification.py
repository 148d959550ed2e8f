"""Fewer faces by edge collapses that respect texture seams, hard edges, materials and open borders.

meshoptimizer collapses an edge into one of its two vertices. The vertices of a level are therefore rows of
the original, and all their attributes stay as they are: normals, tangents, texture coordinates, colours,
joints, weights and morph targets.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.children import Arrays, run_in_child
from msb.base.extras import need_extra
from msb.base.limits import Limits
from msb.delivery.surface_distance import Floats, Ints
from msb.errors import MeshError
from msb.lod.scene import Scene, number_equal_rows

# Weights of the attributes in the error of a collapse. Positions are in sizes of the whole asset. Of seven
# settings between 0.2 and 3 on six assets, none was better on average; the differences were below 1 dB.
_WEIGHTS = {"NORMAL": 0.5, "TEXCOORD_0": 1.0, "COLOR_0": 0.5}
_WIDTHS = {"NORMAL": 3, "TEXCOORD_0": 2, "COLOR_0": 3}
# Limits of the child process: a base, and an amount per million faces. Measured: 1.2 s and 0.3 GiB per
# million faces on one core.
_SECONDS, _SECONDS_PER_MILLION = 120.0, 60.0
_GIB, _GIB_PER_MILLION = 1.0, 0.6
# A level with less than this share of the requested faces is made again without the removal of loose pieces.
_LEAST_REACHED = 0.8
MODULE = "almeshopt"


def need_simplifier() -> None:
    """Reject the reduction of faces if its library is not installed."""
    need_extra("lod", MODULE, what="a level of detail")


def simplify_scene(scene: Scene, counts: list[int]) -> list[list[Ints]]:
    """Return for each count the faces (F', 3) of each part of a scene, in total about that many.

    All parts are reduced together, so that the faces stay where they matter. A part keeps at least one face.

    Raises
    ------
    UsageError
        EXTRA_MISSING.
    MeshError
        MESH_ARRAY: the library failed.
    """
    points, faces, rows = scene.join()
    columns = [_read_columns(scene, rows, name) for name in _WEIGHTS]
    attributes = np.concatenate(columns, axis=1)
    weights = np.repeat(list(_WEIGHTS.values()), list(_WIDTHS.values()))
    is_used = attributes.any(axis=0)
    # Vertices at which several parts meet keep their part: no collapse joins two materials there.
    ends = np.cumsum([len(used) for used in rows])
    is_shared = np.zeros(len(points), bool)
    if len(ends) > 1:
        part_of = np.searchsorted(ends, np.arange(len(points)), side="right")
        place = number_equal_rows([points])[1]
        least = np.full(place.max() + 1, len(ends))
        np.minimum.at(least, place, part_of)
        is_shared = np.bincount(place, part_of != least[place])[place] > 0
    attributes, weights = attributes[:, is_used], weights[is_used]
    levels = simplify_arrays(points, faces, counts, attributes, weights, is_shared)
    # Split each level into the parts again, by the rows of its vertices.
    result = []
    for level in levels:
        owner = np.searchsorted(ends, level[:, 0], side="right")
        groups = (level[owner == n] - (ends[n] - len(used)) for n, used in enumerate(rows))
        result.append(
            [
                used[group] if len(group) else _largest(part)
                for part, used, group in zip(scene.parts, rows, groups, strict=True)
            ]
        )
    return result


def _largest(part: Any) -> Ints:
    """Return the largest face (1, 3) of a part."""
    a, b, c = part.positions[part.faces.T]
    largest: Ints = part.faces[[int(np.linalg.norm(np.cross(b - a, c - a), axis=1).argmax())]]
    return largest


def _read_columns(scene: Scene, rows: list[Ints], name: str) -> NDArray[np.float32]:
    """Return an attribute (V, K) of all used vertices; zeros for missing and for invalid values."""
    width, columns = _WIDTHS[name], []
    for part, used in zip(scene.parts, rows, strict=True):
        stored = part.read(name)
        is_missing = stored is None or stored.shape[1] < width
        values = np.zeros((len(used), width)) if is_missing or stored is None else stored[used, :width]
        columns.append(np.nan_to_num(values.astype(np.float32), posinf=0, neginf=0))
    return np.concatenate(columns)


def simplify_arrays(
    points: NDArray[np.float32],
    faces: Ints,
    counts: list[int],
    attributes: NDArray[np.float32] | None = None,
    weights: NDArray[np.float64] | None = None,
    protected: NDArray[np.bool_] | None = None,
) -> list[Ints]:
    """Return for each count about that many faces (F', 3) on a subset of the vertices (V, 3).

    `attributes` (V, K) have the `weights` (K,). Vertices that are equal in all attributes are one row. At a
    seam of attributes an edge may collapse into the other side, except at `protected` vertices (V,).
    """
    need_simplifier()
    millions = len(faces) / 1e6
    limits = Limits(_SECONDS + _SECONDS_PER_MILLION * millions, _GIB + _GIB_PER_MILLION * millions)
    arrays = {
        "points": points,
        "faces": faces.astype(np.uint32).reshape(-1),
        "attributes": np.zeros((len(points), 0), np.float32) if attributes is None else attributes,
        "weights": np.zeros(0, np.float32) if weights is None else weights.astype(np.float32),
        "counts": np.array(counts),
        "protected": np.zeros(len(points), bool) if protected is None else protected,
    }
    reply = run_in_child(collapse_in_child, "", arrays, limits)
    if reply.why:
        raise MeshError("MESH_ARRAY", f"the faces cannot be reduced: meshoptimizer failed ({reply.why})")
    return [reply.arrays[str(n)].astype(np.int64).reshape(-1, 3) for n in range(len(counts))]


def collapse_in_child(_word: str, arrays: Arrays) -> tuple[Any, Arrays]:
    """Reduce faces to each of the `counts` (a `Work` of `msb.base.children`)."""
    import almeshopt

    options = almeshopt.SIMPLIFY_PERMISSIVE | almeshopt.SIMPLIFY_REGULARIZE
    lock = np.where(arrays["protected"], almeshopt.SIMPLIFY_VERTEX_PROTECT, 0).astype(np.uint8)
    faces, points, attributes, weights = (
        np.array(arrays[name], order="C") for name in ("faces", "points", "attributes", "weights")
    )
    if not len(weights):  # the function without attributes would ignore the protection
        attributes, weights = np.zeros((len(points), 1), np.float32), np.ones(1, np.float32)
    levels: dict[str, NDArray[Any]] = {}
    for number, count in enumerate(arrays["counts"].tolist()):
        # Prune removes small loose pieces. Where nothing else can be removed, it would remove everything.
        for extra in (almeshopt.SIMPLIFY_PRUNE, 0):
            settings = {"target_error": 1.0, "vertex_lock": lock, "options": options | extra}
            found = almeshopt.simplify_with_attributes(
                faces, points, attributes, weights, 3 * count, **settings
            )[0]
            if len(found) >= _LEAST_REACHED * 3 * count:
                break
        levels[str(number)] = np.asarray(found)
    return None, levels


def merge_places(points: Floats, faces: Ints) -> tuple[NDArray[np.float32], Ints]:
    """Return points and faces with vertices at one place merged, without faces that become degenerate."""
    first, number = number_equal_rows([points.astype(np.float32)])
    places, merged = points[first].astype(np.float32), number[faces]
    return places, merged[(merged != np.roll(merged, 1, axis=1)).all(axis=1)].astype(np.int64)

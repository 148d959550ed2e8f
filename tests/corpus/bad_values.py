"""Buffers whose values, hashes or bounds are wrong (classes 19 and 28 to 32)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.corpus.case import Case, packed
from tests.corpus.good import Parts, decoder, mesh, parts, soup


def _values(
    name: str, code: str, buffer: str, put: dict[Any, Any], make: Callable[[], Any] = mesh, **more: Any
) -> Case:
    """Return a case in which some elements of a buffer are others; the hash is that of the new values."""

    def change() -> Parts:
        asset = make()
        array = asset.buffers[buffer].copy()
        for where, value in put.items():
            array[where] = value
        return parts(asset).set_array(buffer, array)

    return Case(name, f"TRIASSET_{code}", packed(change), found_by="validate", **more)


def _signalling_nan(path: Path) -> None:
    good = parts(mesh())
    array = np.frombuffer(good.files["buffers/positions.bin"], np.uint32).reshape(4, 3).copy()
    array[2, 1] = 0x7FA00001
    good.set_array("positions", array.view(np.float32)).write_packed(path)


def _flat_face(path: Path) -> None:
    """Write a mesh whose first vertices lie on a line, and whose hash and bounds say so."""
    good = parts(mesh()).change("/bounds/max", [2, 0, 3]).change("/bounding_sphere/radius", 4)
    line = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 3]], np.float32)
    good.set_array("positions", line).write_packed(path)


def _float_color() -> Any:
    good = parts(mesh()).change("/buffers/color/dtype", "float32")
    return good.set_array("color", np.full((4, 3), 1.5, np.float32))


def _far(values: float) -> Callable[[], Parts]:
    """Return a function that makes a mesh with coordinates up to `values` and matching bounds."""

    def make() -> Parts:
        good = parts(mesh())
        positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32) * np.float32(values)
        good.set_array("positions", positions).change("/bounds", {"min": [0, 0, 0], "max": [values] * 3})
        return good.change("/bounding_sphere", {"center": [0, 0, 0], "radius": values * 1.001})

    return make


def _stated(name: str, code: str, pointer: str, value: Any) -> Case:
    make = packed(lambda: parts(mesh()).change(pointer, value))
    return Case(name, f"TRIASSET_{code}", make, found_by="validate")


NAN, INF = float("nan"), float("inf")
_OTHER_HASH = "0123456789abcdef" * 4

VALUE_CASES = [
    _values("nan_position", "VALUE_NONFINITE", "positions", {(1, 2): NAN}),
    _values("inf_position", "VALUE_NONFINITE", "positions", {(3, 0): INF}),
    _values("nan_positions", "VALUE_NONFINITE", "positions", {...: NAN}),
    Case("signalling_nan", "TRIASSET_VALUE_NONFINITE", _signalling_nan, found_by="validate"),
    _values("nan_f_dc", "VALUE_NONFINITE", "f_dc", {(0, 0): NAN}, soup),
    _values("inf_f_rest", "VALUE_NONFINITE", "f_rest", {(1, 8): -INF}, soup),
    _values("nan_opacity", "VALUE_NONFINITE", "opacity", {0: NAN}, soup),
    _values("inf_sigma", "VALUE_NONFINITE", "sigma", {1: INF}, soup),
    _values("nan_feature", "VALUE_NONFINITE", "features.color", {(1, 2, 6): NAN}, decoder),
    _values("inf_weight", "VALUE_NONFINITE", "decoder.w0", {(0, 0): INF}, decoder),
    _values("index_v", "INDEX_OUT_OF_RANGE", "indices", {(3, 2): 4}),
    _values("index_greatest", "INDEX_OUT_OF_RANGE", "indices", {(0, 0): 2**32 - 1}),
    _values("soup_swapped", "VALUE_RANGE", "indices", {...: [[3, 4, 5], [0, 1, 2]]}, soup),
    _values("soup_flipped", "VALUE_RANGE", "indices", {1: [3, 5, 4]}, soup),
    Case(
        "color_range", "TRIASSET_VALUE_RANGE", packed(_float_color), severity="warning", found_by="validate"
    ),
    Case("magnitude", "TRIASSET_VALUE_RANGE", packed(_far(1e19)), severity="warning", found_by="validate"),
    Case(
        "magnitude_greatest",
        "TRIASSET_VALUE_RANGE",
        packed(_far(3e38)),
        severity="warning",
        found_by="validate",
    ),
    _stated("bounds_small", "BOUNDS", "/bounds/max/2", 2.5),
    _stated("bounds_large", "BOUNDS", "/bounds/min/0", -1),
    _stated("bounds_1e308", "BOUNDS", "/bounds/max/0", 1.7e308),
    _stated("sphere_small", "BOUNDS", "/bounding_sphere/radius", 1),
    _stated("sphere_elsewhere", "BOUNDS", "/bounding_sphere/center", [1e300] * 3),
    Case(
        "sphere_loose",
        "TRIASSET_BOUNDS",
        packed(lambda: parts(mesh()).change("/bounding_sphere/radius", 300)),
        severity="warning",
        found_by="validate",
    ),
    _stated("checksum", "DAMAGED", "/buffers/color/sha256", _OTHER_HASH),
]


def _faces(name: str, code: str, faces: list[list[int]]) -> Case:
    """Return a case whose faces are allowed, but not all of use."""
    make = packed(lambda: parts(mesh()).set_array("indices", np.array(faces, np.uint32)))
    return Case(name, f"TRIASSET_{code}", make, severity="info", found_by="command")


FACE_CASES = [
    _faces("face_repeated_index", "FACE_REPEATED_INDEX", [[0, 1, 2], [0, 1, 3], [0, 0, 3], [1, 2, 3]]),
    _faces("face_duplicate", "FACE_DUPLICATE", [[0, 1, 2], [0, 1, 3], [1, 3, 0], [1, 2, 3]]),
    _faces("vertex_unreferenced", "VERTEX_UNREFERENCED", [[0, 1, 2], [2, 1, 0], [1, 2, 0], [1, 0, 2]]),
    Case("face_zero_area", "TRIASSET_FACE_ZERO_AREA", _flat_face, severity="info", found_by="command"),
]

CASES = [*VALUE_CASES, *FACE_CASES]

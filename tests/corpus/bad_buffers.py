"""Buffers that are missing, too short, overlapping or of the wrong shape (classes 21 to 28)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tests.corpus.case import Case, folder, packed
from tests.corpus.good import REMOVE, Parts, decoder, mesh, parts, soup

COLOR = "buffers/color.bin"


# --- the files -----------------------------------------------------------------------------------------


def _file(name: str, code: str, spoil: Callable[[bytes], bytes]) -> list[Case]:
    """Return a folder and a packed case in which the file of `color` is `spoil` of the good one."""

    def make() -> Parts:
        good = parts(mesh())
        good.files[COLOR] = spoil(good.files[COLOR])
        return good

    return [Case(f"{name}_folder", code, folder(make)), Case(f"{name}_packed", code, packed(make))]


def _missing() -> Parts:
    good = parts(mesh())
    del good.files[COLOR]
    return good


def _undeclared() -> Parts:
    good = parts(mesh())
    good.files["buffers/more.bin"] = b"more"
    return good


FILE_CASES = [
    Case("buffer_missing_folder", "TRIASSET_DAMAGED", folder(_missing)),
    Case("buffer_missing_packed", "TRIASSET_DAMAGED", packed(_missing)),
    Case("buffer_undeclared", "TRIASSET_FILE_UNDECLARED", packed(_undeclared)),
    *_file("truncated_by_one", "TRIASSET_DAMAGED", lambda b: b[:-1]),
    *_file("truncated_to_half", "TRIASSET_DAMAGED", lambda b: b[: len(b) // 2]),
    *_file("truncated_to_none", "TRIASSET_DAMAGED", lambda _: b""),
    *_file("longer_by_one", "TRIASSET_DAMAGED", lambda b: b + b"\0"),
    *_file("longer_twice", "TRIASSET_DAMAGED", lambda b: b + b),
]


# --- what the manifest says of them --------------------------------------------------------------------


def _spec(name: str, code: str, changes: dict[str, Any], make: Callable[[], Any] = mesh, **more: Any) -> Case:
    """Return a packed case with `changes` below /buffers."""

    def change() -> Parts:
        good = parts(make())
        for key, value in changes.items():
            good.change(f"/buffers/{key}", value)
        return good

    return Case(name, f"TRIASSET_{code}", packed(change), **more)


def _shared(second_offset: int, gap: int = 0) -> Callable[[], Parts]:
    """Return a function that makes an asset whose positions and color share a file."""

    def make() -> Parts:
        good = parts(mesh())
        color = good.files.pop(COLOR)
        good.files["buffers/positions.bin"] += bytes(gap) + color
        good.change("/buffers/color/file", "buffers/positions.bin")
        return good.change("/buffers/color/offset", second_offset)

    return make


def _more_buffers(*names: str, dtype: str = "uint8") -> Callable[[], Parts]:
    """Return a function that makes an asset with further buffers of four bytes."""

    def make() -> Parts:
        good = parts(mesh())
        for i, name in enumerate(names):
            spec = {**good.manifest["buffers"]["color"], "file": f"buffers/more{i}.bin", "domain": "global"}
            good.manifest["buffers"][name] = {**spec, "shape": [4], "byte_length": 4, "dtype": dtype}
            good.files[f"buffers/more{i}.bin"] = b"more"
        return good

    return make


_DTYPES: list[Any] = [
    "float64",
    "float16",
    "int32",
    ">f4",
    "<f4",
    "float32be",
    "FLOAT32",
    "f4",
    "",
    "object",
    None,
]
_BUFFER_NAMES = [
    "Positions",
    "a/b",
    "a..b",
    ".a",
    "a.",
    "",
    "1a",
    "a b",
    "a\n",
    "a\0",
    "\u0430",
    "__proto__",
    "x" * 65,
]


SPEC_CASES = [
    _spec("no_positions", "BUFFER", {"positions": REMOVE}),
    _spec("no_indices", "BUFFER", {"indices": REMOVE}),
    Case("buffers_none", "TRIASSET_BUFFER", packed(lambda: parts(mesh()).change("/buffers", {}))),
    Case("buffers_65", "TRIASSET_FIELD", folder(_more_buffers(*(f"x{i}" for i in range(62))))),
    *(
        Case(f"buffer_name_{i}", "TRIASSET_BUFFER", packed(_more_buffers(name)))
        for i, name in enumerate(_BUFFER_NAMES)
    ),
    _spec("offset_negative", "BUFFER", {"color/offset": -64}),
    _spec("offset_2_63", "BUFFER", {"color/offset": 2**63}),
    _spec("offset_2_64", "BUFFER", {"color/offset": 2**64}),
    _spec(
        "offset_overflow",
        "BUFFER",
        {"color/offset": 2**63 - 64, "color/byte_length": 64},
        also=("TRIASSET_BUFFER", "TRIASSET_DAMAGED"),
    ),
    _spec("length_negative", "BUFFER", {"color/byte_length": -12}),
    _spec("length_2_64", "BUFFER", {"color/byte_length": 2**64 + 12}),
    _spec("offset_past_end", "DAMAGED", {"color/offset": 64}),
    _spec("offset_4_gib", "DAMAGED", {"color/offset": 2**32}),
    _spec("misaligned", "BUFFER", {"color/offset": 4}, also=("TRIASSET_DAMAGED",)),
    Case("overlap", "TRIASSET_BUFFER", packed(_shared(0))),
    Case("hole", "TRIASSET_DAMAGED", packed(_shared(128, 80))),
    _spec("same_file_twice", "BUFFER", {"color/file": "buffers/positions.bin"}),
    *(_spec(f"dtype_{i}", "BUFFER", {"color/dtype": dtype}) for i, dtype in enumerate(_DTYPES)),
    _spec("positions_uint32", "BUFFER", {"positions/dtype": "uint32"}),
    _spec("indices_float32", "BUFFER", {"indices/dtype": "float32"}),
    _spec("indices_uint8", "BUFFER", {"indices/dtype": "uint8", "indices/byte_length": 12}),
    _spec("color_uint32", "BUFFER", {"color/dtype": "uint32", "color/byte_length": 48}),
    _spec("domain_unknown", "BUFFER", {"color/domain": "edge"}),
    _spec("domain_capitals", "BUFFER", {"color/domain": "Vertex"}),
    _spec("domain_count", "BUFFER", {"color/shape": [3, 3], "color/byte_length": 9}),
    _spec("domain_corner", "BUFFER", {"color/domain": "corner"}),
    _spec("domain_face", "BUFFER", {"f_dc/domain": "vertex"}, soup),
    _spec("color_global", "BUFFER", {"color/domain": "global"}),
    _spec("positions_face", "BUFFER", {"positions/domain": "face"}),
    _spec("indices_global", "BUFFER", {"indices/domain": "global"}),
    _spec("shape_product", "BUFFER", {"color/byte_length": 13}),
    _spec(
        "shape_wraps",
        "BUFFER",
        {"decoder.w0/shape": [2**31, 2**31, 4], "decoder.w0/byte_length": 0},
        decoder,
    ),
    _spec("shape_2_33", "FIELD", {"color/shape": [2**33, 2**33]}),
    _spec("shape_negative", "FIELD", {"color/shape": [-4, -3]}),
    _spec("shape_guess", "FIELD", {"color/shape": [4, -1]}),
    _spec("shape_float", "FIELD", {"color/shape": [4, 3.0]}),
    _spec("shape_bool", "FIELD", {"color/shape": [4, True]}),
    _spec("shape_none", "BUFFER", {"color/shape": []}),
    _spec("shape_five", "BUFFER", {"color/shape": [4, 3, 1, 1, 1]}),
    _spec("shape_strings", "FIELD", {"color/shape": ["4" * 900_000]}),
    _spec("positions_four", "BUFFER", {"positions/shape": [4, 4], "positions/byte_length": 64}),
    _spec("positions_flat", "BUFFER", {"positions/shape": [4], "positions/byte_length": 16}),
    _spec("positions_deep", "BUFFER", {"positions/shape": [4, 3, 1]}),
    _spec("indices_quads", "BUFFER", {"indices/shape": [4, 4], "indices/byte_length": 64}),
    _spec("opacity_column", "BUFFER", {"opacity/shape": [2, 1]}, soup),
    _spec("f_dc_four", "BUFFER", {"f_dc/shape": [2, 4], "f_dc/byte_length": 32}, soup),
    _spec("f_rest_cube", "FIELD", {"f_rest/shape": [2, 3, 3]}, soup),
    _spec("color_one", "BUFFER", {"color/shape": [4, 1], "color/byte_length": 4}),
    _spec("zero_length", "BUFFER", {"decoder.b0/shape": [0], "decoder.b0/byte_length": 0}, decoder),
    _spec("zero_axis", "BUFFER", {"decoder.w0/shape": [3, 0], "decoder.w0/byte_length": 0}, decoder),
]

CASES = [*FILE_CASES, *SPEC_CASES]

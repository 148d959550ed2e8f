"""Bad assets whose manifests are not JSON, have bad values, or describe their buffers wrongly."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.corpus.case import Case, manifest_case, packed_case
from tests.corpus.good import REMOVE, Parts, decoder, mesh, parts, soup, textured

MIB = 1 << 20

# --- the text --------------------------------------------------------------------------------------------


def _text(name: str, spoil: Callable[[bytes], bytes]) -> Case:
    """Return a folder whose manifest is a good one, changed by `spoil`."""

    def write(path: Path) -> None:
        good = parts(mesh())
        good.write_folder(path, spoil(good.text()))

    return Case(f"manifest_{name}", "TRIASSET_MANIFEST", write)


def _insert(what: bytes) -> Callable[[bytes], bytes]:
    """Return a function that inserts the text `what` after the first brace."""
    return lambda text: text.replace(b"{", b"{" + what, 1)


def _swap(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    return lambda text: text.replace(old, new, 1)


def _without(path: Path) -> None:
    parts(mesh()).write_folder(path)
    (path / "manifest.json").unlink()


def _in_capitals(path: Path) -> None:
    parts(mesh()).write_folder(path)
    (path / "manifest.json").rename(path / "MANIFEST.JSON")


_TEXTS: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "over_1_mib": lambda text: text.ljust(MIB + 1),
    "two_documents": lambda text: text + text,
    "bom": lambda text: b"\xef\xbb\xbf" + text,
    "overlong": _swap(b"buffers/", b"buffers\xc0\xaf"),
    "lone_surrogate": _swap(b"meshsplatbench", b"\\ud800"),
    "root_array": lambda _: b"[]",
    "duplicate_escaped": _insert(b'"form\\u0061t": "triasset",'),
    "nan": _insert(b'"x": NaN,'),
    "overflow": _insert(b'"x": 1e400,'),
    "5000_digits": _insert(b'"x": ' + b"9" * 5000 + b","),
    "deep_objects": lambda _: b'{"x":' * 100_000 + b"0" + b"}" * 100_000,
    "deep_open": lambda _: b"[" * (MIB - 1),
}
TEXT_CASES = [
    Case("manifest_missing", "TRIASSET_MANIFEST_MISSING", _without),
    Case("manifest_empty_folder", "TRIASSET_MANIFEST_MISSING", lambda path: path.mkdir()),
    Case("manifest_capitals", "TRIASSET_MANIFEST_MISSING", _in_capitals),
    *(_text(name, spoil) for name, spoil in _TEXTS.items()),
]

# --- its values ------------------------------------------------------------------------------------------

_STORED = {"value": 1.0, "source": "flag"}
_SOURCE = {"path": "a.pt", "sha256": "0" * 64, "byte_length": 1}
_FIELDS: list[tuple[str, str, str, Any, Callable[[], Any]]] = [
    ("no_key", "FIELD", "/generator", REMOVE, mesh),
    ("type_string", "FIELD", "/generator", 1, mesh),
    ("type_of_buffers", "FIELD", "/buffers", [], mesh),
    ("integer_float", "FIELD", "/face_count", 4.0, mesh),
    ("method_foreign_name", "FIELD", "/method", "2dts", mesh),
    ("pass_unknown", "FIELD", "/required_passes/standard", ["ray_trace"], mesh),
    ("generator_long", "FIELD", "/generator", "x" * 1001, mesh),
    ("format_other", "MANIFEST", "/format", "glTF", mesh),
    ("version_three_numbers", "MANIFEST", "/version", "1.0.0", mesh),
    ("version_2_0", "VERSION_UNSUPPORTED", "/version", "2.0", mesh),
    ("count_greatest", "BUFFER", "/face_count", 2**32 - 1, mesh),
    ("soup_count", "FIELD", "/topology", "triangle_soup", mesh),
    ("sh_degree_4", "FIELD", "/sh_degree", 4, soup),
    ("sh_width", "FIELD", "/sh_degree", 2, soup),
    ("sh_no_rest", "FIELD", "/sh_degree", 1, mesh),
    ("sh_order_absent", "FIELD", "/appearance/f_rest_order", REMOVE, soup),
    ("bounds_inverted", "FIELD", "/bounds/min/1", 7, mesh),
    ("setting_unknown", "FIELD", "/settings/gamma", _STORED, soup),
    ("setting_of_mesh", "FIELD", "/settings/\x1b[31m\n", _STORED, mesh),
    ("setting_high", "FIELD", "/settings/sh_degree/value", 2, soup),
    ("setting_float", "FIELD", "/settings/sh_degree/value", 1.0, soup),
    ("setting_choice", "FIELD", "/settings/view_dir/value", "up", soup),
    ("setting_zero", "FIELD", "/settings/z_near/value", 0, decoder),
    ("setting_huge", "FIELD", "/settings/z_far", {**_STORED, "value": 1e305}, decoder),
    ("source_hash", "BUFFER", "/source/files", [{**_SOURCE, "sha256": "x"}], mesh),
    ("texture_version", "FIELD", "/version", "1.0", textured),
    ("texture_pass", "FIELD", "/required_passes/standard", ["opaque_unlit"], textured),
    ("texture_pass_alone", "FIELD", "/required_passes/standard", ["opaque_unlit_texture"], mesh),
    ("texture_filter", "FIELD", "/appearance/filter", "cubic", textured),
    ("texture_wrap", "FIELD", "/appearance/wrap_v", REMOVE, textured),
    ("texture_cutoff", "FIELD", "/appearance/alpha_cutoff", 1.5, textured),
    ("texture_uv_wide", "BUFFER", "/buffers/uv/shape", [4, 3], textured),
    ("texture_uv_absent", "BUFFER", "/buffers/uv", REMOVE, textured),
    ("texture_huge", "BUFFER", "/buffers/texture.0/shape", [16385, 100_000, 3], textured),
    ("texture_grey", "BUFFER", "/buffers/texture.0/shape", [2, 6, 1], textured),
    ("texture_of_faces", "BUFFER", "/buffers/texture.0/domain", "face", textured),
    ("texture_first_absent", "BUFFER", "/buffers/texture.0", REMOVE, textured),
    ("texture_of_which_face", "BUFFER", "/buffers/face_texture", REMOVE, textured),
]
_WARNED: list[tuple[str, str, str, Any]] = [
    ("version_1_3", "VERSION_NEWER", "/version", "1.3"),
    ("unknown_key", "FIELD_UNKNOWN", "/lod", 3),
    ("unknown_escape", "FIELD_UNKNOWN", "/\x1b[2J\r", 0),
    ("method_elsewhere", "METHOD_NOT_INSTALLED", "/method", "nerf"),
]
FIELD_CASES = [
    *(manifest_case(name, code, {where: value}, make) for name, code, where, value, make in _FIELDS),
    *(manifest_case(name, code, {where: value}, severity="warning") for name, code, where, value in _WARNED),
    *(
        manifest_case(f"no_{counted}", "EMPTY", {f"/{key}": 0}, also=("TRIASSET_BUFFER",))
        for counted, key in (("faces", "face_count"), ("vertices", "vertex_count"))
    ),
    manifest_case("sh_rest_at_0", "FIELD", {"/sh_degree": 0, "/settings": {}}, soup),
]

# --- its buffers -----------------------------------------------------------------------------------------


def _buffer(
    name: str, code: str, changes: dict[str, Any], make: Callable[[], Any] = mesh, **more: Any
) -> Case:
    return manifest_case(
        name, code, {f"/buffers/{key}": value for key, value in changes.items()}, make, **more
    )


def _shared(second_offset: int, gap: int = 0) -> Callable[[], Parts]:
    """Return a function that makes an asset whose positions and colours share a file."""

    def make() -> Parts:
        good = parts(mesh())
        color = good.files.pop("buffers/color.bin")
        good.files["buffers/positions.bin"] += bytes(gap) + color
        good.change("/buffers/color/file", "buffers/positions.bin")
        return good.change("/buffers/color/offset", second_offset)

    return make


def _more_buffers(*names: str) -> Callable[[], Parts]:
    """Return a function that makes an asset with further buffers of four bytes."""

    def make() -> Parts:
        good = parts(mesh())
        for i, name in enumerate(names):
            spec = {**good.manifest["buffers"]["color"], "file": f"buffers/more{i}.bin", "domain": "global"}
            good.manifest["buffers"][name] = {**spec, "shape": [4], "byte_length": 4}
            good.files[f"buffers/more{i}.bin"] = b"more"
        return good

    return make


BUFFER_CASES = [
    _buffer("no_positions", "BUFFER", {"positions": REMOVE}),
    *(
        packed_case(f"buffer_name_{i}", "BUFFER", _more_buffers(name))
        for i, name in enumerate(["Positions", "a/b", "", "a\n", "\u0430", "x" * 65])
    ),
    _buffer("offset_negative", "BUFFER", {"color/offset": -64}),
    _buffer(
        "offset_overflow",
        "BUFFER",
        {"color/offset": 2**63 - 64, "color/byte_length": 64},
        also=("TRIASSET_BUFFER", "TRIASSET_DAMAGED"),
    ),
    _buffer("offset_past_end", "DAMAGED", {"color/offset": 64}),
    _buffer("misaligned", "BUFFER", {"color/offset": 4}, also=("TRIASSET_DAMAGED",)),
    packed_case("overlap", "BUFFER", _shared(0)),
    packed_case("hole", "DAMAGED", _shared(128, 80)),
    _buffer("dtype_float64", "BUFFER", {"color/dtype": "float64"}),
    _buffer("positions_uint32", "BUFFER", {"positions/dtype": "uint32"}),
    _buffer("indices_uint8", "BUFFER", {"indices/dtype": "uint8", "indices/byte_length": 12}),
    _buffer("domain_count", "BUFFER", {"color/shape": [3, 3], "color/byte_length": 9}),
    _buffer("domain_corner", "BUFFER", {"color/domain": "corner"}),
    _buffer("domain_face", "BUFFER", {"f_dc/domain": "vertex"}, soup),
    _buffer("color_global", "BUFFER", {"color/domain": "global"}),
    _buffer("shape_product", "BUFFER", {"color/byte_length": 13}),
    _buffer(
        "shape_wraps",
        "BUFFER",
        {"decoder.w0/shape": [2**31, 2**31, 4], "decoder.w0/byte_length": 0},
        decoder,
    ),
    _buffer("shape_2_33", "FIELD", {"color/shape": [2**33, 2**33]}),
    _buffer("shape_strings", "FIELD", {"color/shape": ["4" * 900_000]}),
    _buffer("indices_quads", "BUFFER", {"indices/shape": [4, 4], "indices/byte_length": 64}),
    _buffer("opacity_column", "BUFFER", {"opacity/shape": [2, 1]}, soup),
    _buffer("f_rest_cube", "FIELD", {"f_rest/shape": [2, 3, 3]}, soup),
    _buffer("zero_axis", "BUFFER", {"decoder.w0/shape": [3, 0], "decoder.w0/byte_length": 0}, decoder),
    _buffer("hash_line_break", "BUFFER", {"color/sha256": "0" * 64 + "\n"}),
]

_TOO_MANY = Case(
    "buffers_65",
    "TRIASSET_FIELD",
    lambda path: _more_buffers(*map("x{}".format, range(62)))().write_folder(path),
)
CASES = [_TOO_MANY, *TEXT_CASES, *FIELD_CASES, *BUFFER_CASES]

"""Manifests with one bad value (classes 10 to 19)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msb.asset.schema import manifest_schema
from tests.corpus.case import Case, packed
from tests.corpus.good import REMOVE, Parts, decoder, mesh, parts, soup


def _value(
    name: str, code: str, pointer: str, value: Any, make: Callable[[], Any] = mesh, **more: Any
) -> Case:
    """Return a packed case in which the manifest has `value` at `pointer` (or lacks it, if `REMOVE`)."""
    return Case(name, f"TRIASSET_{code}", packed(lambda: parts(make()).change(pointer, value)), **more)


_ORDER = "/appearance/f_rest_order"
_REQUIRED: list[str] = manifest_schema()["required"]

_REQUIRED_INSIDE = [
    "/bounds/min",
    "/bounding_sphere/radius",
    "/coverage/kernel",
    "/opacity/encoding",
    "/appearance/kind",
    "/compositing/kind",
    "/settings/view_dir/source",
    "/coordinate_frame/up",
    "/source/files",
    "/source/files/0/sha256",
    *(
        f"/buffers/indices/{key}"
        for key in ("file", "offset", "byte_length", "dtype", "shape", "domain", "sha256")
    ),
]

# Key -> a value of a wrong JSON type, and the code where it is not FIELD_TYPE.
_WRONG_TYPES: dict[str, Any] = {
    "generator": 1,
    "topology": ["triangle_soup"],
    "face_count": "4",
    "vertex_count": None,
    "bounds": [[0, 0, 0], [1, 1, 1]],
    "bounding_sphere": 1.5,
    "coverage": "solid",
    "opacity": None,
    "appearance": [],
    "compositing": 0,
    "settings": [],
    "required_passes": ["opaque_unlit"],
    "color_space": True,
    "coordinate_frame": "y-up",
    "source": "garden.ply",
    "buffers": [],
    "buffers/positions": "positions.bin",
    "buffers/positions/shape": 12,
    "buffers/positions/offset": "0",
    "buffers/positions/byte_length": 48.0,
    "bounds/min/0": "0",
    "bounds/min": {"x": 0},
    "bounding_sphere/radius": None,
    "coverage/gamma": [1.0],
    "source/files": {},
    "required_passes/standard": "opaque_unlit",
}

_INTEGER_LIES = [("float", 4.0), ("exponent", 4e0), ("bool", True), ("half", 4.5)]

_ENUMS = [
    ("topology_unknown", "FIELD_VALUE", "/topology", "quads"),
    ("kernel_unknown", "FIELD_VALUE", "/coverage/kernel", "box"),
    ("encoding_unknown", "FIELD_VALUE", "/opacity/encoding", "sigmoid"),
    ("appearance_unknown", "FIELD_VALUE", "/appearance/kind", "texture"),
    ("compositing_unknown", "FIELD_VALUE", "/compositing/kind", "oit"),
    ("color_space_unknown", "FIELD_VALUE", "/color_space", "sRGB"),
    ("handedness_left", "FIELD_VALUE", "/coordinate_frame/handedness", "left"),
    ("up_unknown", "FIELD_VALUE", "/coordinate_frame/up", "up"),
    ("units_unknown", "FIELD_VALUE", "/coordinate_frame/units", "inch"),
    ("method_unknown", "METHOD_UNKNOWN", "/method", "NeRF"),
    ("method_foreign_name", "METHOD_UNKNOWN", "/method", "2dts"),
    ("method_number", "METHOD_UNKNOWN", "/method", 2),
    ("pass_unknown", "PASS_UNKNOWN", "/required_passes/standard", ["ray_trace"]),
    ("pass_number", "FIELD_TYPE", "/required_passes/standard", [1]),
    ("passes_none", "FIELD_VALUE", "/required_passes/standard", []),
    ("passes_17", "FIELD_VALUE", "/required_passes/standard", ["opaque_unlit"] * 17),
]

_VERSIONS = ["1", "1.0.0", "01.0", "1.00", "v1.0", " 1.0", "1.0\n", "1,0", "", "1.-1", "\uff11.0", 1.0, None]

_COUNTS = [
    ("negative", -1, "COUNT_RANGE"),
    ("2_32", 2**32, "COUNT_RANGE"),
    ("2_63", 2**63, "COUNT_RANGE"),
    ("2_64", 2**64, "COUNT_RANGE"),
    ("minus_2_63", -(2**63), "COUNT_RANGE"),
    ("greatest", 2**32 - 1, "BUFFER_DOMAIN"),
    ("one_less", 3, "BUFFER_DOMAIN"),
]


def _rest_at_0() -> Parts:
    return parts(soup()).change("/sh_degree", 0).change("/settings", {})


FIELD_CASES = [
    *(_value(f"no_{key}", "FIELD_MISSING", f"/{key}", REMOVE) for key in _REQUIRED),
    *(
        _value("no_" + pointer[1:].replace("/", "_"), "FIELD_MISSING", pointer, REMOVE, soup)
        for pointer in _REQUIRED_INSIDE
    ),
    *(
        _value("type_" + key.replace("/", "_"), "FIELD_TYPE", f"/{key}", value)
        for key, value in _WRONG_TYPES.items()
    ),
    *(_value(f"integer_{name}", "FIELD_TYPE", "/face_count", value) for name, value in _INTEGER_LIES),
    *(_value(name, code, pointer, value) for name, code, pointer, value in _ENUMS),
    _value("generator_long", "FIELD_VALUE", "/generator", "x" * 1001),
    _value("generator_megabyte", "FIELD_TYPE", "/generator", ["x" * 900_000]),
    _value("format_other", "FORMAT_UNKNOWN", "/format", "glTF"),
    _value("format_capitals", "FORMAT_UNKNOWN", "/format", "TRIASSET"),
    _value("format_null", "FORMAT_UNKNOWN", "/format", None),
    *(
        _value(f"version_{i}", "VERSION_MALFORMED", "/version", version)
        for i, version in enumerate(_VERSIONS)
    ),
    _value("version_0_9", "VERSION_UNSUPPORTED", "/version", "0.9"),
    _value("version_2_0", "VERSION_UNSUPPORTED", "/version", "2.0"),
    _value("version_1_1", "VERSION_NEWER", "/version", "1.1", severity="warning"),
    _value("unknown_key", "FIELD_UNKNOWN", "/lod", 3, severity="warning"),
    _value("method_elsewhere", "METHOD_NOT_INSTALLED", "/method", "nerf", severity="warning"),
    _value("unknown_escape", "FIELD_UNKNOWN", "/\x1b[2J\r", 0, severity="warning"),
    _value("unknown_in_bounds", "FIELD_UNKNOWN", "/bounds/w", 0, severity="warning"),
    _value("unknown_in_buffer", "FIELD_UNKNOWN", "/buffers/color/stride", 4, severity="warning"),
    _value("unknown_in_source", "FIELD_UNKNOWN", "/source/author", "x", severity="warning"),
    _value("unknown_tier", "FIELD_UNKNOWN", "/required_passes/webgl", 5, severity="warning"),
    *(_value(f"vertex_count_{name}", code, "/vertex_count", value) for name, value, code in _COUNTS),
    *(_value(f"face_count_{name}", code, "/face_count", value) for name, value, code in _COUNTS),
    _value("no_faces", "EMPTY", "/face_count", 0, also=("TRIASSET_BUFFER_DOMAIN",)),
    _value("no_vertices", "EMPTY", "/vertex_count", 0, also=("TRIASSET_BUFFER_DOMAIN",)),
    _value("soup_count", "SOUP_COUNT", "/topology", "triangle_soup"),
    *(
        _value(f"sh_degree_{i}", "SH_DEGREE", "/sh_degree", degree, soup)
        for i, degree in enumerate((-1, 4, 1.0, True, "1", None, 2**64))
    ),
    _value("sh_width", "SH_WIDTH", "/sh_degree", 2, soup),
    _value("sh_no_rest", "SH_WIDTH", "/sh_degree", 1, mesh),
    _value("sh_order_absent", "FIELD_MISSING", _ORDER, REMOVE, soup),
    _value("sh_order_unknown", "FIELD_VALUE", _ORDER, "morton", soup),
    Case("sh_rest_at_0", "TRIASSET_SH_WIDTH", packed(_rest_at_0)),
    _value("bounds_inverted", "BOUNDS_INVERTED", "/bounds/min/1", 7),
    _value("bounds_two", "FIELD_VALUE", "/bounds/min", [0, 0]),
    _value("bounds_many", "FIELD_VALUE", "/bounds/min", [0] * 100_000),
    _value("radius_negative", "FIELD_VALUE", "/bounding_sphere/radius", -1),
]


def _bad_setting(name: str, setting: str, stored: Any, make: Callable[[], Any], code: str) -> Case:
    return _value(f"setting_{name}", code, f"/settings/{setting}", stored, make)


def _stored(value: Any) -> dict[str, Any]:
    return {"value": value, "source": "flag"}


_SETTINGS: list[tuple[str, str, str, Any, Callable[[], Any], str]] = [
    ("unknown", "gamma", _stored(1.0), soup, "SETTING_UNKNOWN"),
    ("of_mesh", "sigma", _stored(1.0), mesh, "SETTING_UNKNOWN"),
    ("unprintable", "\x1b[31m\n", _stored(1.0), mesh, "SETTING_UNKNOWN"),
    ("long_name", "x" * 100_000, _stored(1.0), mesh, "SETTING_UNKNOWN"),
    ("degree_high", "sh_degree", _stored(2), soup, "SETTING_VALUE"),
    ("degree_float", "sh_degree", _stored(1.0), soup, "SETTING_VALUE"),
    ("degree_bool", "sh_degree", _stored(True), soup, "SETTING_VALUE"),
    ("degree_null", "sh_degree", _stored(None), soup, "SETTING_VALUE"),
    ("choice", "view_dir", _stored("up"), soup, "SETTING_VALUE"),
    ("choice_type", "view_dir", _stored(0), soup, "SETTING_VALUE"),
    ("zero", "z_near", _stored(0), decoder, "SETTING_VALUE"),
    ("negative", "z_far", _stored(-1.5), decoder, "SETTING_VALUE"),
    ("huge", "z_far", _stored(1e305), decoder, "SETTING_VALUE"),
    ("bare", "z_far", 1.0, decoder, "FIELD_TYPE"),
    ("object", "z_far", _stored({}), decoder, "FIELD_TYPE"),
    ("source", "z_far", {"value": 1.0, "source": "x"}, decoder, "FIELD_VALUE"),
]


def _settings_with_slash() -> Parts:
    good = parts(mesh())
    good.manifest["settings"]["a/b~c"] = _stored(1)
    return good


def _source(**change: Any) -> dict[str, Any]:
    return {"path": "a.pt", "sha256": "0" * 64, "byte_length": 1, **change}


_HASHES = [
    ("short", "0" * 63),
    ("long", "0" * 65),
    ("capitals", "A" * 64),
    ("prefixed", "sha256:" + "0" * 57),
    ("line_break", "0" * 64 + "\n"),
    ("empty", ""),
    ("null", None),
    ("number", 0),
]

SETTING_CASES = [
    *(_bad_setting(*row) for row in _SETTINGS),
    Case("setting_slash", "TRIASSET_SETTING_UNKNOWN", packed(_settings_with_slash)),
    _value("source_hash", "CHECKSUM_MALFORMED", "/source/files", [_source(sha256="x")]),
    _value("source_size", "FIELD_VALUE", "/source/files", [_source(byte_length=-1)]),
    _value("source_path", "FIELD_VALUE", "/source/files", [_source(path="x" * 1001)]),
    _value("source_many", "FIELD_VALUE", "/source/files", [_source()] * 257),
    *(
        _value(f"hash_{name}", "CHECKSUM_MALFORMED", "/buffers/color/sha256", value)
        for name, value in _HASHES
    ),
]

CASES = [*FIELD_CASES, *SETTING_CASES]

"""Manifests with one bad value (classes 10 to 19)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msb.asset.schema import manifest_schema
from tests.corpus.case import Case, packed
from tests.corpus.good import REMOVE, Parts, decoder, mesh, parts, soup, textured


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
    ("topology_unknown", "FIELD", "/topology", "quads"),
    ("kernel_unknown", "FIELD", "/coverage/kernel", "box"),
    ("encoding_unknown", "FIELD", "/opacity/encoding", "sigmoid"),
    ("appearance_unknown", "FIELD", "/appearance/kind", "ptex"),
    ("compositing_unknown", "FIELD", "/compositing/kind", "oit"),
    ("color_space_unknown", "FIELD", "/color_space", "sRGB"),
    ("handedness_left", "FIELD", "/coordinate_frame/handedness", "left"),
    ("up_unknown", "FIELD", "/coordinate_frame/up", "up"),
    ("units_unknown", "FIELD", "/coordinate_frame/units", "inch"),
    ("method_unknown", "FIELD", "/method", "NeRF"),
    ("method_foreign_name", "FIELD", "/method", "2dts"),
    ("method_number", "FIELD", "/method", 2),
    ("pass_unknown", "FIELD", "/required_passes/standard", ["ray_trace"]),
    ("pass_number", "FIELD", "/required_passes/standard", [1]),
    ("passes_none", "FIELD", "/required_passes/standard", []),
    ("passes_17", "FIELD", "/required_passes/standard", ["opaque_unlit"] * 17),
]

_VERSIONS = ["1", "1.0.0", "01.0", "1.00", "v1.0", " 1.0", "1.0\n", "1,0", "", "1.-1", "\uff11.0", 1.0, None]

_COUNTS = [
    ("negative", -1, "FIELD"),
    ("2_32", 2**32, "FIELD"),
    ("2_63", 2**63, "FIELD"),
    ("2_64", 2**64, "FIELD"),
    ("minus_2_63", -(2**63), "FIELD"),
    ("greatest", 2**32 - 1, "BUFFER"),
    ("one_less", 3, "BUFFER"),
]


def _rest_at_0() -> Parts:
    return parts(soup()).change("/sh_degree", 0).change("/settings", {})


_TEXTURED: list[tuple[str, str, str, Any]] = [
    ("version", "FIELD", "/version", "1.0"),
    ("pass", "FIELD", "/required_passes/standard", ["opaque_unlit"]),
    ("filter", "FIELD", "/appearance/filter", "cubic"),
    ("wrap", "FIELD", "/appearance/wrap_v", REMOVE),
    ("mipmaps", "FIELD", "/appearance/mipmaps", 1),
    ("cutoff", "FIELD", "/appearance/alpha_cutoff", 1.5),
    ("cutoff_absent", "FIELD", "/appearance/alpha_cutoff", REMOVE),
    ("uv_wide", "BUFFER", "/buffers/uv/shape", [4, 3]),
    ("uv_face", "BUFFER", "/buffers/uv/domain", "face"),
    ("uv_absent", "BUFFER", "/buffers/uv", REMOVE),
    ("flat", "BUFFER", "/buffers/texture.0/shape", [6, 2]),
    ("huge", "BUFFER", "/buffers/texture.0/shape", [16385, 100_000, 3]),
    ("grey", "BUFFER", "/buffers/texture.0/shape", [2, 6, 1]),
    ("of_faces", "BUFFER", "/buffers/texture.0/domain", "face"),
    ("first_absent", "BUFFER", "/buffers/texture.0", REMOVE),
    ("face_texture", "BUFFER", "/buffers/face_texture", REMOVE),
]

FIELD_CASES = [
    *(_value(f"texture_{name}", code, pointer, value, textured) for name, code, pointer, value in _TEXTURED),
    _value("texture_pass_alone", "FIELD", "/required_passes/standard", ["opaque_unlit_texture"]),
    *(_value(f"no_{key}", "FIELD", f"/{key}", REMOVE) for key in _REQUIRED),
    *(
        _value("no_" + pointer[1:].replace("/", "_"), "FIELD", pointer, REMOVE, soup)
        for pointer in _REQUIRED_INSIDE
    ),
    *(
        _value(
            "type_" + key.replace("/", "_"),
            "BUFFER" if key.startswith("buffers/positions/") else "FIELD",
            f"/{key}",
            value,
        )
        for key, value in _WRONG_TYPES.items()
    ),
    *(_value(f"integer_{name}", "FIELD", "/face_count", value) for name, value in _INTEGER_LIES),
    *(_value(name, code, pointer, value) for name, code, pointer, value in _ENUMS),
    _value("generator_long", "FIELD", "/generator", "x" * 1001),
    _value("generator_megabyte", "FIELD", "/generator", ["x" * 900_000]),
    _value("format_other", "MANIFEST", "/format", "glTF"),
    _value("format_capitals", "MANIFEST", "/format", "TRIASSET"),
    _value("format_null", "MANIFEST", "/format", None),
    *(_value(f"version_{i}", "MANIFEST", "/version", version) for i, version in enumerate(_VERSIONS)),
    _value("version_0_9", "VERSION_UNSUPPORTED", "/version", "0.9"),
    _value("version_2_0", "VERSION_UNSUPPORTED", "/version", "2.0"),
    _value("version_1_2", "VERSION_NEWER", "/version", "1.2", severity="warning"),
    _value("unknown_key", "FIELD_UNKNOWN", "/lod", 3, severity="warning"),
    _value("method_elsewhere", "METHOD_NOT_INSTALLED", "/method", "nerf", severity="warning"),
    _value("unknown_escape", "FIELD_UNKNOWN", "/\x1b[2J\r", 0, severity="warning"),
    _value("unknown_in_bounds", "FIELD_UNKNOWN", "/bounds/w", 0, severity="warning"),
    _value("unknown_in_buffer", "FIELD_UNKNOWN", "/buffers/color/stride", 4, severity="warning"),
    _value("unknown_in_source", "FIELD_UNKNOWN", "/source/author", "x", severity="warning"),
    _value("unknown_tier", "FIELD_UNKNOWN", "/required_passes/webgl", 5, severity="warning"),
    *(_value(f"vertex_count_{name}", code, "/vertex_count", value) for name, value, code in _COUNTS),
    *(_value(f"face_count_{name}", code, "/face_count", value) for name, value, code in _COUNTS),
    _value("no_faces", "EMPTY", "/face_count", 0, also=("TRIASSET_BUFFER",)),
    _value("no_vertices", "EMPTY", "/vertex_count", 0, also=("TRIASSET_BUFFER",)),
    _value("soup_count", "FIELD", "/topology", "triangle_soup"),
    *(
        _value(f"sh_degree_{i}", "FIELD", "/sh_degree", degree, soup)
        for i, degree in enumerate((-1, 4, 1.0, True, "1", None, 2**64))
    ),
    _value("sh_width", "FIELD", "/sh_degree", 2, soup),
    _value("sh_no_rest", "FIELD", "/sh_degree", 1, mesh),
    _value("sh_order_absent", "FIELD", _ORDER, REMOVE, soup),
    _value("sh_order_unknown", "FIELD", _ORDER, "morton", soup),
    Case("sh_rest_at_0", "TRIASSET_FIELD", packed(_rest_at_0)),
    _value("bounds_inverted", "FIELD", "/bounds/min/1", 7),
    _value("bounds_two", "FIELD", "/bounds/min", [0, 0]),
    _value("bounds_many", "FIELD", "/bounds/min", [0] * 100_000),
    _value("radius_negative", "FIELD", "/bounding_sphere/radius", -1),
]


def _bad_setting(name: str, setting: str, stored: Any, make: Callable[[], Any], code: str) -> Case:
    return _value(f"setting_{name}", code, f"/settings/{setting}", stored, make)


def _stored(value: Any) -> dict[str, Any]:
    return {"value": value, "source": "flag"}


_SETTINGS: list[tuple[str, str, str, Any, Callable[[], Any], str]] = [
    ("unknown", "gamma", _stored(1.0), soup, "FIELD"),
    ("of_mesh", "sigma", _stored(1.0), mesh, "FIELD"),
    ("unprintable", "\x1b[31m\n", _stored(1.0), mesh, "FIELD"),
    ("long_name", "x" * 100_000, _stored(1.0), mesh, "FIELD"),
    ("degree_high", "sh_degree", _stored(2), soup, "FIELD"),
    ("degree_float", "sh_degree", _stored(1.0), soup, "FIELD"),
    ("degree_bool", "sh_degree", _stored(True), soup, "FIELD"),
    ("degree_null", "sh_degree", _stored(None), soup, "FIELD"),
    ("choice", "view_dir", _stored("up"), soup, "FIELD"),
    ("choice_type", "view_dir", _stored(0), soup, "FIELD"),
    ("zero", "z_near", _stored(0), decoder, "FIELD"),
    ("negative", "z_far", _stored(-1.5), decoder, "FIELD"),
    ("huge", "z_far", _stored(1e305), decoder, "FIELD"),
    ("bare", "z_far", 1.0, decoder, "FIELD"),
    ("object", "z_far", _stored({}), decoder, "FIELD"),
    ("source", "z_far", {"value": 1.0, "source": "x"}, decoder, "FIELD"),
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
    Case("setting_slash", "TRIASSET_FIELD", packed(_settings_with_slash)),
    _value("source_hash", "BUFFER", "/source/files", [_source(sha256="x")]),
    _value("source_size", "FIELD", "/source/files", [_source(byte_length=-1)]),
    _value("source_path", "FIELD", "/source/files", [_source(path="x" * 1001)]),
    _value("source_many", "FIELD", "/source/files", [_source()] * 257),
    *(_value(f"hash_{name}", "BUFFER", "/buffers/color/sha256", value) for name, value in _HASHES),
]

CASES = [*FIELD_CASES, *SETTING_CASES]

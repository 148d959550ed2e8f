"""Parse one JSON document from untrusted bytes, without the liberties of the standard parser.

Python's `json` keeps the last of two equal keys, accepts NaN and Infinity, turns 1e999 into infinity and
lets deep nesting end in RecursionError. A manifest that relies on any of these is refused.
"""

from __future__ import annotations

import json
from typing import Any, NoReturn

from msb.errors import AssetError, shorten

MAX_BYTES = 1 << 20
"""A manifest of 64 buffers is about 20 kB; one MiB leaves room and bounds the work."""
MAX_DEPTH = 16
"""The format nests 4 deep; extensions may nest further."""
MAX_DIGITS = 20
"""2^64 has 20 digits; no field of the format needs more."""


def parse_strict_json(data: bytes, *, file: object) -> Any:
    """Return the JSON value in `data`.

    Parameters
    ----------
    data : bytes
        One UTF-8 document without byte-order mark.
    file : path-like
        Named in errors.

    Raises
    ------
    AssetError
        `TRIASSET_MANIFEST_...`: EMPTY, TOO_LARGE, ENCODING, TOO_DEEP, SYNTAX, DUPLICATE_KEY, NONFINITE or
        INTEGER.
    """

    def refuse(code: str, message: str, **where: Any) -> NoReturn:
        raise AssetError(f"TRIASSET_MANIFEST_{code}", message, file=file, **where)

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key, value in pairs:
            if key in result:
                refuse("DUPLICATE_KEY", f'manifest.json names the key "{shorten(key)}" twice', value=key)
            result[key] = value
        return result

    def no_constant(name: str) -> NoReturn:
        refuse("NONFINITE", f"manifest.json holds {name}; JSON numbers are finite", value=name)

    def finite(text: str) -> float:
        number = float(text)
        if abs(number) == float("inf"):
            refuse("NONFINITE", f"manifest.json holds {shorten(text)}, which overflows", value=shorten(text))
        return number

    def bounded_integer(text: str) -> int:
        if len(text.lstrip("-")) > MAX_DIGITS:
            refuse(
                "INTEGER",
                f"manifest.json holds an integer of {len(text)} digits; at most {MAX_DIGITS} are allowed",
                value=shorten(text, 30),
                limit=MAX_DIGITS,
            )
        return int(text)

    if not data:
        refuse("EMPTY", "manifest.json is empty; it must hold one JSON object")
    if len(data) > MAX_BYTES:
        refuse("TOO_LARGE", f"manifest.json has {len(data)} bytes", value=len(data), limit=MAX_BYTES)
    if data.startswith(b"\xef\xbb\xbf"):
        refuse("ENCODING", "manifest.json starts with a byte-order mark; it must be plain UTF-8")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        refuse(
            "ENCODING",
            f"manifest.json is not UTF-8: byte {error.start} is 0x{data[error.start]:02x}",
            pointer=f"byte {error.start}",
        )
    if (depth := _nesting(text)) > MAX_DEPTH:
        refuse(
            "TOO_DEEP",
            f"manifest.json nests {depth} levels; {MAX_DEPTH} are allowed",
            value=depth,
            limit=MAX_DEPTH,
        )
    try:
        value = json.loads(
            text,
            object_pairs_hook=unique,
            parse_constant=no_constant,
            parse_float=finite,
            parse_int=bounded_integer,
        )
    except json.JSONDecodeError as error:
        refuse(
            "SYNTAX",
            f"manifest.json is not JSON: {error.msg} at line {error.lineno}, column {error.colno}",
            pointer=f"byte {len(text[: error.pos].encode())}",
        )
    if _has_lone_surrogate(value):
        refuse("ENCODING", "manifest.json escapes half of a surrogate pair, which is no character")
    return value


def _nesting(text: str) -> int:
    """Return the greatest nesting of brackets outside strings (0 if there are none)."""
    depth = deepest = 0
    inside = escaped = False
    for character in text:
        if inside:
            if escaped:
                escaped = False
            elif character == "\\":
                escaped = True
            elif character == '"':
                inside = False
        elif character == '"':
            inside = True
        elif character in "[{":
            depth += 1
            deepest = max(deepest, depth)
        elif character in "]}":
            depth -= 1
    return deepest


def _has_lone_surrogate(value: Any) -> bool:
    """Return whether any string in the parsed document cannot be written as UTF-8."""
    if isinstance(value, str):
        return any("\ud800" <= character <= "\udfff" for character in value)
    if isinstance(value, list):
        return any(map(_has_lone_surrogate, value))
    if isinstance(value, dict):
        return any(map(_has_lone_surrogate, value)) or any(map(_has_lone_surrogate, value.values()))
    return False

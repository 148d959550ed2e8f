"""Parse one JSON document from untrusted bytes, without the liberties of the standard parser.

Python's `json` keeps the last of two equal keys, accepts NaN and Infinity, turns 1e999 into infinity and
lets deep nesting end in RecursionError. A manifest that relies on any of these is refused.
"""

from __future__ import annotations

import json
import re
from typing import Any, NoReturn

from msb.asset.manifest import MANIFEST_NAME
from msb.base.bounded_parsing import json_nesting
from msb.errors import AssetError, shorten

MAX_BYTES = 1 << 20
"""Most bytes of a document. A manifest of 64 buffers has about 20 kB; one MiB leaves room and bounds the
work."""
MAX_DEPTH = 16
"""Deepest nesting. The format nests 4 deep; extensions may nest further."""
MAX_DIGITS = 20
"""Most digits of an integer. 2^64 has 20 digits; no field of the format needs more."""
_SURROGATE = re.compile(r"[\ud800-\udfff]")


def parse_strict_json(
    data: bytes, *, file: object, name: str = MANIFEST_NAME, max_bytes: int = MAX_BYTES
) -> Any:
    """Return the JSON value in `data`: one UTF-8 document without byte-order mark.

    Errors name `file`, and in it the document `name`.
    """
    return _Parser(file, name, max_bytes).parse(data)


class _Parser:
    """Parse one document; every method raises `AssetError` naming the file."""

    def __init__(self, file: object, name: str, max_bytes: int) -> None:
        self.file = file
        self.name = name
        self.max_bytes = max_bytes

    def refuse(self, code: str, message: str, **where: Any) -> NoReturn:
        raise AssetError(code, f"{self.name} {message}", file=self.file, **where)

    def parse(self, data: bytes) -> Any:
        text = self.decode(data)
        if (depth := json_nesting(text)) > MAX_DEPTH:
            message = f"nests {depth} levels; {MAX_DEPTH} are allowed"
            self.refuse("TRIASSET_MANIFEST", message)
        try:
            value = json.loads(
                text,
                object_pairs_hook=self.unique,
                parse_constant=self.no_constant,
                parse_float=self.finite,
                parse_int=self.bounded_integer,
            )
        except json.JSONDecodeError as error:
            self.refuse(
                "TRIASSET_MANIFEST",
                f"is not JSON: {error.msg} at line {error.lineno}, column {error.colno}",
                pointer=f"byte {len(text[: error.pos].encode())}",
            )
        if has_lone_surrogate(value):
            message = "escapes half of a surrogate pair, which is no character"
            self.refuse("TRIASSET_MANIFEST", message)
        return value

    def decode(self, data: bytes) -> str:
        if not data:
            self.refuse("TRIASSET_MANIFEST", "is empty; it must hold one JSON document")
        if len(data) > self.max_bytes:
            message = f"has more than {self.max_bytes} bytes"
            self.refuse("TRIASSET_MANIFEST", message)
        if data.startswith(b"\xef\xbb\xbf"):
            message = "starts with a byte-order mark; it must be plain UTF-8"
            self.refuse("TRIASSET_MANIFEST", message, pointer="byte 0")
        try:
            return data.decode("utf-8")
        except UnicodeDecodeError as error:
            at = error.start
            message = f"is not UTF-8: byte {at} is 0x{data[at]:02x}"
            self.refuse("TRIASSET_MANIFEST", message, pointer=f"byte {at}")

    def unique(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for key, value in pairs:
            if key in result:
                message = f'names the key "{shorten(key)}" twice'
                self.refuse("TRIASSET_MANIFEST", message)
            result[key] = value
        return result

    def no_constant(self, name: str) -> NoReturn:
        self.refuse("TRIASSET_MANIFEST", f"holds {name}; JSON numbers are finite")

    def finite(self, text: str) -> float:
        number = float(text)
        if abs(number) == float("inf"):
            message = f"holds {shorten(text)}, which overflows"
            self.refuse("TRIASSET_MANIFEST", message)
        return number

    def bounded_integer(self, text: str) -> int:
        if (digits := len(text.lstrip("-"))) > MAX_DIGITS:
            message = f"holds an integer of {digits} digits; {MAX_DIGITS} are allowed"
            self.refuse("TRIASSET_MANIFEST", message)
        return int(text)


def has_lone_surrogate(value: Any) -> bool:
    """Return whether any string in the JSON data `value` cannot be written as UTF-8."""
    if isinstance(value, str):
        return not value.isascii() and _SURROGATE.search(value) is not None
    if isinstance(value, list):
        return any(map(has_lone_surrogate, value))
    if isinstance(value, dict):
        return any(map(has_lone_surrogate, value)) or any(map(has_lone_surrogate, value.values()))
    return False

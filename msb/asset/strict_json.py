"""Parse a JSON document from untrusted bytes, more strictly than the standard parser.

Python's `json` keeps the last of two equal keys, accepts NaN and Infinity, turns 1e999 into infinity, and
raises RecursionError for deep nesting. This parser rejects all these documents.
"""

import json
import re
from typing import Any, NoReturn

from msb.asset.manifest import MANIFEST_NAME
from msb.base.bounded_parsing import json_nesting
from msb.errors import AssetError, MsbError, shorten

# Maximum size of a document in bytes. A manifest with 64 buffers has about 20 kB.
MAX_BYTES = 1 << 20
# Maximum nesting. The format has 4 levels of nesting, and extensions may have more.
MAX_DEPTH = 16
# Maximum number of digits of an integer. 2^64 has 20 digits, and no key of the format needs more.
MAX_DIGITS = 20
_SURROGATE = re.compile(r"[\ud800-\udfff]")


class _RejectedError(Exception):
    """The problem in a document, and its position in bytes.

    A message continues a sentence that begins with the name of the document.
    """

    def __init__(self, message: str, byte: int | None = None) -> None:
        super().__init__(message)
        self.pointer = None if byte is None else f"byte {byte}"


def parse_strict_json(
    data: bytes,
    *,
    file: object,
    name: str = MANIFEST_NAME,
    max_bytes: int = MAX_BYTES,
    error: type[MsbError] = AssetError,
    code: str = "TRIASSET_MANIFEST",
) -> Any:
    """Return the value of a JSON document, which is UTF-8 without a byte-order mark.

    Errors have the class `error` and the code `code`. Error messages contain the names `file` and `name`.
    """
    try:
        text = _decode(data, max_bytes)
        if (depth := json_nesting(text)) > MAX_DEPTH:
            raise _RejectedError(f"has {depth} levels of nesting; {MAX_DEPTH} are allowed")
        hooks: dict[str, Any] = {"parse_float": _parse_finite, "parse_int": _parse_integer}
        value = json.loads(
            text, object_pairs_hook=_reject_repeated_keys, parse_constant=_reject_constant, **hooks
        )
        if has_lone_surrogate(value):
            raise _RejectedError("contains half of a surrogate pair, which is not a character")
    except json.JSONDecodeError as wrong:
        message = f"{name} is not JSON: {wrong.msg} at line {wrong.lineno}, column {wrong.colno}"
        pointer = f"byte {len(text[: wrong.pos].encode())}"
        raise error(code, message, file=file, pointer=pointer) from None
    except _RejectedError as wrong:
        raise error(code, f"{name} {wrong}", file=file, pointer=wrong.pointer) from None
    return value


def _decode(data: bytes, max_bytes: int) -> str:
    if not data:
        raise _RejectedError("is empty; it must hold one JSON document")
    if len(data) > max_bytes:
        raise _RejectedError(f"has more than {max_bytes} bytes")
    if data.startswith(b"\xef\xbb\xbf"):
        raise _RejectedError("starts with a byte-order mark; it must be plain UTF-8", 0)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        at = error.start
        raise _RejectedError(f"is not UTF-8: byte {at} is 0x{data[at]:02x}", at) from None


def _reject_repeated_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in pairs:
        if key in result:
            raise _RejectedError(f'has the key "{shorten(key)}" twice')
        result[key] = value
    return result


def _reject_constant(name: str) -> NoReturn:
    raise _RejectedError(f"contains {name}; JSON numbers are finite")


def _parse_finite(text: str) -> float:
    number = float(text)
    if abs(number) == float("inf"):
        raise _RejectedError(f"contains {shorten(text)}, which overflows")
    return number


def _parse_integer(text: str) -> int:
    if (digits := len(text.lstrip("-"))) > MAX_DIGITS:
        raise _RejectedError(f"contains an integer of {digits} digits; {MAX_DIGITS} are allowed")
    return int(text)


def has_lone_surrogate(value: Any) -> bool:
    """Return whether a string in the JSON data `value` cannot be encoded as UTF-8."""
    if isinstance(value, str):
        return not value.isascii() and _SURROGATE.search(value) is not None
    if isinstance(value, list):
        return any(map(has_lone_surrogate, value))
    if isinstance(value, dict):
        return any(map(has_lone_surrogate, value)) or any(map(has_lone_surrogate, value.values()))
    return False

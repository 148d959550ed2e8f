"""Manifests that are no JSON document, or one that JSON readers disagree on (classes 1 to 9)."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from tests.corpus.case import Case
from tests.corpus.good import mesh, parts

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

MIB = 1 << 20


def _text(name: str, title: str, code: str, spoil: Callable[[bytes], bytes]) -> Case:
    """Return a case whose manifest is `spoil` of a good one: a folder, since every program can edit that."""

    def write(path: Path) -> None:
        good = parts(mesh())
        good.write_folder(path, spoil(good.text()))

    return Case(f"manifest_{name}", title, f"TRIASSET_MANIFEST_{code}", write)


def _without(path: Path) -> None:
    parts(mesh()).write_folder(path)
    (path / "manifest.json").unlink()


def _in_capitals(path: Path) -> None:
    parts(mesh()).write_folder(path)
    (path / "manifest.json").rename(path / "MANIFEST.JSON")


def _in_subfolder(path: Path) -> None:
    path.mkdir()
    parts(mesh()).write_folder(path / "inner")


def _insert(what: bytes) -> Callable[[bytes], bytes]:
    """Return a function that puts `what` behind the first brace."""
    return lambda text: text.replace(b"{", b"{" + what, 1)


def _swap(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    return lambda text: text.replace(old, new, 1)


def _entry_twice(text: bytes) -> bytes:
    spec = json.dumps(json.loads(text)["buffers"]["color"]).encode()
    return text.replace(b'"color": {', b'"color": ' + spec + b', "color": {', 1)


_NOT_JSON = [
    ("blank", "white space only", lambda _: b" \n\t"),
    ("plain_text", "a sentence", lambda _: b"this is an asset"),
    ("nul", "a NUL byte", lambda _: b"\0"),
    ("nul_after", "a NUL behind the document", lambda t: t + b"\0"),
    ("trailing_junk", "junk behind the document", lambda t: t + b"x"),
    ("two_documents", "two documents", lambda t: t + t),
    ("trailing_comma", "a comma too many", lambda t: t.rstrip()[:-1] + b",}"),
    ("comment", "a comment", _insert(b"/* v1 */")),
    ("single_quotes", "single quotes", lambda t: t.replace(b'"', b"'")),
    ("bare_key", "a key without quotes", _swap(b'"format"', b"format")),
    ("control_character", "a raw line break in a string", _swap(b"triasset", b"tri\nasset")),
    ("bad_escape", "an escape JSON does not have", _swap(b"triasset", b"tri\\x61sset")),
    ("cut", "the second half is missing", lambda t: t[: len(t) // 2]),
    ("leading_zero", "a number with a leading zero", _swap(b'"face_count": 4', b'"face_count": 04')),
    ("plus_sign", "a number with a plus sign", _swap(b'"face_count": 4', b'"face_count": +4')),
    ("hex_number", "a hexadecimal number", _swap(b'"face_count": 4', b'"face_count": 0x4')),
    ("python_true", "a Python literal", _swap(b'"face_count": 4', b'"face_count": True')),
]

_ENCODINGS = [
    ("bom", "a byte-order mark", lambda t: b"\xef\xbb\xbf" + t),
    ("latin1", "a Latin-1 byte", _swap(b"meshsplatbench", b"m\xe9shsplatbench")),
    ("utf16", "UTF-16", lambda t: t.decode().encode("utf-16")),
    ("overlong", "an overlong slash", _swap(b"buffers/", b"buffers\xc0\xaf")),
    ("raw_surrogate", "a surrogate as UTF-8 bytes", _swap(b"meshsplatbench", b"\xed\xa0\x80")),
    ("lone_surrogate", "half of an escaped pair", _swap(b"meshsplatbench", b"\\ud800")),
    ("surrogate_key", "a key that is half a pair", _insert(b'"\\udfff": 0,')),
    ("cut_character", "a character cut in two", lambda t: t.rstrip()[:-1] + b', "x": "\xe2\x82'),
]

_ROOTS = [
    ("array", b"[]"),
    ("string", b'"triasset"'),
    ("number", b"1"),
    ("null", b"null"),
    ("true", b"true"),
]

_DUPLICATES = [
    ("duplicate_key", "a root key twice", _insert(b'"format": "triasset",')),
    ("duplicate_escaped", "a key twice, once escaped", _insert(b'"form\\u0061t": "triasset",')),
    ("duplicate_unknown", "an unknown key twice", _insert(b'"x": 1, "x": 1,')),
    ("duplicate_buffer", "the same buffer twice", _entry_twice),
    ("duplicate_in_buffer", "a buffer with two files", _swap(b'"file":', b'"file": "../x", "file":')),
]

_NUMBERS = [
    ("nan", "NaN", b"NaN"),
    ("infinity", "Infinity", b"Infinity"),
    ("minus_infinity", "-Infinity", b"-Infinity"),
    ("overflow", "1e400", b"1e400"),
    ("overflow_negative", "-1e999999", b"-1e999999"),
]

_INTEGERS = [
    ("21_digits", "an integer of 21 digits", b"1" * 21),
    ("minus_21_digits", "a negative integer of 21 digits", b"-" + b"1" * 21),
    ("5000_digits", "an integer Python refuses to convert", b"9" * 5000),
]

_DEEP = [
    ("17_levels", "one level more than allowed", b'{"x":' + b"[" * 16 + b"]" * 16 + b"}"),
    ("deep_arrays", "100 000 arrays", b'{"x":' + b"[" * 100_000 + b"]" * 100_000 + b"}"),
    ("deep_objects", "100 000 objects", b'{"x":' * 100_000 + b"0" + b"}" * 100_000),
    ("deep_open", "a million arrays never closed", b"[" * (MIB - 1)),
]

CASES = [
    Case("manifest_missing", "a folder without manifest", "TRIASSET_MANIFEST_MISSING", _without),
    Case("manifest_empty_folder", "an empty folder", "TRIASSET_MANIFEST_MISSING", lambda path: path.mkdir()),
    Case("manifest_capitals", "MANIFEST.JSON", "TRIASSET_MANIFEST_MISSING", _in_capitals),
    Case("manifest_in_subfolder", "an asset in a folder", "TRIASSET_MANIFEST_MISSING", _in_subfolder),
    _text("empty", "no bytes", "EMPTY", lambda _: b""),
    _text("over_1_mib", "one byte over 1 MiB", "TOO_LARGE", lambda t: t.ljust(MIB + 1)),
    _text("over_1_mib_junk", "4 MiB of zeros", "TOO_LARGE", lambda _: bytes(4 * MIB)),
    *(_text(name, title, "SYNTAX", spoil) for name, title, spoil in _NOT_JSON),
    *(_text(name, title, "ENCODING", spoil) for name, title, spoil in _ENCODINGS),
    *(_text(f"root_{n}", f"the root is {n}", "NOT_OBJECT", lambda _, t=t: t) for n, t in _ROOTS),
    *(_text(name, title, "DUPLICATE_KEY", spoil) for name, title, spoil in _DUPLICATES),
    *(
        _text(name, f"a value is {title}", "NONFINITE", _insert(b'"x": ' + literal + b","))
        for name, title, literal in _NUMBERS
    ),
    *(
        _text(name, title, "INTEGER", _insert(b'"x": ' + literal + b","))
        for name, title, literal in _INTEGERS
    ),
    *(_text(name, title, "TOO_DEEP", lambda _, t=t: t) for name, title, t in _DEEP),
]

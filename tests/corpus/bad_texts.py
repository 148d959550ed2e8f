"""Manifests that are no JSON document, or one that JSON readers disagree on (classes 1 to 9)."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from tests.corpus.case import Case
from tests.corpus.good import mesh, parts

MIB = 1 << 20


def _text(name: str, spoil: Callable[[bytes], bytes]) -> Case:
    """Return a case whose manifest is `spoil` of a good one: a folder, since every program can edit that."""

    def write(path: Path) -> None:
        good = parts(mesh())
        good.write_folder(path, spoil(good.text()))

    return Case(f"manifest_{name}", "TRIASSET_MANIFEST", write)


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
    ("blank", lambda _: b" \n\t"),
    ("plain_text", lambda _: b"this is an asset"),
    ("nul", lambda _: b"\0"),
    ("nul_after", lambda t: t + b"\0"),
    ("trailing_junk", lambda t: t + b"x"),
    ("two_documents", lambda t: t + t),
    ("trailing_comma", lambda t: t.rstrip()[:-1] + b",}"),
    ("comment", _insert(b"/* v1 */")),
    ("single_quotes", lambda t: t.replace(b'"', b"'")),
    ("bare_key", _swap(b'"format"', b"format")),
    ("control_character", _swap(b"triasset", b"tri\nasset")),
    ("bad_escape", _swap(b"triasset", b"tri\\x61sset")),
    ("cut", lambda t: t[: len(t) // 2]),
    ("leading_zero", _swap(b'"face_count": 4', b'"face_count": 04')),
    ("plus_sign", _swap(b'"face_count": 4', b'"face_count": +4')),
    ("hex_number", _swap(b'"face_count": 4', b'"face_count": 0x4')),
    ("python_true", _swap(b'"face_count": 4', b'"face_count": True')),
]

_ENCODINGS = [
    ("bom", lambda t: b"\xef\xbb\xbf" + t),
    ("latin1", _swap(b"meshsplatbench", b"m\xe9shsplatbench")),
    ("utf16", lambda t: t.decode().encode("utf-16")),
    ("overlong", _swap(b"buffers/", b"buffers\xc0\xaf")),
    ("raw_surrogate", _swap(b"meshsplatbench", b"\xed\xa0\x80")),
    ("lone_surrogate", _swap(b"meshsplatbench", b"\\ud800")),
    ("surrogate_key", _insert(b'"\\udfff": 0,')),
    ("cut_character", lambda t: t.rstrip()[:-1] + b', "x": "\xe2\x82'),
]

_ROOTS = [("array", b"[]"), ("string", b'"triasset"'), ("number", b"1"), ("null", b"null"), ("true", b"true")]

_DUPLICATES = [
    ("duplicate_key", _insert(b'"format": "triasset",')),
    ("duplicate_escaped", _insert(b'"form\\u0061t": "triasset",')),
    ("duplicate_unknown", _insert(b'"x": 1, "x": 1,')),
    ("duplicate_buffer", _entry_twice),
    ("duplicate_in_buffer", _swap(b'"file":', b'"file": "../x", "file":')),
]

_NUMBERS = [
    ("nan", b"NaN"),
    ("infinity", b"Infinity"),
    ("minus_infinity", b"-Infinity"),
    ("overflow", b"1e400"),
    ("overflow_negative", b"-1e999999"),
]

_INTEGERS = [("21_digits", b"1" * 21), ("minus_21_digits", b"-" + b"1" * 21), ("5000_digits", b"9" * 5000)]

_DEEP = [
    ("17_levels", b'{"x":' + b"[" * 16 + b"]" * 16 + b"}"),
    ("deep_arrays", b'{"x":' + b"[" * 100_000 + b"]" * 100_000 + b"}"),
    ("deep_objects", b'{"x":' * 100_000 + b"0" + b"}" * 100_000),
    ("deep_open", b"[" * (MIB - 1)),
]

CASES = [
    Case("manifest_missing", "TRIASSET_MANIFEST_MISSING", _without),
    Case("manifest_empty_folder", "TRIASSET_MANIFEST_MISSING", lambda path: path.mkdir()),
    Case("manifest_capitals", "TRIASSET_MANIFEST_MISSING", _in_capitals),
    Case("manifest_in_subfolder", "TRIASSET_MANIFEST_MISSING", _in_subfolder),
    _text("empty", lambda _: b""),
    _text("over_1_mib", lambda t: t.ljust(MIB + 1)),
    _text("over_1_mib_junk", lambda _: bytes(4 * MIB)),
    *(_text(name, spoil) for name, spoil in _NOT_JSON),
    *(_text(name, spoil) for name, spoil in _ENCODINGS),
    *(_text(f"root_{n}", lambda _, t=t: t) for n, t in _ROOTS),
    *(_text(name, spoil) for name, spoil in _DUPLICATES),
    *(_text(name, _insert(b'"x": ' + literal + b",")) for name, literal in _NUMBERS),
    *(_text(name, _insert(b'"x": ' + literal + b",")) for name, literal in _INTEGERS),
    *(_text(name, lambda _, t=t: t) for name, t in _DEEP),
]

"""Seeded mutations of bytes and of JSON, for fuzz targets without coverage feedback."""

import os
import random
import re
from collections.abc import Callable

TIMES = int(os.environ.get("MSB_MUTATIONS", "1"))
"""Ratio of the number of mutations to the number in a normal test run."""


def span(data: bytearray, rng: random.Random, longest: int = 64) -> slice:
    start = rng.randrange(len(data) + 1)
    return slice(start, start + rng.randint(1, longest))


def flip(data: bytearray, rng: random.Random) -> None:
    for _ in range(rng.choice((1, 1, 1, 2, 8))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def overwrite(data: bytearray, rng: random.Random) -> None:
    what = rng.choice(
        (b"\0", b"\xff", b"\0" * 8, b"\xff" * 4, b"\xff" * 8, b"\x7f", b"PK\x03\x04", b"PK\x05\x06")
    )
    start = rng.randrange(len(data))
    data[start : start + len(what)] = what


def insert(data: bytearray, rng: random.Random) -> None:
    at = rng.randrange(len(data) + 1)
    data[at:at] = rng.randbytes(rng.choice((1, 2, 4, 64)))


def delete(data: bytearray, rng: random.Random) -> None:
    del data[span(data, rng)]


def swap(data: bytearray, rng: random.Random) -> None:
    first, second = span(data, rng), span(data, rng)
    data[first], data[second] = data[second], data[first]


def double(data: bytearray, rng: random.Random) -> None:
    where = span(data, rng)
    data[where.stop : where.stop] = data[where]


def cut(data: bytearray, rng: random.Random) -> None:
    del data[rng.randrange(len(data)) :]


BYTE_MUTATORS: list[Callable[[bytearray, random.Random], None]] = [
    *(flip, flip, flip, overwrite, overwrite, insert, delete, swap, double, cut)
]

TOKENS = re.compile(rb'"[^"]*"|-?[0-9][0-9.eE+-]*|true|false|null|[][{},:]')
NUMBERS = """-1 0 1 2 3 1.0 1.5 -0 0.0 1e400 -1e400 1e308 1e-320 NaN 2147483648 4294967295 4294967296
9223372036854775807 18446744073709551616 999999999999999999999"""
OTHERS = r"""null true false "" "x" "../x" "\ud800" "\u0000" "positions" "triasset" "1.7"
[] {} [0] {"x":0} [[[[[[[[[[[[[[[[0]]]]]]]]]]]]]]]] , : [ ] { }"""
REPLACEMENTS = [token.encode() for token in (NUMBERS + " " + OTHERS).split()]


def replace_token(text: bytes, rng: random.Random) -> bytes:
    """Return the text with one token replaced by another token of the text or by a fixed value."""
    tokens = list(TOKENS.finditer(text))
    token = rng.choice(tokens)
    new = rng.choice(tokens).group() if rng.random() < 0.3 else rng.choice(REPLACEMENTS)
    return text[: token.start()] + new + text[token.end() :]


def double_line(text: bytes, rng: random.Random) -> bytes:
    """Return the text with one line duplicated or moved, possibly into another object."""
    lines = text.splitlines(keepends=True)
    line = rng.choice(lines) if rng.random() < 0.5 else lines.pop(rng.randrange(len(lines)))
    lines.insert(rng.randrange(len(lines) + 1), line)
    return b"".join(lines)


def mutate_text(text: bytes, rng: random.Random) -> bytes:
    for _ in range(rng.choice((1, 1, 2, 3))):
        text = double_line(text, rng) if rng.random() < 0.2 else replace_token(text, rng)
    return text


def mutate_bytes(data: bytes, rng: random.Random) -> bytes:
    mutant = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2))):
        if mutant:
            rng.choice(BYTE_MUTATORS)(mutant, rng)
    return bytes(mutant)

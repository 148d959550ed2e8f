"""Every prefix and thousands of seeded mutations of three small assets: our error, or a sound asset."""

from __future__ import annotations

import os
import random
import re
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from msb.asset import load, validate
from msb.asset.container import PackedContainer
from msb.asset.manifest import DTYPES
from msb.errors import AssetError, InputError
from tests.corpus.forge import forge
from tests.corpus.good import decoder, mesh, parts, soup

if TYPE_CHECKING:
    from collections.abc import Callable

    from msb.asset import Asset

MAKERS = {"mesh": mesh, "soup": soup, "decoder": decoder}

# 34 000 in all. More by hand: MSB_MUTATIONS=20 python -m pytest tests/asset/test_mutations.py
TIMES = int(os.environ.get("MSB_MUTATIONS", "1"))
BYTE_MUTATIONS = 10_000 * TIMES  # of each of two packed assets, in memory
TOKEN_MUTATIONS = 3000 * TIMES  # of each of three manifests, in memory
FOLDER_MUTATIONS = 3000 * TIMES
FILE_MUTATIONS = 2000 * TIMES


@pytest.fixture
def in_memory(monkeypatch) -> None:
    """Let `load` and `validate` take the bytes of a packed asset in place of its path."""

    def open_bytes(data: bytes) -> PackedContainer:
        return PackedContainer(Path("mutant.triasset"), data)

    for module in ("reader", "validation"):
        monkeypatch.setattr(import_module(f"msb.asset.{module}"), "open_container", open_bytes)


def outcome(source: object) -> str:
    """Return the code that `load` raises, or "" if it gives a sound asset."""
    try:
        asset = load(source)  # type: ignore[arg-type]
    except (AssetError, InputError) as error:
        refused = error
    else:
        assert_sound(asset)
        assert validate(source).asset is not None  # type: ignore[arg-type]
        return ""
    assert str(refused).isprintable()
    assert len(str(refused)) < 600
    return refused.code


def put(path: Path, data: bytes) -> None:
    """Write a new file in place of the old one: file systems take their time to overwrite."""
    path.unlink(missing_ok=True)
    path.write_bytes(data)


def assert_sound(asset: Asset) -> None:
    m = asset.manifest
    counts = {"vertex": m.vertex_count, "face": m.face_count, "corner": 3 * m.face_count}
    assert m.vertex_count > 0
    assert m.face_count > 0
    assert {"positions", "indices"} <= set(asset.buffers) == set(m.buffers)
    for name, spec in m.buffers.items():
        array = asset.buffers[name]
        assert array.shape == spec.shape
        assert array.size > 0
        assert array.dtype == DTYPES[spec.dtype]
        assert array.nbytes == spec.byte_length
        assert not array.flags.writeable
        assert spec.domain == "global" or len(array) == counts[spec.domain]


# --- mutations -----------------------------------------------------------------------------------------


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
    """Return the manifest with one token replaced by another value, or by another of its own."""
    tokens = list(TOKENS.finditer(text))
    token = rng.choice(tokens)
    new = rng.choice(tokens).group() if rng.random() < 0.3 else rng.choice(REPLACEMENTS)
    return text[: token.start()] + new + text[token.end() :]


def double_line(text: bytes, rng: random.Random) -> bytes:
    """Return the manifest with a line twice or elsewhere: a key doubled or moved into another object."""
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


# --- prefixes ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["mesh", "soup"])
def test_every_prefix_of_a_packed_asset_is_truncated(name: str, in_memory) -> None:
    data = forge(parts(MAKERS[name]()).entries())
    assert outcome(data) == ""
    codes = {outcome(data[:length]) for length in range(len(data))}
    assert codes == {"TRIASSET_ZIP_TRUNCATED"}


def test_prefixes_of_a_packed_file_are_truncated(tmp_path: Path) -> None:
    data = forge(parts(mesh()).entries())
    path = tmp_path / "a.triasset"
    for length in (*range(8), *range(8, len(data), 61), *range(len(data) - 30, len(data))):
        put(path, data[:length])
        assert outcome(path) == ("FILE_NOT_RECOGNISED" if length < 4 else "TRIASSET_ZIP_TRUNCATED")


def test_every_prefix_of_every_file_of_a_folder_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.triasset"
    good = parts(decoder())
    good.write_folder(path)
    for name, data in {"manifest.json": good.text(), **good.files}.items():
        whole = len(data) - 1 if name == "manifest.json" else len(data)  # without its last line break
        for length in reversed(range(len(data))):
            os.truncate(path / name, length)
            code = outcome(path)
            if length >= whole:
                assert code == ""
            elif name == "manifest.json":
                assert code == ("TRIASSET_MANIFEST_SYNTAX" if length else "TRIASSET_MANIFEST_EMPTY")
            else:
                assert code == "TRIASSET_BUFFER_TRUNCATED"
        put(path / name, data)


# --- the mutations themselves --------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["mesh", "soup"])
def test_mutated_packed_assets_are_refused_or_sound(name: str, in_memory) -> None:
    rng = random.Random(f"bytes of {name}")
    data = forge(parts(MAKERS[name]()).entries())
    codes = [outcome(mutate_bytes(data, rng)) for _ in range(BYTE_MUTATIONS)]
    # Changed values and unknown keys are for `validate`; most else is seen at once.
    assert 0.5 < sum(map(bool, codes)) / len(codes) < 1
    assert len(set(codes)) > 12


@pytest.mark.parametrize("name", MAKERS)
def test_mutated_manifests_are_refused_or_sound(name: str, in_memory) -> None:
    rng = random.Random(f"tokens of {name}")
    good = parts(MAKERS[name]())
    text = good.text()
    codes = [outcome(forge(good.entries(mutate_text(text, rng)))) for _ in range(TOKEN_MUTATIONS)]
    assert 0.5 < sum(map(bool, codes)) / len(codes) < 1
    assert len(set(codes)) > 20


def test_mutated_files_of_a_folder_are_refused_or_sound(tmp_path: Path) -> None:
    rng = random.Random("folder")
    path = tmp_path / "a.triasset"
    good = parts(decoder())
    good.write_folder(path)
    files = {"manifest.json": good.text(), **good.files}
    codes = set()
    for _ in range(FOLDER_MUTATIONS):
        name = rng.choice(["manifest.json", *files])
        mutate = mutate_text if name == "manifest.json" and rng.random() < 0.5 else mutate_bytes
        put(path / name, mutate(files[name], rng))
        codes.add(outcome(path))
        put(path / name, files[name])
    assert len(codes) > 15
    assert outcome(path) == ""


def test_mutated_packed_files_are_refused_or_sound(tmp_path: Path) -> None:
    rng = random.Random("file")
    path = tmp_path / "a.triasset"
    data = forge(parts(soup()).entries())
    codes = set()
    for _ in range(FILE_MUTATIONS):
        put(path, mutate_bytes(data, rng))
        codes.add(outcome(path))
    assert {"", "TRIASSET_ZIP_FOREIGN_DATA", "TRIASSET_ZIP_TRUNCATED"} <= codes

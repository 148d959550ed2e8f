"""The strict JSON reader rejects documents that different readers could interpret differently."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msb.asset.strict_json import MAX_BYTES, parse_strict_json
from msb.errors import AssetError

TEXTS = st.text(st.characters(codec="utf-8"))
LEAVES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(10**20) + 1, 10**20 - 1),
    st.floats(allow_nan=False, allow_infinity=False),
    TEXTS,
)
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=4),
    max_leaves=12,
)


def parse(data: bytes) -> Any:
    return parse_strict_json(data, file="a.triasset")


def assert_refused(data: bytes) -> None:
    with pytest.raises(AssetError, match="TRIASSET_MANIFEST"):
        parse(data)


@given(VALUES, st.booleans())
def test_valid_json_is_parsed(value: Any, ascii_only: bool) -> None:
    text = json.dumps(value, ensure_ascii=ascii_only).encode()
    assert parse(text) == value


@given(st.binary(max_size=200) | st.text('[]{}",:\\u0de1-.truefalsn \n', max_size=60).map(str.encode))
def test_any_bytes_give_the_result_of_json_or_an_error(data: bytes) -> None:
    try:
        value = parse(data)
    except AssetError:
        return
    assert value == json.loads(data)


def test_limits_are_inclusive() -> None:
    assert parse(b"[" * 16 + b"]" * 16) == json.loads("[" * 16 + "]" * 16)
    assert parse(b"9" * 20) == 10**20 - 1
    assert parse(b"-" + b"9" * 20) == 1 - 10**20
    assert parse(b"0".rjust(MAX_BYTES)) == 0


def test_brackets_in_strings_do_not_nest() -> None:
    assert parse(b'["' + b"[{" * 1000 + b'", "\\"' + b"[" * 100 + b'"]') == ["[{" * 1000, '"' + "[" * 100]


def test_keys_are_compared_as_text_not_as_written() -> None:
    assert_refused(b'{"a": 1, "\\u0061": 2}')
    composed, decomposed = "\u00e9", "e\u0301"
    assert parse(json.dumps({composed: 1, decomposed: 2}).encode()) == {composed: 1, decomposed: 2}


def test_a_syntax_error_is_located_in_bytes() -> None:
    with pytest.raises(AssetError, match="line 2, column 6") as caught:
        parse('{"é":\n "é" x}'.encode())
    assert caught.value.pointer == "byte 13"


def test_surrogate_pairs_are_accepted_and_halves_rejected() -> None:
    assert parse(b'"\\ud83d\\ude00"') == "\U0001f600"
    for half in (rb'"\ud83d"', rb'"\ude00\ud83d"', rb'[{"\ud83d": 0}]', rb'{"x": ["\udfff"]}'):
        assert_refused(half)


@pytest.mark.slow
@pytest.mark.parametrize("part", [b'"\\', b'{"a":0,', b"[],", b"1"])
def test_parsing_a_megabyte_is_fast(part: bytes) -> None:
    assert_refused((part * MAX_BYTES)[:MAX_BYTES])

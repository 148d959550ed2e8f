"""Nesting is counted as the parsers nest, and never by recursion."""

from __future__ import annotations

import random
import tomllib
from typing import Any

import pytest

from msb.bounded_parsing import MAX_TOML_DEPTH, json_nesting, parse_toml


def depth(value: Any) -> int:
    if isinstance(value, dict):
        value = list(value.values())
    return 1 + max(map(depth, value), default=0) if isinstance(value, list) else 0


def any_string(draw: random.Random) -> str:
    """Return a valid TOML string with many brackets, quotes and backslashes in it."""
    while True:
        quotes = draw.choice(['"""', "'''", '"', "'"])
        text = quotes + "".join(draw.choice("[]{}\"'# ab\\") for _ in range(draw.randrange(9))) + quotes
        try:
            tomllib.loads(f"a = [{text}]")  # no comment at its end
        except ValueError:
            continue
        return text


def any_value(draw: random.Random, room: int) -> str:
    kind = draw.random() if room else 1.0
    if kind < 0.4:
        return f"[{', '.join(any_value(draw, room - 1) for _ in range(draw.randrange(1, 4)))}]"
    if kind < 0.6:
        return f"{{{', '.join(f'k{k} = {any_value(draw, room - 1)}' for k in range(draw.randrange(1, 3)))}}}"
    return any_string(draw)


def nested(text: str, levels: int) -> str:
    """Return a TOML array around `text` that is `levels` deep."""
    return f"a = {'[' * levels}{text}{']' * levels} # ["


def test_brackets_in_strings_and_comments_do_not_count() -> None:
    """The limit is met exactly whatever stands inside: the value's own depth and no bracket more."""
    draw = random.Random(0)
    for _ in range(300):
        value = any_value(draw, 4)
        inside = depth(tomllib.loads(f"a = {value}")["a"])
        good = nested(value, MAX_TOML_DEPTH - inside)
        assert parse_toml(good) == tomllib.loads(good)
        with pytest.raises(ValueError, match="nested too deeply"):
            parse_toml(nested(value, MAX_TOML_DEPTH - inside + 1))


@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 500_000, "a = " + "{b=" * 300_000, "a." * 500_000 + "a = 1", f"[{'a.' * 500_000}a]"],
    ids=["arrays", "tables", "dotted keys", "dotted heading"],
)
def test_no_depth_reaches_the_recursion_limit(text: str) -> None:
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_toml(text)


def test_dots_that_are_not_of_one_key() -> None:
    text = f"[{'a.' * 20}a]\n{'b.' * 9}b = [{'1.5, ' * 99}1.5] # {'.' * 99}\n'{'.' * 99}' = \"{'.' * 99}\"\n"
    assert parse_toml(text) == tomllib.loads(text)
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_toml(f"[{'a.' * 20}a]\n{'b.' * 20}b = 1")
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_toml("'a' . " * 40 + "a = 1")


def test_strings_without_an_end_are_only_bad_toml() -> None:
    for text in ('a = """[[[', "a = '''[[[", 'a = "[[[', "a = '[[[", 'a = """' + '\\"' * 400_000):
        with pytest.raises(ValueError, match=r"^(?!nested)"):
            parse_toml(text)


def test_json() -> None:
    assert json_nesting('{"a[[[\\"[": [1, {"b": "]]"}]}') == 3
    assert json_nesting('"[') == json_nesting("1") == 0

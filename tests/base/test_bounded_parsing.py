"""The nesting of JSON and TOML is counted without recursion, with the same result as in the parsers."""

import tomllib

import pytest

from msb.base.bounded_parsing import MAX_TOML_DEPTH, json_nesting, parse_toml


def nested(text: str, levels: int) -> str:
    """Return a TOML array around `text` that is `levels` deep."""
    return f"a = {'[' * levels}{text}{']' * levels} # ["


QUOTED = ['"[[\'\\""', "'[[\"'", "'''['['''", '"""["[\\""""']


@pytest.mark.parametrize("inside", ["[]", "{b = 1}", *QUOTED])
def test_brackets_in_strings_and_comments_do_not_count(inside: str) -> None:
    """The limit of the nesting is exact for all values: brackets in strings do not count."""
    most = MAX_TOML_DEPTH - (inside in ("[]", "{b = 1}"))
    assert parse_toml(nested(inside, most)) == tomllib.loads(nested(inside, most))
    with pytest.raises(ValueError, match="nested too deeply"):
        parse_toml(nested(inside, most + 1))


@pytest.mark.slow
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


def test_json() -> None:
    assert json_nesting('{"a[[[\\"[": [1, {"b": "]]"}]}') == 3
    assert json_nesting('"[') == json_nesting("1") == 0

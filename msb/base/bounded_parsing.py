"""Limit the nesting of JSON and TOML documents before a recursive parser reads them.

A parser that reaches Python's recursion limit can fail anywhere. If the parser fails inside a destructor,
Python prints the error on standard error. This module measures the nesting first, without recursion.
"""

import re
import tomllib
from typing import Any

# Maximum nesting of a TOML document. Our protocols have 3 levels. A pyproject.toml can have more, because it
# also has the tables of other tools.
MAX_TOML_DEPTH = 32
_TOO_DEEP = f"nested too deeply ({MAX_TOML_DEPTH} levels are allowed)"
# Matches a bracket or a string, even a string without an end. The possessive quantifier (++) needs no memory
# for backtracking, however long a string is.
_JSON_TOKEN = re.compile(r'"(?:[^"\\]++|\\.)*+"?|[\[{\]}]', re.DOTALL)
# The same for TOML. This pattern also matches comments, dots and the characters that end a key. The text of a
# multi-line string can end with two quotes, before the three closing quotes (TOML 1.0, section String).
_TOML_TOKEN = re.compile(
    r'"""(?:[^"\\]++|\\.|"{1,2}+(?!"))*+(?:"{3,5})?+'
    r"|'''(?:[^']++|'{1,2}+(?!'))*+(?:'{3,5})?+"
    r'|"(?:[^"\\\n]++|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+"
    r"|[\[{\]}.,=\n]",
    re.DOTALL,
)
# Character that ends a key -> number of levels that it adds to the nesting.
_STEPS = {"[": 1, "{": 1, "]": -1, "}": -1, ",": 0, "=": 0, "\n": 0}


def json_nesting(text: str) -> int:
    """Return the greatest nesting of brackets outside strings, or 0 if there are no brackets."""
    return _deepest(_JSON_TOKEN, text)


def parse_toml(text: str) -> dict[str, Any]:
    """Return the TOML document `text`."""
    if _deepest(_TOML_TOKEN, text) > MAX_TOML_DEPTH:
        raise ValueError(_TOO_DEEP)
    document = tomllib.loads(text)
    level: list[Any] = [document]
    # A dotted key below a dotted heading nests deeper than each of them. Count the levels of the result.
    for _ in range(MAX_TOML_DEPTH + 1):
        level = [inner for outer in level for inner in _children(outer)]
    if level:
        raise ValueError(_TOO_DEEP)
    return document


def _children(value: dict[str, Any] | list[Any]) -> list[Any]:
    inside = value.values() if isinstance(value, dict) else value
    return [child for child in inside if isinstance(child, dict | list)]


def _deepest(token: re.Pattern[str], text: str) -> int:
    """Return the deepest nesting of brackets or the largest number of dots in a key, whichever is larger.

    Dots count because the TOML library needs time quadratic in their number.
    """
    depth = dots = deepest = 0
    for match in token.finditer(text):
        mark = match[0]
        if mark == ".":
            dots += 1
        elif mark in _STEPS:
            dots = 0
            depth += _STEPS[mark]
        deepest = max(deepest, depth, dots)
    return deepest

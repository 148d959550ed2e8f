"""Limit the nesting of JSON and TOML documents before a recursive parser reads them.

A parser that reaches Python's recursion limit can fail anywhere. If the parser fails inside a destructor,
Python prints the error on standard error. This module first measures the nesting without recursion.
"""

import re
import tomllib
from typing import Any

# Maximum nesting of a TOML document. Our protocol files have 3 levels. A pyproject.toml can have more
# levels, because it also has tables of other tools.
MAX_TOML_DEPTH = 32
_TOO_DEEP = f"nested too deeply ({MAX_TOML_DEPTH} levels are allowed)"
# Matches a bracket or a string. The end of a string may be missing. The possessive quantifier (++) needs no
# backtracking memory, even for a long string.
_JSON_TOKEN = re.compile(r'"(?:[^"\\]++|\\.)*+"?|[\[{\]}]', re.DOTALL)
# Matches the tokens of TOML that determine nesting. The TOML pattern also matches comments, dots, and the
# characters that end a key. The text of a multi-line string can end with two quotes, before the three closing
# quotes (TOML 1.0, section String).
_TOML_TOKEN = re.compile(
    r'"""(?:[^"\\]++|\\.|"{1,2}+(?!"))*+(?:"{3,5})?+'
    r"|'''(?:[^']++|'{1,2}+(?!'))*+(?:'{3,5})?+"
    r'|"(?:[^"\\\n]++|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+"
    r"|[\[{\]}.,=\n]",
    re.DOTALL,
)
# Change of the nesting level at each character that ends a key.
_STEPS = {"[": 1, "{": 1, "]": -1, "}": -1, ",": 0, "=": 0, "\n": 0}


def json_nesting(text: str) -> int:
    """Return the maximum nesting of brackets outside strings, or 0 without brackets."""
    return _deepest(_JSON_TOKEN, text)


def parse_toml(text: str) -> dict[str, Any]:
    """Return the parsed TOML document `text`."""
    if _deepest(_TOML_TOKEN, text) > MAX_TOML_DEPTH:
        raise ValueError(_TOO_DEEP)
    document = tomllib.loads(text)
    level: list[Any] = [document]
    # Dotted headings and dotted keys add levels, so measure the nesting of the parsed document.
    for _ in range(MAX_TOML_DEPTH + 1):
        level = [inner for outer in level for inner in _children(outer)]
    if level:
        raise ValueError(_TOO_DEEP)
    return document


def _children(value: dict[str, Any] | list[Any]) -> list[Any]:
    inside = value.values() if isinstance(value, dict) else value
    return [child for child in inside if isinstance(child, dict | list)]


def _deepest(token: re.Pattern[str], text: str) -> int:
    """Return the larger of two numbers: the nesting depth of brackets, and the number of dots in a key.

    The number of dots is limited, because the TOML library takes quadratic time for dotted keys.
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

"""How deep a document nests, known before a recursive parser reads it.

A parser can run into Python's recursion limit at any place, also inside code that the garbage collector
happens to run, whose errors are printed on standard error. So nesting is bounded beforehand.
"""

import re
import tomllib
from typing import Any

# Protocols nest 3 deep and settings 2; a pyproject.toml holds other tools' tables too.
MAX_TOML_DEPTH = 32
_TOO_DEEP = f"nested too deeply ({MAX_TOML_DEPTH} levels are allowed)"
# A string may have no end. Its quantifier is possessive, so that a string of any length takes no memory.
_JSON_TOKEN = re.compile(r'"(?:[^"\\]++|\\.)*+"?|[\[{\]}]', re.DOTALL)
# Strings of several lines end with three quotes, before which two more may stand (TOML 1.0, String).
_TOML_TOKEN = re.compile(
    r'"""(?:[^"\\]++|\\.|"{1,2}+(?!"))*+(?:"{3,5})?+'
    r"|'''(?:[^']++|'{1,2}+(?!'))*+(?:'{3,5})?+"
    r'|"(?:[^"\\\n]++|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+"
    r"|[\[{\]}.,=\n]",
    re.DOTALL,
)
# What ends a key -> by how much nesting grows there.
_STEPS = {"[": 1, "{": 1, "]": -1, "}": -1, ",": 0, "=": 0, "\n": 0}


def json_nesting(text: str) -> int:
    """Return the greatest nesting of brackets outside strings (0 if there are none)."""
    return _deepest(_JSON_TOKEN, text)


def parse_toml(text: str) -> dict[str, Any]:
    """Return the TOML document `text`."""
    if _deepest(_TOML_TOKEN, text) > MAX_TOML_DEPTH:
        raise ValueError(_TOO_DEEP)
    document = tomllib.loads(text)
    level: list[Any] = [document]
    for _ in range(MAX_TOML_DEPTH + 1):  # a dotted key below a dotted heading
        level = [inner for outer in level for inner in _children(outer)]
    if level:
        raise ValueError(_TOO_DEEP)
    return document


def _children(value: dict[str, Any] | list[Any]) -> list[Any]:
    inside = value.values() if isinstance(value, dict) else value
    return [one for one in inside if isinstance(one, dict | list)]


def _deepest(token: re.Pattern[str], text: str) -> int:
    """Return the greatest nesting of brackets or, if that is more, the most dots of one key.

    Of dots, because the time of the TOML library goes with their square.
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

"""The text of shaders: files with their includes and conditions resolved, because WGSL has neither."""

import re
from collections.abc import Iterable, Mapping
from importlib import resources

_OWN = "msb.engines.hardware"
_INCLUDE = re.compile(r'#include "([A-Za-z0-9_]+\.wgsl)"')
_CONDITION = re.compile(r"#if (!?)([A-Z_]+)")
_FACE = re.compile(r"struct Face \{\n(.*?)\n\}", re.DOTALL)


def assemble(files: Iterable[str], package: str, defines: Mapping[str, bool | int | str]) -> str:
    """Return the texts of `files`, one after the other.

    ``#include "x.wgsl"`` is replaced by that file, the first time; a file is looked for in `package`, then
    here. ``#if NAME``, ``#if !NAME``, ``#else`` and ``#endif`` keep or drop lines; a name that is not
    defined is false. Numbers become constants of type u32, and texts replace their names.
    """
    numbers = {k: v for k, v in defines.items() if isinstance(v, int) and not isinstance(v, bool)}
    lines = [f"const {name} = {value}u;" for name, value in sorted(numbers.items())]
    seen: set[str] = set()
    for file in files:
        lines += _resolved(file, package, {k for k, v in defines.items() if v is True}, seen)
    text = "\n".join(lines) + "\n"
    for name, value in defines.items():
        if isinstance(value, str):
            text = re.sub(rf"\b{name}\b", lambda _, value=value: value, text)  # type: ignore[misc]
    return text


def _resolved(file: str, package: str, defined: set[str], seen: set[str]) -> list[str]:
    if file in seen:
        return []
    seen.add(file)
    places = [resources.files(place) / file for place in (package, _OWN)]
    text = next(place for place in places if place.is_file()).read_text("utf-8")
    lines: list[str] = []
    kept = [True]
    for line in text.splitlines():
        condition, include = _CONDITION.fullmatch(line), _INCLUDE.fullmatch(line)
        if condition:
            kept.append(kept[-1] and ((condition[2] in defined) is not bool(condition[1])))
        elif line == "#else":
            kept[-1] = kept[-2] and not kept[-1]
        elif line == "#endif":
            kept.pop()
        elif kept[-1]:
            lines += _resolved(include[1], package, defined, seen) if include else [line]
    return lines


def face_members(text: str) -> list[str]:
    """Return the names of the members of `struct Face`, all of them vec4<f32>, in an assembled text."""
    match = _FACE.search(text)
    if match is None:
        raise ValueError("a method's WGSL defines no struct Face")
    return re.findall(r"^ *(\w+): vec4<f32>,", match[1], re.MULTILINE)


def as_attributes(text: str, members: list[str]) -> str:
    """Return `text` with the members of `struct Face` numbered as vertex attributes."""

    def numbered(match: re.Match[str]) -> str:
        body = match[0]
        for location, name in enumerate(members):
            body = body.replace(f"    {name}:", f"    @location({location}) {name}:")
        return body

    return _FACE.sub(numbered, text)

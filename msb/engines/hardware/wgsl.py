"""A preprocessor for shaders, because WGSL has neither includes nor conditions."""

import re
from collections.abc import Iterable, Mapping
from importlib import resources

_SHARED = "msb.engines.hardware"
_INCLUDE = re.compile(r'#include "([A-Za-z0-9_]+\.wgsl)"')
_CONDITION = re.compile(r"#if (!?)([A-Z_]+)")
_FACE = re.compile(r"struct Face \{\n(.*?)\n\}", re.DOTALL)


def assemble(files: Iterable[str], package: str, defines: Mapping[str, bool | int | str]) -> str:
    """Return the concatenated, preprocessed texts of `files`.

    ``#include "x.wgsl"`` inserts a file at its first occurrence. The file is searched in `package`, then in
    this package. ``#if NAME``, ``#if !NAME``, ``#else`` and ``#endif`` select lines; undefined names are
    false. An integer definition becomes a constant of type u32. A string definition replaces its name in the
    text.
    """
    numbers = {k: v for k, v in defines.items() if isinstance(v, int) and not isinstance(v, bool)}
    lines = [f"const {name} = {value}u;" for name, value in sorted(numbers.items())]
    included: set[str] = set()
    for file in files:
        lines += _resolve(file, package, {k for k, v in defines.items() if v is True}, included)
    text = "\n".join(lines) + "\n"
    for name, value in defines.items():
        if isinstance(value, str):
            text = re.sub(rf"\b{name}\b", lambda _, value=value: value, text)  # type: ignore[misc]
    return text


def _resolve(file: str, package: str, defined: set[str], included: set[str]) -> list[str]:
    """Return the selected lines of a file and its includes. Files in the set `included` are skipped."""
    if file in included:
        return []
    included.add(file)
    places = [resources.files(place) / file for place in (package, _SHARED)]
    text = next(place for place in places if place.is_file()).read_text("utf-8")
    lines: list[str] = []
    active = [True]  # whether the lines of each nested condition are active
    for line in text.splitlines():
        condition, include = _CONDITION.fullmatch(line), _INCLUDE.fullmatch(line)
        if condition:
            active.append(active[-1] and ((condition[2] in defined) is not bool(condition[1])))
        elif line == "#else":
            active[-1] = active[-2] and not active[-1]
        elif line == "#endif":
            active.pop()
        elif active[-1]:
            lines += _resolve(include[1], package, defined, included) if include else [line]
    return lines


def find_face_members(text: str) -> list[str]:
    """Return the names of the members of `struct Face` in a preprocessed text; all are vec4<f32>."""
    match = _FACE.search(text)
    if match is None:
        raise ValueError("the WGSL of a method must define a struct Face")
    return re.findall(r"^ *(\w+): vec4<f32>,", match[1], re.MULTILINE)


def add_attribute_locations(text: str, members: list[str]) -> str:
    """Return `text` with the members of `struct Face` as vertex attributes at locations 0, 1, ..."""

    def add_locations(match: re.Match[str]) -> str:
        body = match[0]
        for location, name in enumerate(members):
            body = body.replace(f"    {name}:", f"    @location({location}) {name}:")
        return body

    return _FACE.sub(add_locations, text)

"""Source text of kernels. Python code resolves includes, so that kernels of a package in a ZIP file work."""

import functools
import hashlib
import re
from collections.abc import Mapping
from importlib import resources

import numpy as np

Define = int | float | bool | str
# The package of the shared kernel files, which kernels of all packages may include.
OWN = "msb.cl.kernels"

_INCLUDE = re.compile(r'^[ \t]*#[ \t]*include[ \t]+"(?P<name>[A-Za-z0-9_]+\.cl)"[ \t]*(?://.*)?$')
_LINE = re.compile(r'^#line (?P<line>\d+) "(?P<name>[^"]+)"$')
_ANY_INCLUDE = re.compile(r"^[ \t]*#[ \t]*include\b")
_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\([A-Za-z0-9_, ]*\))?")


def write_defines(defines: Mapping[str, Define]) -> str:
    """Return ``#define`` lines for `defines`, sorted by name.

    Boolean values become 1 and 0. Floats are rounded to single precision and written as exact hexadecimal
    constants. Strings are inserted unchanged. Defines are written into the
    source, because build options would need quoting.

    >>> print(write_defines({"WIDTH": 8, "FAST": True, "SCALE": 0.1}), end="")
    #define FAST 1
    #define SCALE 0x1.99999a0000000p-4f
    #define WIDTH 8
    """
    lines = []
    for name, value in sorted(defines.items()):
        if not _NAME.fullmatch(name) or (isinstance(value, str) and "\n" in value):
            raise ValueError(f"invalid macro of a kernel: {name} = {value!r}")
        lines.append(f"#define {name} {_format_literal(value)}\n")
    return "".join(lines)


def _format_literal(value: Define) -> str:
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, float):
        if not np.isfinite(value):
            raise ValueError(f"{value} cannot be written as a constant of a kernel")
        return f"{float(np.float32(value)).hex()}f"
    return str(value)


@functools.cache
def kernels_hash(packages: tuple[str, ...]) -> str:
    """Return the SHA-256 hash of all kernel files in `OWN` and `packages`, from their names and texts.

    Files are sorted by name.
    """
    digest = hashlib.sha256()
    folders = dict.fromkeys((OWN, *packages))
    files = [
        file for folder in folders for file in resources.files(folder).iterdir() if file.name.endswith(".cl")
    ]
    for file in sorted(files, key=lambda file: file.name):
        digest.update(f"{file.name}\0".encode() + file.read_bytes().replace(b"\r\n", b"\n") + b"\0")
    return digest.hexdigest()


@functools.cache
def resolve(package: str, name: str) -> str:
    """Return the text of file `name` of `package`. Every line ``#include "other.cl"`` is replaced by the
    text of that file.

    Files are searched in `package`, then in `OWN`. As in C, a file that is included twice appears twice in
    the text. ``#line`` directives make compilers report our file names and line numbers.
    """
    return _resolve(package, name, ())


def place_of(text: str, number: int) -> tuple[str, int] | None:
    """Return the original file name and line number for line `number` of a resolved text.

    Lines count from 1.
    """
    source = None
    for line in text.splitlines()[:number]:
        directive = _LINE.match(line)
        if directive:
            source = directive["name"], int(directive["line"]) - 1
        elif source:
            source = source[0], source[1] + 1
    return source


def _resolve(package: str, name: str, inside: tuple[str, ...]) -> str:
    if name in inside:
        raise ValueError(f"{name} includes itself through {', '.join(inside)}")
    lines = [f'#line 1 "{name}"']
    for number, line in enumerate(_read(package, name).splitlines(), 1):
        include = _INCLUDE.match(line)
        if include:
            lines.append(_resolve(package, include["name"], (*inside, name)).rstrip("\n"))
            lines.append(f'#line {number + 1} "{name}"')
        elif _ANY_INCLUDE.match(line):
            raise ValueError(f'{name}: line {number}: unsupported directive; use #include "FILE.cl"')
        else:
            lines.append(line)
    return "\n".join(lines) + "\n"


def _read(package: str, name: str) -> str:
    for folder in dict.fromkeys((package, OWN)):
        file = resources.files(folder).joinpath(name)
        if file.is_file():
            return file.read_text("utf-8")
    raise FileNotFoundError(f"no kernel file {name} in {package}")

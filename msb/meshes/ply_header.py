"""The header of a PLY file."""

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

from msb.errors import shorten
from msb.meshes.source import Source

_NAMES = {
    "i1": "char int8",
    "u1": "uchar uint8",
    "i2": "short int16",
    "u2": "ushort uint16",
    "i4": "int int32",
    "u4": "uint uint32",
    "f4": "float float32",
    "f8": "double float64",
}
# Both styles of type names -> NumPy type without byte order.
TYPES = {name: kind for kind, names in _NAMES.items() for name in names.split()}

# Format names -> NumPy byte order; text has none.
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}

# Most bytes of a header. Real headers have some thousand; the limit bounds the work on one that never
# ends.
MAX_HEADER_BYTES = 1 << 20

_COUNT = re.compile(r"\d{1,18}")


@dataclass(frozen=True)
class Property:
    """A property: `type` is a value of `TYPES`; `count_type` too for a list, "" for a single number."""

    name: str
    type: str
    count_type: str = ""


@dataclass(frozen=True)
class Element:
    """An element: `count` rows, each with one value or list for every property, in order."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    def find(self, name: str) -> Property | None:
        """Return the property called `name`, if there is one."""
        return next((each for each in self.properties if each.name == name), None)

    def __str__(self) -> str:
        return f"element '{shorten(self.name)}'"


@dataclass(frozen=True)
class Header:
    """The content of the header; `body` is the byte after it and `order` a value of `FORMATS`."""

    order: str
    elements: list[Element]
    body: int


def read_header(source: Source) -> Header:
    """Read the lines from "ply" to "end_header"; names of elements and of their properties are unique.

    The line end after "ply", LF, CRLF or CR, is that of the whole header.
    """
    lines, body = _split_lines(source)
    order: str | None = None
    elements: list[Element] = []
    for number, line in enumerate(lines, start=2):
        where = f"line {number}"
        words = line.split()
        match words:
            case [] | ["comment", *_] | ["obj_info", *_]:
                pass
            case ["format", name, version] if order is None and not elements:
                order = _read_format(source, where, name, version)
            case ["element", name, count]:
                elements.append(_read_element(source, where, name, count))
            case ["property", *rest] if elements:
                elements[-1].properties.append(_read_property(source, where, rest))
            case _:
                text = f"'{shorten(line)}' is not a header line, or stands in the wrong place"
                raise source.error("MESH_FILE_INVALID", text, pointer=where)
    if order is None:
        text = "the header has no line 'format ascii 1.0' or 'format binary_little_endian 1.0'"
        raise source.error("MESH_FILE_INVALID", text)
    for twice in _repeated(each.name for each in elements):
        raise source.error("MESH_FILE_INVALID", f"{Element(twice, 0)} is declared twice")
    for element in elements:
        for twice in _repeated(each.name for each in element.properties):
            text = f"property '{shorten(twice)}' of {element} is declared twice"
            raise source.error("MESH_FILE_INVALID", text)
    return Header(order, elements, body)


def _split_lines(source: Source) -> tuple[list[str], int]:
    """Return the lines between "ply" and "end_header", and the byte after the latter's line end."""
    data = source.data
    if not data.startswith((b"ply\n", b"ply\r")):
        raise source.not_a("PLY", "it does not begin with a line 'ply'")
    line_end = b"\r\n" if data.startswith(b"ply\r\n") else data[3:4]
    last = re.compile(line_end + rb"[ \t]*end_header[ \t\r]*?" + line_end)
    head = data[: MAX_HEADER_BYTES + 1]
    end = last.search(head)
    if end is None and len(data) > MAX_HEADER_BYTES:
        text = f"'end_header' does not come within {MAX_HEADER_BYTES} bytes"
        raise source.error("MESH_FILE_TOO_LARGE", text)
    if end is None:
        raise source.error("MESH_FILE_TRUNCATED", "the file ends before 'end_header'")
    text = head[3 : end.start()].decode("latin-1")
    return text.split(line_end.decode())[1:], end.end()


def _read_format(source: Source, where: str, name: str, version: str) -> str:
    if name not in FORMATS:
        text = f"format '{shorten(name)}' is unknown; {', '.join(FORMATS)} are read"
        raise source.error("MESH_FILE_INVALID", text, pointer=where)
    if version != "1.0":
        text = f"version '{shorten(version)}' is not read; only 1.0 exists"
        raise source.error("MESH_FILE_UNSUPPORTED", text, pointer=where)
    return FORMATS[name]


def _read_element(source: Source, where: str, name: str, count: str) -> Element:
    if not _COUNT.fullmatch(count):
        text = f"element '{shorten(name)}' has the count '{shorten(count)}', not a whole number"
        raise source.error("MESH_FILE_INVALID", text, pointer=where)
    return Element(name, int(count))


def _read_property(source: Source, where: str, words: list[str]) -> Property:
    """Return the property that `words`, those after "property", declare."""
    match words:
        case ["list", count_type, kind, name]:
            names = [count_type, kind]
        case [kind, name]:
            names = [kind]
        case _:
            text = "'property TYPE NAME' or 'property list TYPE TYPE NAME' is right"
            raise source.error("MESH_FILE_INVALID", text, pointer=where)
    for each in names:
        if each not in TYPES:
            text = f"'{shorten(each)}' is not a type; {', '.join(TYPES)} are"
            raise source.error("MESH_FILE_INVALID", text, pointer=where)
    if len(names) == 2 and TYPES[names[0]].startswith("f"):
        text = f"the count of list '{shorten(name)}' is {names[0]}; an integer type is right"
        raise source.error("MESH_FILE_INVALID", text, pointer=where)
    return Property(name, TYPES[names[-1]], TYPES[names[0]] if len(names) == 2 else "")


def _repeated(names: Iterable[str]) -> list[str]:
    """Return the names that stand there more than once."""
    return [name for name, count in Counter(names).items() if count > 1]

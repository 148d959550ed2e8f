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
# Maps type names of both styles ("uchar" and "uint8") to NumPy types without byte order.
TYPES = {name: kind for kind, names in _NAMES.items() for name in names.split()}

# Maps PLY formats to NumPy byte orders. Text has none.
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}

# Largest header in bytes. Usual headers have a few thousand bytes. The size limit ends the search if
# "end_header" is missing.
MAX_HEADER_BYTES = 1 << 20

_COUNT = re.compile(r"\d{1,18}")


@dataclass(frozen=True)
class Property:
    """A property.

    The field `type` is a value of `TYPES`. The field `count_type` is a value of `TYPES` for a list, and an
    empty text for a scalar.
    """

    name: str
    type: str
    count_type: str = ""


@dataclass(frozen=True)
class Element:
    """An element: `count` rows with one number or list for each property, in order."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    def find(self, name: str) -> Property | None:
        """Return the property called `name`, or None."""
        return next((entry for entry in self.properties if entry.name == name), None)

    def __str__(self) -> str:
        return f"element '{shorten(self.name)}'"


@dataclass(frozen=True)
class Header:
    """The parsed header.

    The field `order` is a value of `FORMATS`. The field `body` is the offset of the body in the file, in
    bytes. The field `images` has the names of texture images in comments. The field `comments` has all other
    comments.
    """

    order: str
    elements: list[Element]
    body: int
    images: tuple[str, ...] = ()
    comments: tuple[str, ...] = ()


def read_header(source: Source) -> Header:
    """Read the lines from "ply" to "end_header".

    All lines must end like the first line, with LF, CRLF or CR. Names of elements, and of the properties of
    an element, must be unique.
    """
    lines, body = _split_lines(source)
    order: str | None = None
    elements: list[Element] = []
    images: list[str] = []
    comments: list[str] = []
    for number, line in enumerate(lines, start=2):
        where = f"line {number}"
        words = line.split()
        match words:
            case ["comment", "TextureFile", _, *_]:
                images.append(line.split("TextureFile", 1)[1].strip())
            case ["comment", *rest]:
                comments.append(" ".join(rest))
            case [] | ["obj_info", *_]:
                pass
            case ["format", name, version] if order is None and not elements:
                order = _read_format(source, where, name, version)
            case ["element", name, count]:
                elements.append(_read_element(source, where, name, count))
            case ["property", *rest] if elements:
                elements[-1].properties.append(_read_property(source, where, rest))
            case _:
                text = f"'{shorten(line)}' is not a header line, or is at a wrong place"
                raise source.error("MESH_FILE_INVALID", text, pointer=where)
    if order is None:
        text = "the header has no line 'format ascii 1.0' or 'format binary_little_endian 1.0'"
        raise source.error("MESH_FILE_INVALID", text)
    for twice in _find_repeated(element.name for element in elements):
        raise source.error("MESH_FILE_INVALID", f"{Element(twice, 0)} is declared twice")
    for element in elements:
        for twice in _find_repeated(entry.name for entry in element.properties):
            text = f"property '{shorten(twice)}' of {element} is declared twice"
            raise source.error("MESH_FILE_INVALID", text)
    return Header(order, elements, body, tuple(images), tuple(comments))


def _split_lines(source: Source) -> tuple[list[str], int]:
    """Return the lines between "ply" and "end_header", and the offset of the first byte after them."""
    data = source.data
    if not data.startswith((b"ply\n", b"ply\r")):
        raise source.not_a("PLY", "the first line is not 'ply'")
    line_end = b"\r\n" if data.startswith(b"ply\r\n") else data[3:4]
    last = re.compile(line_end + rb"[ \t]*end_header[ \t\r]*?" + line_end)
    head = data[: MAX_HEADER_BYTES + 1]
    end = last.search(head)
    if end is None and len(data) > MAX_HEADER_BYTES:
        text = f"there is no 'end_header' within the first {MAX_HEADER_BYTES} bytes"
        raise source.error("MESH_FILE_TOO_LARGE", text)
    if end is None:
        raise source.error("MESH_FILE_TRUNCATED", "the file ends before 'end_header'")
    text = head[3 : end.start()].decode("latin-1")
    return text.split(line_end.decode())[1:], end.end()


def _read_format(source: Source, where: str, name: str, version: str) -> str:
    """Return the byte order of the format `name`."""
    if name not in FORMATS:
        text = f"format '{shorten(name)}' is unknown; it must be one of {', '.join(FORMATS)}"
        raise source.error("MESH_FILE_INVALID", text, pointer=where)
    if version != "1.0":
        text = f"version '{shorten(version)}' is not supported; only 1.0 exists"
        raise source.error("MESH_FILE_UNSUPPORTED", text, pointer=where)
    return FORMATS[name]


def _read_element(source: Source, where: str, name: str, count: str) -> Element:
    """Return the element that a line "element NAME COUNT" declares."""
    if not _COUNT.fullmatch(count):
        text = f"element '{shorten(name)}' has the count '{shorten(count)}'; it must be a whole number"
        raise source.error("MESH_FILE_INVALID", text, pointer=where)
    return Element(name, int(count))


def _read_property(source: Source, where: str, words: list[str]) -> Property:
    """Return the property that a header line declares.

    The argument `words` has the words after "property".
    """
    match words:
        case ["list", count_type, kind, name]:
            names = [count_type, kind]
        case [kind, name]:
            names = [kind]
        case _:
            text = "the line must be 'property TYPE NAME' or 'property list TYPE TYPE NAME'"
            raise source.error("MESH_FILE_INVALID", text, pointer=where)
    for type_name in names:
        if type_name not in TYPES:
            text = f"'{shorten(type_name)}' is not a type; it must be one of {', '.join(TYPES)}"
            raise source.error("MESH_FILE_INVALID", text, pointer=where)
    if len(names) == 2 and TYPES[names[0]].startswith("f"):
        text = f"the count of list '{shorten(name)}' has type {names[0]}; it must be an integer type"
        raise source.error("MESH_FILE_INVALID", text, pointer=where)
    return Property(name, TYPES[names[-1]], TYPES[names[0]] if len(names) == 2 else "")


def _find_repeated(names: Iterable[str]) -> list[str]:
    """Return the names that occur more than once."""
    return [name for name, count in Counter(names).items() if count > 1]

"""A mesh file's bytes in memory, and how errors about them are worded."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from msb.errors import MeshFileError

_SIGNATURES = {
    "PLY": re.compile(rb"ply[\r\n]"),
    "GLB": re.compile(rb"glTF"),
    "OFF": re.compile(rb"\s*+(ST|[CN4n]){0,5}OFF"),
    "STL": re.compile(rb"\s*+solid\b", re.IGNORECASE),
}
"""How a file of each format begins. OBJ and binary STL have no signature."""

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


@dataclass(frozen=True)
class Source:
    """A mesh file, read whole.

    Parameters
    ----------
    path : str
        Only for messages: nothing is opened through it.
    data : bytes
        The file's content.
    lines : bytes, optional
        What to count line ends in, where that is not `data`; of the same length.
    """

    path: str
    data: bytes
    lines: bytes | None = None

    def error(
        self, code: str, message: str, *, pointer: str | None = None, value: Any = None, limit: Any = None
    ) -> MeshFileError:
        """Return the error about this file; a `pointer` opens the message."""
        text = message if pointer is None else f"{pointer}: {message}"
        return MeshFileError(code, text, file=self.path, pointer=pointer, value=value, limit=limit)

    def line_error(
        self, code: str, byte: int, message: str, *, value: Any = None, limit: Any = None
    ) -> MeshFileError:
        """Return the error about the line that holds byte number `byte`."""
        lines = self.data if self.lines is None else self.lines
        line = lines.count(b"\n", 0, byte) + 1
        return self.error(code, message, pointer=f"line {line}", value=value, limit=limit)

    def looks_like(self) -> str | None:
        """Return the format whose signature the file begins with, or None."""
        matches = (name for name, signature in _SIGNATURES.items() if signature.match(self.data))
        return next(matches, None)

    def not_a(self, name: str, why: str) -> MeshFileError:
        """Return the error that the file is not of format `name`: it begins like another, or `why`."""
        other = self.looks_like()
        if other not in (None, name):
            why = f"the content begins like {other}; rename the file to .{str(other).lower()}"
        return self.error("MESH_FILE_HEADER", f"this is not {name}: {why}")

    def as_text(self, name: str) -> Source:
        """Return the file, text of format `name`, with line feeds for line ends and no byte order mark.

        Every byte keeps its place, so byte and line numbers in messages stay those of the file.

        Raises
        ------
        MeshFileError
            MESH_FILE_HEADER: it begins like another format, or holds a NUL byte, which no text does.
        """
        data = self.data
        at = data.find(b"\0")
        if at >= 0 or self.looks_like() not in (None, name):
            raise self.not_a(name, f"byte {at} is NUL, which no text holds")
        if data.startswith(_BYTE_ORDER_MARK):
            data = data.replace(_BYTE_ORDER_MARK, b" " * len(_BYTE_ORDER_MARK), 1)
        if b"\n" not in data:
            data = data.replace(b"\r", b"\n")
        return Source(self.path, data)

"""A mesh file's bytes in memory, and how errors about them are worded."""

from __future__ import annotations

from dataclasses import dataclass, replace

from msb.errors import MeshFileError
from msb.meshes.formats import FORMATS, Format

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_LINE_FEED = b"\n"


@dataclass(frozen=True)
class Source:
    """A mesh file, read whole.

    Parameters
    ----------
    path : str
        For messages, and for the folder in which files that it names are looked for (`msb.meshes.beside`).
    data : bytes
        The file's content.
    lines : bytes, optional
        The text in which line ends are counted, if that is not `data`; it has the same length.
    images : bool
        Whether images of textures are decoded; without, textures are not asked for.
    """

    path: str
    data: bytes
    lines: bytes | None = None
    images: bool = True

    def error(self, code: str, message: str, *, pointer: str | None = None) -> MeshFileError:
        """Return the error about this file; a `pointer` opens the message."""
        text = message if pointer is None else f"{pointer}: {message}"
        return MeshFileError(code, text, file=self.path, pointer=pointer)

    def line_error(self, code: str, byte: int, message: str) -> MeshFileError:
        """Return the error about the line that holds byte number `byte`."""
        return self.error(code, message, pointer=self.line(byte))

    def line(self, byte: int) -> str:
        """Return "line N" for the line that holds byte number `byte`."""
        lines = self.data if self.lines is None else self.lines
        return f"line {lines.count(_LINE_FEED, 0, byte) + 1}"

    def wrong_index(self, byte: int, index: int, vertices: int, *, first: int = 0) -> str:
        """Return what `Mesh.wrong_face` says of the face in the line of byte number `byte`.

        `index`, which names no vertex, counts from 0; the file counts from `first`.
        """
        there = f"those of this file are {first} to {vertices - 1 + first}" if vertices else "there is none"
        return f"{self.line(byte)}: the face names vertex {index + first}; {there}"

    def looks_like(self) -> Format | None:
        """Return the format whose files begin so, or None."""
        formats = FORMATS.values()
        return next((each for each in formats if each.begins and each.begins.match(self.data)), None)

    def not_a(self, name: str, why: str) -> MeshFileError:
        """Return the error that the file is not of format `name`: it begins like another format, or `why`."""
        other = self.looks_like()
        if other is not None and other.title != name:
            why = f"the content begins like {other.title}; rename the file to {other.suffixes[0]}"
        return self.error("MESH_FILE_INVALID", f"this is not {name}: {why}")

    def as_text(self, name: str) -> Source:
        """Return the file, text of format `name`, with line feeds for line ends and no byte order mark.

        Every byte keeps its place, so byte and line numbers in messages stay those of the file.
        """
        data = self.data
        at = data.find(b"\0")
        other = self.looks_like()
        if at >= 0 or (other is not None and other.title != name):
            raise self.not_a(name, f"byte {at} is NUL, which no text holds")
        if data.startswith(_BYTE_ORDER_MARK):
            data = data.replace(_BYTE_ORDER_MARK, b" " * len(_BYTE_ORDER_MARK), 1)
        if b"\n" not in data:
            data = data.replace(b"\r", b"\n")
        return replace(self, data=data)

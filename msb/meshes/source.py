"""The bytes of a mesh file in memory, and errors about them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from msb.errors import MeshFileError
from msb.meshes.formats import FORMATS, Format

_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_LINE_FEED = b"\n"


@dataclass(frozen=True)
class Source:
    """The complete content of a mesh file.

    Parameters
    ----------
    path : str
        The path of the file. Linked files are searched in the same folder (`msb.meshes.linked_files`).
    data : bytes
        The content.
    lines : bytes, optional
        The original text for counting lines, if `data` is a modified copy of the text. The copy has the same
        length.
    images : bool
        Whether texture images are decoded.
    """

    path: str
    data: bytes
    lines: bytes | None = None
    images: bool = True

    def error(self, code: str, message: str, *, pointer: str | None = None) -> MeshFileError:
        """Return an error about this file.

        The message begins with `pointer`, the place of the error in the file.
        """
        text = message if pointer is None else f"{pointer}: {message}"
        return MeshFileError(code, text, file=self.path, pointer=pointer)

    def line_error(self, code: str, byte: int, message: str) -> MeshFileError:
        """Return an error about the line at byte offset `byte`."""
        return self.error(code, message, pointer=self.line(byte))

    def line(self, byte: int) -> str:
        """Return "line N" for the line at byte offset `byte`."""
        lines = self.data if self.lines is None else self.lines
        return f"line {lines.count(_LINE_FEED, 0, byte) + 1}"

    def wrong_index(self, byte: int, index: int, vertices: int, *, first: int = 0) -> str:
        """Return the text for `Mesh.wrong_face` for the face in the line at byte offset `byte`.

        The argument `index` is the invalid vertex index. Indices start at 0. In the file, vertices are
        counted from `first`.
        """
        valid = f"valid are {first} to {vertices - 1 + first}" if vertices else "the file has no vertices"
        return f"{self.line(byte)}: a face uses vertex {index + first}; {valid}"

    def looks_like(self) -> Format | None:
        """If the content begins with the signature of a format, return the format. Otherwise return None."""
        formats = FORMATS.values()
        return next((form for form in formats if form.begins and form.begins.match(self.data)), None)

    def not_a(self, name: str, why: str) -> MeshFileError:
        """Return the error for content that is not of format `name`.

        If the content looks like another format, the error names that format. If no format is recognised, the
        error message gives the reason `why`.
        """
        other = self.looks_like()
        if other is not None and other.title != name:
            why = f"the content looks like {other.title}; rename the file to {other.suffixes[0]}"
        return self.error("MESH_FILE_INVALID", f"the file is not in {name} format: {why}")

    def as_text(self, name: str) -> Source:
        """Return the file as text of the format `name`.

        Other line ends are replaced by LF, and a byte order mark by spaces. The length does not change, so
        byte and line numbers in messages are valid for the file.
        """
        data = self.data
        at = data.find(b"\0")
        other = self.looks_like()
        if at >= 0 or (other is not None and other.title != name):
            raise self.not_a(name, f"byte {at} is NUL, so it is not a text file")
        if data.startswith(_BYTE_ORDER_MARK):
            data = data.replace(_BYTE_ORDER_MARK, b" " * len(_BYTE_ORDER_MARK), 1)
        if b"\n" not in data:
            data = data.replace(b"\r", b"\n")
        return replace(self, data=data)

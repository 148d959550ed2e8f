"""Finds the rows of each element in the body of a PLY file, and reads a property of all rows at once.

Offsets count bytes in a binary body and numbers in a text body. The properties of a row follow each other
without gaps. The offset of a property is the sum of the row's offset and the widths of all preceding
properties. The offsets of a property are computed for all rows at once.
"""

import struct
from array import array
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from msb.errors import MeshFileError
from msb.meshes.ply_header import Element, Header, Property
from msb.meshes.polygons import concatenate_ranges
from msb.meshes.source import Source
from msb.meshes.text import Table, read_table


@dataclass(frozen=True)
class Rows:
    """The rows of `element`. The field `place` (N,) int64 is the offset of each row in the body."""

    element: Element
    place: NDArray[np.int64]


class Body(Protocol):
    """The common interface of binary and text bodies."""

    def _find(self, rows: Rows, name: str) -> tuple[Property, NDArray[np.int64]]:
        """Return property `name` and its offset (N,) in every row."""
        place = rows.place
        for entry in rows.element.properties:
            if entry.name == name:
                return entry, place
            place = self._after(place, entry)
        raise KeyError(name)

    def _after(self, place: NDArray[np.int64], wanted: Property) -> NDArray[np.int64]:
        """Return the offset (N,) after a property at offset `place` (N,).

        An invalid list length in a text body gives an offset beyond the table. `next_rows` then rejects the
        row.
        """

    def next_rows(self, element: Element) -> Rows:
        """Return the rows of the next element in the file."""

    def finish(self) -> None:
        """Raise MESH_FILE_INVALID if data follows after the last element."""

    def column(self, rows: Rows, name: str) -> NDArray[Any]:
        """Return the values (N,) of a scalar property. The values are float64 for text, and have the type in
        the file for binary data."""

    def indices(self, rows: Rows, name: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the lengths (N,) of a list property in all rows, and the concatenated integers (C,)."""

    def numbers(self, rows: Rows, name: str) -> tuple[NDArray[np.int64], NDArray[Any]]:
        """Return the lengths (N,) of a list property in all rows, and the concatenated numbers (C,)."""

    def wrong_face(self, rows: Rows, row: int, index: int, vertices: int) -> str | None:
        """Return the text for `Mesh.wrong_face` about a row with the invalid vertex `index`.

        The result is None for binary files, which have no line numbers.
        """
        return None


def open_body(source: Source, header: Header) -> Body:
    """Return the body that follows `header`."""
    if header.order:
        return _BinaryBody(source, header)
    return _TextBody(source, header)


class _BinaryBody(Body):
    """A binary body."""

    def __init__(self, source: Source, header: Header) -> None:
        self._source = source
        self._order = header.order
        self._at = header.body

    def next_rows(self, element: Element) -> Rows:
        start, room = self._at, len(self._source.data) - self._at
        least = sum(_width(entry.count_type or entry.type) for entry in element.properties)
        if element.count * least > room:
            text = f"{element} has {element.count} rows of at least {least} bytes, "
            text += f"but only {room} bytes are left in the file"
            raise self._source.error("MESH_FILE_TRUNCATED", text, pointer=f"byte {start}")
        if not element.count or not least:
            return Rows(element, np.zeros(0, dtype=np.int64))
        size = self._common_row_size(element)
        if size is not None:
            place = start + size * np.arange(element.count)
            self._at = start + size * element.count
        else:
            place = self._walk(element)
        return Rows(element, place)

    def finish(self) -> None:
        left = len(self._source.data) - self._at
        if self._source.data[self._at :].strip():
            text = f"{left} bytes follow after the last row"
            raise self._source.error("MESH_FILE_INVALID", text, pointer=f"byte {self._at}")

    def column(self, rows: Rows, name: str) -> NDArray[Any]:
        wanted, place = self._find(rows, name)
        return self._take(place, wanted.type)

    def indices(self, rows: Rows, name: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        counts, values = self.numbers(rows, name)
        return counts, values.astype(np.int64)

    def numbers(self, rows: Rows, name: str) -> tuple[NDArray[np.int64], NDArray[Any]]:
        wanted, place = self._find(rows, name)
        counts = self._take(place, wanted.count_type).astype(np.int64)
        place = place + _width(wanted.count_type)
        width = _width(wanted.type)
        if counts.size and (counts == counts[0]).all():
            corners = (place[:, None] + width * np.arange(counts[0])).ravel()
        else:
            corners = np.repeat(place, counts) + width * concatenate_ranges(counts)
        return counts, self._take(corners, wanted.type)

    def _after(self, place: NDArray[np.int64], wanted: Property) -> NDArray[np.int64]:
        if not wanted.count_type:
            return place + _width(wanted.type)
        counts = self._take(place, wanted.count_type).astype(np.int64)
        return place + _width(wanted.count_type) + counts * _width(wanted.type)

    def _take(self, place: NDArray[np.int64], kind: str) -> NDArray[Any]:
        """Return the values (N,) of type `kind` at the byte offsets `place` (N,), in native byte order."""
        width = _width(kind)
        data = self._source.data
        if not place.size:
            return np.zeros(0, dtype=kind)
        # Create a view with a value at every byte of the file, then select the values at `place`.
        overlapping = np.ndarray((len(data) - width + 1,), self._order + kind, data, strides=(1,))
        return overlapping[place].astype(kind)

    def _common_row_size(self, element: Element) -> int | None:
        """If all rows have equal list lengths, return the size of a row in bytes. Otherwise return None."""
        data, start, at = self._source.data, self._at, self._at
        # Measure the first row: the offset, the length and the count type of each list.
        lists: list[tuple[int, int, str]] = []
        for entry in element.properties:
            if not entry.count_type:
                at += _width(entry.type)
                continue
            if at + _width(entry.count_type) > len(data):
                return None
            length = int(self._take(np.array([at]), entry.count_type)[0])
            lists.append((at, length, entry.count_type))
            at += _width(entry.count_type) + max(length, 0) * _width(entry.type)
        size = at - start
        # Compare the list lengths of all rows, under the assumption that all rows have this size.
        if start + size * element.count > len(data):
            return None
        for place, length, kind in lists:
            lengths = np.ndarray((element.count,), self._order + kind, data, place, (size,))
            if length < 0 or (lengths != length).any():
                return None
        return size

    def _walk(self, element: Element) -> NDArray[np.int64]:
        """Return the byte offset of each row. The rows are visited one by one, because their sizes differ."""
        lists, tail = _describe_rows(element, self._order)
        data, at = self._source.data, self._at
        places = array("q")
        for row in range(element.count):
            places.append(at)
            for gap, count, width in lists:
                at += gap
                if at + count.size > len(data):
                    raise self._short(element, row)
                length = count.unpack_from(data, at)[0]
                if length < 0:
                    text = f"row {row} of {element} has a list of length {length}"
                    raise self._source.error("MESH_FILE_INVALID", text, pointer=f"byte {at}")
                at += count.size + length * width
            at += tail
            if at > len(data):
                raise self._short(element, row)
        self._at = at
        return np.array(places, dtype=np.int64)

    def _short(self, element: Element, row: int) -> MeshFileError:
        """Return the error for a file that ends within a row."""
        text = f"the file ends in row {row} of the {element.count} rows of {element}"
        return self._source.error("MESH_FILE_TRUNCATED", text)


class _TextBody(Body):
    """A text body: one row of numbers per line."""

    def __init__(self, source: Source, header: Header) -> None:
        self._source = source
        self._lines = 0
        rows = sum(element.count for element in header.elements if element.properties)
        room = len(source.data) - header.body + 1
        if rows * len("0\n") > room:
            text = f"the header declares {rows} rows, too many for the {room} bytes after it"
            raise source.error("MESH_FILE_TRUNCATED", text)
        self._table: Table = read_table(source.as_text("PLY"), header.body)
        if len(self._table.byte) < rows:
            lines = len(self._table.byte)
            text = f"the header declares {rows} rows, but {lines} lines follow it"
            raise source.error("MESH_FILE_TRUNCATED", text)

    def next_rows(self, element: Element) -> Rows:
        if not element.properties:
            return Rows(element, np.zeros(0, dtype=np.int64))
        first = self._lines
        self._lines += element.count
        rows = Rows(element, self._table.row[first : self._lines])
        # Every row must end where the next line begins.
        end = rows.place
        for entry in element.properties:
            end = self._after(end, entry)
        wrong = np.flatnonzero(end != self._table.row[first + 1 : self._lines + 1])
        if wrong.size:
            row = int(wrong[0])
            count = int(np.diff(self._table.row[first + row : first + row + 2])[0])
            text = f"row {row} of {element} has {count} numbers, which does not match its properties"
            raise self._table.row_error("MESH_FILE_INVALID", first + row, text)
        return rows

    def finish(self) -> None:
        if len(self._table.byte) > self._lines:
            text = "lines follow after the last declared row"
            raise self._table.row_error("MESH_FILE_INVALID", self._lines, text)

    def column(self, rows: Rows, name: str) -> NDArray[Any]:
        return self._table.values[self._find(rows, name)[1]]

    def indices(self, rows: Rows, name: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        _, place = self._find(rows, name)
        counts = self._table.integers(place, "the length of a list")
        return counts, self._table.integers(
            np.repeat(place + 1, counts) + concatenate_ranges(counts), "an index"
        )

    def numbers(self, rows: Rows, name: str) -> tuple[NDArray[np.int64], NDArray[Any]]:
        _, place = self._find(rows, name)
        counts = self._table.integers(place, "the length of a list")
        return counts, self._table.values[np.repeat(place + 1, counts) + concatenate_ranges(counts)]

    def wrong_face(self, rows: Rows, row: int, index: int, vertices: int) -> str:
        line = int(np.searchsorted(self._table.row, rows.place[row], side="right")) - 1
        return self._table.source.wrong_index(int(self._table.byte[line]), index, vertices)

    def _after(self, place: NDArray[np.int64], wanted: Property) -> NDArray[np.int64]:
        if not wanted.count_type:
            return place + 1
        # An invalid list length gives an offset beyond the table, which `next_rows` rejects.
        size = len(self._table.values)
        length = self._table.values[np.minimum(place, size - 1)]
        possible = (place < size) & (length >= 0) & (length <= size) & (length == np.floor(length))
        return place + 1 + np.where(possible, length, size).astype(np.int64)


def _width(kind: str) -> int:
    """Return the bytes of a value of type `kind`, such as "f4"."""
    return int(kind[1])


def _describe_rows(element: Element, order: str) -> tuple[list[tuple[int, struct.Struct, int]], int]:
    """Return the layout of a row: the layouts of its lists, and the number of bytes after the last list.

    Each list is described by the number of preceding bytes, the struct of the count, and the number of bytes
    per item.
    """
    lists, gap = [], 0
    for entry in element.properties:
        if not entry.count_type:
            gap += _width(entry.type)
        else:
            code = np.dtype(entry.count_type).char
            lists.append((gap, struct.Struct(order + code), _width(entry.type)))
            gap = 0
    return lists, gap

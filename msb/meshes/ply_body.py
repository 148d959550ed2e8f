"""The body of a PLY file: where each row lies, and the values of one property over all rows.

A binary body is counted in bytes, a text body in numbers. Within a row the properties follow each other
without gaps, so once the rows' places are known, those of any property follow by adding up widths; that is
done for all rows at a time.
"""

import struct
from array import array
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from msb.errors import MeshFileError
from msb.meshes.ply_header import Element, Header, Property
from msb.meshes.polygons import steps
from msb.meshes.source import Source
from msb.meshes.text import Table, read_table


@dataclass(frozen=True)
class Rows:
    """The rows of `element`; `place` (N,) int64 is where each begins in the body."""

    element: Element
    place: NDArray[np.int64]


class Body(Protocol):
    """What both kinds of body have."""

    def _find(self, rows: Rows, name: str) -> tuple[Property, NDArray[np.int64]]:
        """Return property `name` and its place (N,) in every row."""
        place = rows.place
        for each in rows.element.properties:
            if each.name == name:
                return each, place
            place = self._after(place, each)
        raise KeyError(name)

    def _after(self, place: NDArray[np.int64], wanted: Property) -> NDArray[np.int64]:
        """Return the place (N,) behind a property at `place`; in text one outside the table stays outside."""

    def next_rows(self, element: Element) -> Rows:
        """Return the rows of the element that comes next."""

    def finish(self) -> None:
        """Raise MESH_FILE_INVALID if anything follows the last element."""

    def column(self, rows: Rows, name: str) -> NDArray[Any]:
        """Return the values (N,) of a property that is one number: float64, or the type in the file."""

    def indices(self, rows: Rows, name: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the lengths (N,) and the integers (C,) of a list property."""

    def wrong_face(self, rows: Rows, row: int, index: int, vertices: int) -> str | None:
        """Return on which line of text the row is that names vertex `index`, which is not there.

        Bytes have no lines.
        """
        return None


def open_body(source: Source, header: Header) -> Body:
    """Return the body behind `header`."""
    if header.order:
        return _BinaryBody(source, header)
    return _TextBody(source, header)


class _BinaryBody(Body):
    """A body of bytes."""

    def __init__(self, source: Source, header: Header) -> None:
        self._source = source
        self._order = header.order
        self._at = header.body

    def next_rows(self, element: Element) -> Rows:
        start, room = self._at, len(self._source.data) - self._at
        least = sum(_width(each.count_type or each.type) for each in element.properties)
        if element.count * least > room:
            text = f"{element} declares {element.count} rows of at least {least} bytes, "
            text += f"but only {room} bytes are left"
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
            text = f"{left} bytes follow the last declared row"
            raise self._source.error("MESH_FILE_INVALID", text, pointer=f"byte {self._at}")

    def column(self, rows: Rows, name: str) -> NDArray[Any]:
        wanted, place = self._find(rows, name)
        return self._take(place, wanted.type)

    def indices(self, rows: Rows, name: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        wanted, place = self._find(rows, name)
        counts = self._take(place, wanted.count_type).astype(np.int64)
        place = place + _width(wanted.count_type)
        width = _width(wanted.type)
        if counts.size and (counts == counts[0]).all():
            corners = (place[:, None] + width * np.arange(counts[0])).ravel()
        else:
            corners = np.repeat(place, counts) + width * steps(counts)
        return counts, self._take(corners, wanted.type).astype(np.int64)

    def _after(self, place: NDArray[np.int64], wanted: Property) -> NDArray[np.int64]:
        if not wanted.count_type:
            return place + _width(wanted.type)
        counts = self._take(place, wanted.count_type).astype(np.int64)
        return place + _width(wanted.count_type) + counts * _width(wanted.type)

    def _take(self, place: NDArray[np.int64], kind: str) -> NDArray[Any]:
        """Return the values of type `kind` at the byte numbers `place` (N,), in the machine's byte order."""
        width = _width(kind)
        data = self._source.data
        if not place.size:
            return np.zeros(0, dtype=kind)
        # Every byte of the file is seen as the start of a value: a view, not a copy.
        everywhere = np.ndarray((len(data) - width + 1,), self._order + kind, data, strides=(1,))
        return everywhere[place].astype(kind)

    def _common_row_size(self, element: Element) -> int | None:
        """Return the row's size in bytes if every list is as long in all rows as in the first, else None."""
        data, start, at = self._source.data, self._at, self._at
        lists: list[tuple[int, int, str]] = []
        for each in element.properties:
            if not each.count_type:
                at += _width(each.type)
                continue
            if at + _width(each.count_type) > len(data):
                return None
            length = int(self._take(np.array([at]), each.count_type)[0])
            lists.append((at, length, each.count_type))
            at += _width(each.count_type) + max(length, 0) * _width(each.type)
        size = at - start
        if start + size * element.count > len(data):
            return None
        for place, length, kind in lists:
            lengths = np.ndarray((element.count,), self._order + kind, data, place, (size,))
            if length < 0 or (lengths != length).any():
                return None
        return size

    def _walk(self, element: Element) -> NDArray[np.int64]:
        """Return where each row begins, found one after the other because their sizes differ."""
        lists, tail = _list_layout(element, self._order)
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
                    text = f"row {row} of {element} has a list of {length} values"
                    raise self._source.error("MESH_FILE_INVALID", text, pointer=f"byte {at}")
                at += count.size + length * width
            at += tail
            if at > len(data):
                raise self._short(element, row)
        self._at = at
        return np.array(places, dtype=np.int64)

    def _short(self, element: Element, row: int) -> MeshFileError:
        text = f"the file ends within row {row} of the {element.count} rows of {element}"
        return self._source.error("MESH_FILE_TRUNCATED", text)


class _TextBody(Body):
    """A body of numbers, one row to a line."""

    def __init__(self, source: Source, header: Header) -> None:
        self._source = source
        self._lines = 0
        rows = sum(element.count for element in header.elements if element.properties)
        room = len(source.data) - header.body + 1
        if rows * len("0\n") > room:
            text = f"the header declares {rows} rows, more than the {room} bytes after it can hold"
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
        end = rows.place
        for each in element.properties:
            end = self._after(end, each)
        wrong = np.flatnonzero(end != self._table.row[first + 1 : self._lines + 1])
        if wrong.size:
            row = int(wrong[0])
            count = int(np.diff(self._table.row[first + row : first + row + 2])[0])
            text = f"row {row} of {element} has {count} numbers, not those of its properties"
            raise self._table.row_error("MESH_FILE_INVALID", first + row, text)
        return rows

    def finish(self) -> None:
        if len(self._table.byte) > self._lines:
            text = "there is more after the last declared row"
            raise self._table.row_error("MESH_FILE_INVALID", self._lines, text)

    def column(self, rows: Rows, name: str) -> NDArray[Any]:
        return self._table.values[self._find(rows, name)[1]]

    def indices(self, rows: Rows, name: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        _, place = self._find(rows, name)
        counts = self._table.integers(place, "the length of a list")
        return counts, self._table.integers(np.repeat(place + 1, counts) + steps(counts), "an index")

    def wrong_face(self, rows: Rows, row: int, index: int, vertices: int) -> str:
        line = int(np.searchsorted(self._table.row, rows.place[row], side="right")) - 1
        return self._table.source.wrong_index(int(self._table.byte[line]), index, vertices)

    def _after(self, place: NDArray[np.int64], wanted: Property) -> NDArray[np.int64]:
        if not wanted.count_type:
            return place + 1
        size = len(self._table.values)
        length = self._table.values[np.minimum(place, size - 1)]
        possible = (place < size) & (length >= 0) & (length <= size) & (length == np.floor(length))
        return place + 1 + np.where(possible, length, size).astype(np.int64)


def _width(kind: str) -> int:
    return int(kind[1])


def _list_layout(element: Element, order: str) -> tuple[list[tuple[int, struct.Struct, int]], int]:
    """Return for each list the bytes before it, its count, an item's bytes; and the bytes behind the last."""
    lists, gap = [], 0
    for each in element.properties:
        if not each.count_type:
            gap += _width(each.type)
        else:
            code = np.dtype(each.count_type).char
            lists.append((gap, struct.Struct(order + code), _width(each.type)))
            gap = 0
    return lists, gap

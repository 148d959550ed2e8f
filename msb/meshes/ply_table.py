"""Reads PLY files that are tables of numbers. Splatting methods store their primitives in such tables."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msb.base.files import map_file
from msb.errors import MeshFileError
from msb.meshes.ply_body import open_body
from msb.meshes.ply_header import MAX_HEADER_BYTES, Header, read_header
from msb.meshes.source import Source


@dataclass(frozen=True, eq=False)
class PlyTable:
    """The `count` rows of an element. The field `names` has the names of its properties in file order."""

    count: int
    names: tuple[str, ...]
    _columns: dict[str, NDArray[Any]]

    def columns(self, names: Sequence[str]) -> NDArray[np.float32]:
        """Return the properties `names` as a new (count, len(names)) float32 array."""
        values = np.zeros((self.count, len(names)), np.float32)
        with np.errstate(over="ignore"):  # Callers reject infinite values.
            for number, name in enumerate(names):
                values[:, number] = self._columns[name]
        return values

    def column(self, name: str) -> NDArray[Any]:
        """Return the property `name` (count,) in the type of the file. Return float64 for a text file."""
        return self._columns[name]


def read_ply_names(path: Path) -> tuple[tuple[str, ...], bool]:
    """Return the property names of element "vertex" of the file at `path`, and whether the file has faces.

    Only the header is read.
    """
    _, header, _ = _open(path)
    elements = {element.name: element for element in header.elements}
    names = tuple(entry.name for entry in elements["vertex"].properties) if "vertex" in elements else ()
    return names, any(name in elements and elements[name].count for name in ("face", "tristrips"))


def read_ply_table(path: Path) -> PlyTable:
    """Read a PLY file whose element "vertex" has only scalars, and whose other elements are empty.

    A binary file is memory-mapped. Its columns are views of the mapped memory.
    """
    tables, _, source = _read_tables(path)
    if [name for name, table in tables.items() if table.count] != ["vertex"]:
        raise source.error(
            "MESH_FILE_INVALID",
            "the file is not a table; only element 'vertex' may have rows, and it must not have lists",
        )
    return tables["vertex"]


def read_ply_tables(path: Path) -> tuple[dict[str, PlyTable], tuple[str, ...]]:
    """Return the elements of a PLY file without lists, as tables by name. Also return the comments of the
    header."""
    tables, header, _ = _read_tables(path)
    return tables, header.comments


def _read_tables(path: Path) -> tuple[dict[str, PlyTable], Header, Source]:
    data, header, source = _open(path)
    for element in header.elements:
        if element.count and any(entry.count_type for entry in element.properties):
            raise source.error("MESH_FILE_INVALID", f"the file is not a table; {element} has lists")
    if not header.order:
        return _read_text(Source(str(path), bytes(data)), header), header, source
    # Binary tables are rows of structured types, one element after the other, after the header.
    tables, start = {}, header.body
    for element in header.elements:
        row = np.dtype([(f"{i}", header.order + entry.type) for i, entry in enumerate(element.properties)])
        needed, available = row.itemsize * element.count, len(data) - start
        if needed > available:
            text = f"{element} has {element.count} rows of {row.itemsize} bytes, "
            text += f"but only {available} bytes are left"
            raise source.error("MESH_FILE_TRUNCATED", text, pointer=f"byte {start}")
        # A type without properties has no size, so that NumPy reads no rows.
        count = element.count if row.itemsize else 0
        table = np.frombuffer(data, row, count, start) if count else np.zeros(0, row)
        names = tuple(entry.name for entry in element.properties)
        columns = {name: table[f"{i}"] for i, name in enumerate(names)}
        tables[element.name] = PlyTable(count, names, columns)
        start += needed
    rest = len(data) - start
    if bytes(data[start:][:4096]).strip() or rest > 4096:
        text = f"{rest} bytes follow after the last row"
        raise source.error("MESH_FILE_INVALID", text, pointer=f"byte {start}")
    return tables, header, source


def _read_text(source: Source, header: Header) -> dict[str, PlyTable]:
    """Return the tables of a text file."""
    body, tables = open_body(source, header), {}
    for element in header.elements:
        placed = body.next_rows(element)
        names = tuple(entry.name for entry in element.properties)
        columns = {name: body.column(placed, name) for name in names}
        tables[element.name] = PlyTable(element.count, names, columns)
    body.finish()
    return tables


def _open(path: Path) -> tuple[memoryview, Header, Source]:
    """Map a PLY file into memory. Return the mapped bytes, the header, and the source for errors."""
    data = memoryview(map_file(Path(path)))
    source = Source(str(path), bytes(data[: MAX_HEADER_BYTES + 1]))
    if not data:
        raise MeshFileError("MESH_FILE_INVALID", "the file is empty", file=path)
    return data, read_header(source), source

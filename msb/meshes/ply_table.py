"""Read PLY files with a single table of numbers. Splatting methods store their primitives in such files."""

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
    """The `count` rows of element "vertex"; `names` are its properties in file order."""

    count: int
    names: tuple[str, ...]
    _columns: dict[str, NDArray[Any]]

    def columns(self, names: Sequence[str]) -> NDArray[np.float32]:
        """Return the properties `names` as a new (count, len(names)) float32 array."""
        values = np.zeros((self.count, len(names)), np.float32)
        with np.errstate(over="ignore"):  # callers reject infinite values
            for number, name in enumerate(names):
                values[:, number] = self._columns[name]
        return values


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

    A binary file is memory-mapped, and its columns are views of the mapping.
    """
    data, header, source = _open(path)
    rows = [element for element in header.elements if element.count]
    if len(rows) != 1 or rows[0].name != "vertex" or any(entry.count_type for entry in rows[0].properties):
        raise source.error(
            "MESH_FILE_INVALID",
            "the file is not a table; only element 'vertex' may have rows, and they must not have lists",
        )
    element = rows[0]
    names = tuple(entry.name for entry in element.properties)
    if not header.order:
        body = open_body(Source(str(path), bytes(data)), header)
        placed = body.next_rows(element)
        body.finish()
        return PlyTable(element.count, names, {name: body.column(placed, name) for name in names})
    # A binary table: rows of one structured type, directly after the header.
    row = np.dtype([(f"{i}", header.order + entry.type) for i, entry in enumerate(element.properties)])
    needed, available = row.itemsize * element.count, len(data) - header.body
    if needed > available:
        text = (
            f"{element} has {element.count} rows of {row.itemsize} bytes, but only {available} bytes are left"
        )
        raise source.error("MESH_FILE_TRUNCATED", text, pointer=f"byte {header.body}")
    if bytes(data[header.body + needed :][:4096]).strip() or available - needed > 4096:
        text = f"{available - needed} bytes follow after the last row"
        raise source.error("MESH_FILE_INVALID", text, pointer=f"byte {header.body + needed}")
    table = np.frombuffer(data, row, element.count, header.body)
    return PlyTable(element.count, names, {name: table[f"{i}"] for i, name in enumerate(names)})


def _open(path: Path) -> tuple[memoryview, Header, Source]:
    """Map a PLY file; return its bytes, its header, and the source for errors."""
    data = memoryview(map_file(Path(path)))
    source = Source(str(path), bytes(data[: MAX_HEADER_BYTES + 1]))
    if not data:
        raise MeshFileError("MESH_FILE_INVALID", "the file is empty", file=path)
    return data, read_header(source), source

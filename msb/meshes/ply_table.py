"""PLY files that are a table: one element whose rows are numbers, as splatting methods store primitives."""

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
    """The `count` rows of element "vertex"; `names` are its properties, in the file's order."""

    count: int
    names: tuple[str, ...]
    _columns: dict[str, NDArray[Any]]

    def columns(self, names: Sequence[str]) -> NDArray[np.float32]:
        """Return the properties `names` as a new (count, len(names)) float32 array."""
        values = np.zeros((self.count, len(names)), np.float32)
        with np.errstate(over="ignore"):  # whoever asks refuses what is infinite
            for number, name in enumerate(names):
                values[:, number] = self._columns[name]
        return values


def ply_names(path: Path) -> tuple[tuple[str, ...], bool]:
    """Return the properties of element "vertex" of the PLY file at `path`, and whether it has faces.

    Only the header is read.
    """
    _, header, _ = _open(path)
    elements = {element.name: element for element in header.elements}
    names = tuple(each.name for each in elements["vertex"].properties) if "vertex" in elements else ()
    return names, any(name in elements and elements[name].count for name in ("face", "tristrips"))


def read_ply_table(path: Path) -> PlyTable:
    """Read a PLY file whose element "vertex" has numbers only, and whose other elements are empty.

    A binary file is mapped, and a column is a view on the mapping.
    """
    data, header, source = _open(path)
    rows = [element for element in header.elements if element.count]
    if len(rows) != 1 or rows[0].name != "vertex" or any(each.count_type for each in rows[0].properties):
        raise source.error(
            "MESH_FILE_INVALID", "it is no table: only element 'vertex' may have rows, of numbers"
        )
    element = rows[0]
    names = tuple(each.name for each in element.properties)
    if not header.order:
        body = open_body(Source(str(path), bytes(data)), header)
        placed = body.next_rows(element)
        body.finish()
        return PlyTable(element.count, names, {name: body.column(placed, name) for name in names})
    row = np.dtype([(f"{i}", header.order + each.type) for i, each in enumerate(element.properties)])
    wanted, there = row.itemsize * element.count, len(data) - header.body
    if wanted > there:
        text = f"{element} declares {element.count} rows of {row.itemsize} bytes, but {there} bytes are left"
        raise source.error("MESH_FILE_TRUNCATED", text, pointer=f"byte {header.body}")
    if bytes(data[header.body + wanted :][:4096]).strip() or there - wanted > 4096:
        text = f"{there - wanted} bytes follow the last declared row"
        raise source.error("MESH_FILE_INVALID", text, pointer=f"byte {header.body + wanted}")
    table = np.frombuffer(data, row, element.count, header.body)
    return PlyTable(element.count, names, {name: table[f"{i}"] for i, name in enumerate(names)})


def _open(path: Path) -> tuple[memoryview, Header, Source]:
    data = memoryview(map_file(Path(path)))
    source = Source(str(path), bytes(data[: MAX_HEADER_BYTES + 1]))
    if not data:
        raise MeshFileError("MESH_FILE_INVALID", "the file is empty", file=path)
    return data, read_header(source), source

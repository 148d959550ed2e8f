"""Writes VTK XML PolyData (.vtp): points, and cells of one, two and three points with cell data.

The layout is defined in "VTK XML file formats" of the VTK documentation. A VTP file stores all arrays as raw
data in one appended block. In this block, each array is preceded by its length in bytes, a 64-bit number. VTK
itself is a large optional dependency (extra `view`) and is not needed.
"""

from collections.abc import Mapping, Sequence
from typing import IO, Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

_TYPES = {"f4": "Float32", "f8": "Float64", "i8": "Int64", "u1": "UInt8"}


class _Appended:
    """The block of raw data at the end of the file."""

    def __init__(self) -> None:
        self.blocks: list[NDArray[Any]] = []
        self.offset = 0

    def array(self, name: str, values: NDArray[Any], components: int = 1) -> str:
        """Append an array to the block. Return the XML element that refers to the array."""
        stored = values.dtype if values.dtype.str[1:] in _TYPES else np.dtype(np.float64)
        data = np.ascontiguousarray(values, stored.newbyteorder("<"))
        text = (
            f"<DataArray type={quoteattr(_TYPES[data.dtype.str[1:]])} Name={quoteattr(name)} "
            f'NumberOfComponents="{components}" format="appended" offset="{self.offset}"/>'
        )
        self.blocks.append(data)
        self.offset += 8 + data.nbytes
        return text

    def cells(self, tag: str, table: NDArray[Any]) -> str:
        """Append cells (n, points per cell). Return the XML element of the cells, with the name `tag`."""
        ends = np.arange(1, len(table) + 1, dtype=np.int64) * table.shape[1]
        connectivity = self.array("connectivity", table.reshape(-1).astype(np.int64))
        return f"<{tag}>{connectivity}{self.array('offsets', ends)}</{tag}>"

    def write(self, file: IO[bytes]) -> None:
        """Write the block. Each array is preceded by its length in bytes."""
        for block in self.blocks:
            file.write(block.nbytes.to_bytes(8, "little"))
            file.write(block.reshape(-1).view(np.uint8).data)


def write_vtp(
    file: IO[bytes],
    points: NDArray[Any],
    *,
    verts: NDArray[Any],
    lines: NDArray[Any],
    polys: NDArray[Any],
    cell_data: Mapping[str, NDArray[Any]],
    names: tuple[str, Sequence[str]],
) -> None:
    """Write PolyData with points (V, 3), and cells: verts (n, 1), lines (n, 2) and polys (n, 3).

    The argument `cell_data` has uint8 or int64 arrays with one value per cell, in VTK's order of cells
    (verts, lines, polys). The argument `names` describes a field array. The array has a name and ASCII
    strings as values.
    """
    appended = _Appended()
    data = "".join(appended.array(name, values) for name, values in cell_data.items())
    elements = [
        f"<CellData>{data}</CellData>",
        f"<Points>{appended.array('Points', points, 3)}</Points>",
        appended.cells("Verts", verts),
        appended.cells("Lines", lines),
        appended.cells("Polys", polys),
    ]
    header = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "<PolyData>",
        f"<FieldData>{_encode_texts(*names)}</FieldData>",
        f'<Piece NumberOfPoints="{len(points)}" NumberOfVerts="{len(verts)}" '
        f'NumberOfLines="{len(lines)}" NumberOfStrips="0" NumberOfPolys="{len(polys)}">',
        *elements,
        "</Piece></PolyData>",
        '<AppendedData encoding="raw">_',
    ]
    file.write("\n".join(header).encode("ascii"))
    appended.write(file)
    file.write(b"</AppendedData>\n</VTKFile>\n")


def _encode_texts(name: str, texts: Sequence[str]) -> str:
    """Return the XML element of a string array: character codes, with a 0 after each string."""
    codes = " ".join(" ".join(map(str, (*text.encode("ascii"), 0))) for text in texts)
    size = f'NumberOfTuples="{len(texts)}"'
    return f'<Array type="String" Name={quoteattr(name)} {size} format="ascii">{codes}</Array>'

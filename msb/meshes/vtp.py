"""Write VTK XML PolyData (.vtp): points, and cells of one, two and three points with data on them.

Layout: "VTK XML file formats" of the VTK documentation; all arrays raw in one appended block, each behind its
64-bit byte count. VTK itself is an extra (`view`), and too large a thing to need for writing one file.
"""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

_TYPES = {"f4": "Float32", "f8": "Float64", "i8": "Int64", "u1": "UInt8"}


def write_vtp(
    file: IO[bytes],
    points: NDArray[Any],
    *,
    verts: NDArray[Any],
    lines: NDArray[Any],
    polys: NDArray[Any],
    cell_data: Mapping[str, NDArray[Any]],
) -> None:
    """Write one piece of PolyData.

    Parameters
    ----------
    file : binary file open for writing
    points : (V, 3) float32 or float64
    verts, lines, polys : (n, 1), (n, 2), (n, 3) integers
        Point numbers of the cells.
    cell_data : mapping of str to (n_verts + n_lines + n_polys,) uint8 or int64
        In VTK's cell order: verts, lines, polys.
    """
    blocks: list[NDArray[Any]] = []
    offset = 0

    def array(name: str, values: NDArray[Any], components: int = 1) -> str:
        nonlocal offset
        stored = values.dtype if values.dtype.str[1:] in _TYPES else np.dtype(np.float64)
        data = np.ascontiguousarray(values, stored.newbyteorder("<"))
        blocks.append(data)
        text = (
            f"<DataArray type={quoteattr(_TYPES[data.dtype.str[1:]])} Name={quoteattr(name)} "
            f'NumberOfComponents="{components}" format="appended" offset="{offset}"/>'
        )
        offset += 8 + data.nbytes
        return text

    def cells(tag: str, table: NDArray[Any]) -> str:
        ends = np.arange(1, len(table) + 1, dtype=np.int64) * table.shape[1]
        connectivity = array("connectivity", table.reshape(-1).astype(np.int64))
        return f"<{tag}>{connectivity}{array('offsets', ends)}</{tag}>"

    body = "\n".join(
        [
            f"<Points>{array('Points', points, 3)}</Points>",
            cells("Verts", verts),
            cells("Lines", lines),
            cells("Polys", polys),
            f"<CellData>{''.join(array(name, values) for name, values in cell_data.items())}</CellData>",
        ]
    )
    header = (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">\n'
        f'<PolyData><Piece NumberOfPoints="{len(points)}" NumberOfVerts="{len(verts)}" '
        f'NumberOfLines="{len(lines)}" NumberOfStrips="0" NumberOfPolys="{len(polys)}">\n'
        f'{body}\n</Piece></PolyData>\n<AppendedData encoding="raw">_'
    )
    file.write(header.encode("ascii"))
    for block in blocks:
        file.write(block.nbytes.to_bytes(8, "little"))
        file.write(block.reshape(-1).view(np.uint8).data)
    file.write(b"</AppendedData>\n</VTKFile>\n")

"""Meshes written as Wavefront OBJ."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from msb.meshes.writing import write_rows

if TYPE_CHECKING:
    from msb.meshes.formats import Style
    from msb.meshes.mesh import Mesh


def write(mesh: Mesh, stream: BinaryIO, _style: Style) -> None:
    """Write `v` and `f` lines; float32 and float64 coordinates read back as exactly the same number.

    Colours are written after the coordinates, as 0..1 with nine digits.
    """
    columns, form = mesh.vertices, "v %r %r %r"
    if mesh.vertex_colors is not None:
        colors: NDArray[Any] = mesh.vertex_colors
        if colors.dtype == np.uint8:
            colors = colors / 255
        columns = np.column_stack((columns, colors))
        form += " %.9g" * colors.shape[1]
    write_rows(stream, form, columns)
    write_rows(stream, "f %d %d %d", mesh.faces + 1)

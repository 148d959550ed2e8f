"""`msb audit --elements FILE`: write the defective edges, vertices and faces for other programs."""

import csv
import io
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from msb.base.atomic import new_file
from msb.base.npz import write_npz
from msb.topology.elements import Elements


def write_elements(elements: Elements, path: Path, *, overwrite: bool = True) -> None:
    """Write `elements` to `path` in the format of the path's suffix.

    The kinds have the names of the JSON keys. ``.vtp`` has points, edges and faces as cells with the arrays
    ``kind``, ``element`` and ``component``. ``kind`` is 0 for ordinary faces. For a defective element,
    ``kind`` is 1 plus the index of its name in the field array ``kinds``. ``.csv`` has one row per element.
    ``.npz`` has one array per kind, and ``face_component``. Edges are stored as vertex pairs, other elements
    as indices. If `overwrite` is false, an existing file is an error.
    """
    with new_file(path, overwrite=overwrite) as file:
        _WRITERS[path.suffix.lower()](elements, file)


def _write_npz(elements: Elements, file: IO[bytes]) -> None:
    arrays: dict[str, Any] = {"face_component": elements.face_component}
    for group in elements.groups:
        arrays[group.kind] = group.vertices if group.vertices.shape[1] == 2 else group.numbers
    write_npz(file, arrays)


def _write_csv(elements: Elements, file: IO[bytes]) -> None:
    # Detach the wrapper at the end, so that the wrapper does not close the file.
    text = io.TextIOWrapper(file, "utf-8", newline="", write_through=True)
    try:
        writer = csv.writer(text)
        writer.writerow(["kind", "element", "component", "vertices", "x", "y", "z"])
        for group in elements.groups:
            of_faces = group.vertices.shape[1] == 3
            # The position of an element is the position of its first vertex.
            for number, ends in zip(group.numbers.tolist(), group.vertices.tolist(), strict=True):
                component = int(elements.face_component[number]) if of_faces else ""
                place = elements.vertices[ends[0]].tolist()
                writer.writerow([group.kind, number, component, " ".join(map(str, ends)), *map(repr, place)])
    finally:
        text.detach()


def _write_vtp(elements: Elements, file: IO[bytes]) -> None:
    from msb.meshes.vtp import write_vtp

    # Each group of cells has three entries: the kind, the element indices (n,), and 1 to 3 vertex indices per
    # element.
    kinds = [group.kind for group in elements.groups]
    # Each face is an ordinary cell with the kind 0. A defective face is added a second time, with its kind of
    # defect.
    plain = (0, np.arange(len(elements.faces)), elements.faces)
    cells = [(kinds.index(group.kind) + 1, group.numbers, group.vertices) for group in elements.groups]
    # VTK expects the order points, lines, polygons.
    cells = sorted([plain, *cells], key=lambda cell: cell[2].shape[1])

    def joined(size: int) -> NDArray[Any]:
        return np.concatenate([vertices for _, _, vertices in cells if vertices.shape[1] == size])

    # The arrays of cell data have one value per cell, in the order verts, lines, polys.
    write_vtp(
        file,
        elements.vertices,
        verts=joined(1),
        lines=joined(2),
        polys=joined(3),
        cell_data={
            "kind": np.concatenate([np.full(len(ids), kind, np.uint8) for kind, ids, _ in cells]),
            "element": np.concatenate([ids for _, ids, _ in cells]).astype(np.int64),
            "component": np.concatenate(
                [
                    elements.face_component[ids] if vertices.shape[1] == 3 else np.full(len(ids), -1)
                    for _, ids, vertices in cells
                ]
            ).astype(np.int64),
        },
        names=("kinds", kinds),
    )


_WRITERS: dict[str, Callable[[Elements, IO[bytes]], None]] = {
    ".vtp": _write_vtp,
    ".csv": _write_csv,
    ".npz": _write_npz,
}

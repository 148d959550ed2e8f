"""`--elements FILE`: the offending edges, vertices, faces and the components, for other programs."""

from __future__ import annotations

import csv
import io
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from msb.atomic import new_file
from msb.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from msb.topology.elements import Elements


def check_suffix(path: Path) -> None:
    """Refuse a name whose suffix is none we write.

    Raises
    ------
    UsageError
        `USAGE`.
    """
    if path.suffix.lower() not in _WRITERS:
        text = f'--elements: "{path.name}" must end in {", ".join(_WRITERS)}'
        raise UsageError("USAGE", text)


def write_elements(elements: Elements, path: Path) -> None:
    """Write `elements` to `path` in the form its suffix names.

    ``.vtp`` holds faces, edges and points as cells with the arrays ``kind`` (see `KINDS`), ``element`` and
    ``component``; ``.csv`` one row an element; ``.npz`` one array a kind, without pickled objects.
    """
    with new_file(path) as file:
        _WRITERS[path.suffix.lower()](elements, file)


KINDS = (
    "face",
    "edge_boundary",
    "edge_nonmanifold",
    "edge_inconsistent_winding",
    "vertex_multifan",
    "vertex_nonmanifold_edge_endpoint",
    "vertex_unreferenced",
    "face_repeated_index",
    "face_zero_area",
    "face_nonfinite",
    "face_duplicate",
)
"""Number of a kind in a .vtp -> its name; also the names used in .csv and .npz."""


def _groups(elements: Elements) -> Iterator[tuple[str, NDArray[Any], NDArray[Any]]]:
    """Yield kind, element numbers and the vertices of each element, (n, 1), (n, 2) or (n, 3)."""
    for name, pairs in elements.edges.items():
        yield f"edge_{name}", np.arange(len(pairs)), pairs
    for name, vertices in elements.points.items():
        yield f"vertex_{name}", vertices, vertices[:, None]
    for name, faces in elements.marked_faces.items():
        yield f"face_{name}", faces, elements.faces[faces]


def _write_npz(elements: Elements, file: IO[bytes]) -> None:
    arrays: dict[str, Any] = {"face_component": elements.face_component}
    for kind, numbers, vertices in _groups(elements):
        arrays[kind] = vertices if kind.startswith("edge_") else numbers
    np.savez(file, **arrays)


def _write_csv(elements: Elements, file: IO[bytes]) -> None:
    text = io.TextIOWrapper(file, "utf-8", newline="", write_through=True)
    writer = csv.writer(text)
    writer.writerow(["kind", "element", "component", "vertices", "x", "y", "z"])
    for kind, numbers, vertices in _groups(elements):
        of_faces = kind.startswith("face_")
        # The first vertex says where to look.
        for number, ends in zip(numbers.tolist(), vertices.tolist(), strict=True):
            component = int(elements.face_component[number]) if of_faces else ""
            place = elements.vertices[ends[0]].tolist()
            writer.writerow([kind, number, component, " ".join(map(str, ends)), *map(repr, place)])
    text.detach()


def _write_vtp(elements: Elements, file: IO[bytes]) -> None:
    from msb.meshes.vtp import write_vtp

    cells: dict[int, list[tuple[int, NDArray[Any], NDArray[Any]]]] = {1: [], 2: [], 3: []}
    for kind, numbers, vertices in _groups(elements):
        cells[vertices.shape[1]].append((KINDS.index(kind), numbers, vertices))
    # All faces are drawn once, as "face"; the marked ones again on top, with their kind.
    cells[3].insert(0, (0, np.arange(len(elements.faces)), elements.faces))
    groups = [group for size in (1, 2, 3) for group in cells[size]]
    kinds = np.concatenate([np.full(len(n), k, np.uint8) for k, n, _ in groups])
    element = np.concatenate([n for _, n, _ in groups]).astype(np.int64)
    of_faces = [elements.face_component[n] for _, n, v in groups if v.shape[1] == 3]
    others = sum(len(n) for _, n, v in groups if v.shape[1] < 3)
    component = np.concatenate([np.full(others, -1), *of_faces]).astype(np.int64)
    write_vtp(
        file,
        elements.vertices,
        verts=np.concatenate([v for _, _, v in cells[1]]),
        lines=np.concatenate([v for _, _, v in cells[2]]),
        polys=np.concatenate([v for _, _, v in cells[3]]),
        cell_data={"kind": kinds, "element": element, "component": component},
    )


_WRITERS: dict[str, Callable[[Elements, IO[bytes]], None]] = {
    ".vtp": _write_vtp,
    ".csv": _write_csv,
    ".npz": _write_npz,
}

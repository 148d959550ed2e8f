"""Read polygons, indices and numbers of all text formats."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from .builders import Read, off, ply_square, ply_text

# Polygons, and their triangle fans. Polygons with fewer than three corners are ignored.
MIXED = [[0, 1, 2], [3, 2, 1, 0], [0, 1], [], [0, 1, 2, 3, 0], [2]]
MIXED_FACES = [[0, 1, 2], [3, 2, 1], [3, 1, 0], [0, 1, 2], [0, 2, 3], [0, 3, 0]]
NUMBERS = ("0.123456789012345 -1e-300 .5E+2", "nan inf -INF", "1e999 0 0", "1.e5 1 1")
VALUES = [[0.123456789012345, -1e-300, 50], [np.nan, np.inf, -np.inf], [np.inf, 0, 0], [1e5, 1, 1]]
Rows = Sequence[str]


def lines(rows: Rows, begin: str = "") -> bytes:
    return "".join(f"{begin}{row}\n" for row in rows).encode()


def as_off(vertices: Rows, faces: Sequence[Sequence[int]]) -> bytes:
    rows = [" ".join(map(str, (len(face), *face))) for face in faces]
    return off(f"OFF\n{len(vertices)} {len(faces)} 0".encode(), lines(vertices), lines(rows))


def as_ply(vertices: Rows, faces: Sequence[Sequence[int]]) -> bytes:
    body = as_off(vertices, faces).split(b"\n", 2)[2]
    return ply_text(body, len(faces), len(vertices))


def as_obj(vertices: Rows, faces: Sequence[Sequence[int]]) -> bytes:
    rows = [" ".join(str(corner + 1) for corner in face) for face in faces]
    return lines(vertices, "v ") + lines(rows, "f ")


WRITERS = {".off": as_off, ".ply": as_ply, ".obj": as_obj}
for_every_format = pytest.mark.parametrize(("suffix", "write"), WRITERS.items(), ids=WRITERS)
Write = Callable[[Rows, Sequence[Sequence[int]]], bytes]


@for_every_format
def test_polygons_of_any_size_become_fans_in_order(read: Read, suffix: str, write: Write) -> None:
    mesh = read(write(("0 0 0",) * 4, MIXED), suffix)
    assert mesh.faces.tolist() == MIXED_FACES


@pytest.mark.parametrize("order", ["<", ">"])
def test_polygons_of_any_size_in_bytes(read: Read, order: str) -> None:
    assert read(ply_square(MIXED, order), ".ply").faces.tolist() == MIXED_FACES


@for_every_format
@pytest.mark.parametrize("face", [[0, 1, 9], [10**15, 0, 1]])
def test_indices_outside_the_mesh_are_kept(read: Read, suffix: str, write: Write, face: list[int]) -> None:
    assert read(write(("0 0 0",) * 4, [face]), suffix).faces.tolist() == [face]


@for_every_format
def test_text_keeps_all_digits_and_special_numbers(read: Read, suffix: str, write: Write) -> None:
    mesh = read(write(NUMBERS, []), suffix)
    assert mesh.vertices.dtype == np.float64
    np.testing.assert_array_equal(mesh.vertices, VALUES)

"""Read polygons, indices and numbers of all text formats."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from msb.meshes import read_mesh
from msb.meshes.polygons import triangulate

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


# A wall with a notch: area 8, not convex.
WALL = ("0 0 0", "4 0 0", "4 3 0", "2 1 0", "0 3 0")


def area_of(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the area vectors (F, 3) of triangles."""
    a, b, c = points[faces].swapaxes(0, 1)
    return np.cross(b - a, c - a) / 2


@for_every_format
@pytest.mark.parametrize("start", range(5))
def test_concave_polygons_are_cut_by_ears(read: Read, suffix: str, write: Write, start: int) -> None:
    mesh = read(write(WALL, [[(start + k) % 5 for k in range(5)]]), suffix)
    areas = area_of(mesh.vertices, mesh.faces)[:, 2]
    assert (len(areas), len(mesh.vertices), areas.sum()) == (3, 5, 8)
    assert (areas > 0).all()
    assert mesh.left_out == ()


def star_outline(seed: int) -> np.ndarray:
    """Return the corners (N, 2) of a random outline round the origin."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(5, 60))
    angle = 2 * np.pi * (np.arange(count) + 0.9 * rng.random(count)) / count
    return (0.05 + rng.random(count))[:, None] * np.column_stack((np.cos(angle), np.sin(angle)))


@pytest.mark.parametrize("seed", range(20))
def test_outlines_in_any_plane_keep_their_area(seed: int) -> None:
    flat = star_outline(seed)
    x, y = flat.T
    area = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    points = np.column_stack((flat, np.zeros(len(flat)))) @ turn + 100
    corners = np.roll(np.arange(len(points)), seed)[:: 1 - 2 * (seed % 2)]
    cut = triangulate(points, corners, np.array([len(points)]))
    found = np.linalg.norm(area_of(points, corners[cut.order]), axis=1)
    assert (len(found), cut.uncut) == (len(points) - 2, 0)
    assert found.sum() == pytest.approx(area)


def test_a_hole_joined_by_a_cut_stays_a_hole() -> None:
    outer, hole = [(0, 0), (4, 0), (4, 4), (0, 4)], [(1, 1), (1, 3), (3, 3), (3, 1)]
    ring = [*outer, outer[0], *hole, hole[0]]
    points = np.array([(x, y, 0) for x, y in ring], float)
    for start in range(10):
        cut = triangulate(points, np.roll(np.arange(10), start), np.array([10]))
        areas = area_of(points, np.roll(np.arange(10), start)[cut.order])[:, 2]
        assert (areas.sum(), areas.min() >= 0, cut.uncut) == (12, True, 0)


@pytest.mark.parametrize(
    "outline",
    [[(0, 0), (2, 0), (0, 1), (2, 1)], [(np.cos(k), np.sin(k)) for k in np.arange(5) * 0.8 * np.pi]],
    ids=["bow tie", "pentagram"],
)
def test_outlines_that_cross_themselves_stay_fans_and_are_named(
    read: Read, outline: list[tuple[float, float]]
) -> None:
    rows = [f"{x} {y} 0" for x, y in outline]
    mesh = read(as_off(rows, [range(len(rows))]), ".off")
    assert mesh.faces.tolist() == [[0, k, k + 1] for k in range(1, len(rows) - 1)]
    assert len(mesh.left_out) == 1


def test_bent_and_rounded_convex_polygons_stay_fans() -> None:
    bent = [(0, 0, 0), (1, 0, 0.5), (1, 1, 0), (0, 1, 0.5)]
    rounded = [(0, 0, 0), (0.5, 1e-8, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    points, corners = np.array([*bent, *rounded], float), np.arange(9)
    cut = triangulate(points, corners, np.array([4, 5]))
    assert cut.order.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [4, 7, 8]]
    assert cut.polygon.tolist() == [0, 0, 1, 1, 1]


def test_texture_coordinates_follow_the_ears(tmp_path: Path) -> None:
    vt = "".join(f"vt {k / 8} 0\n" for k in range(5))
    text = "".join(f"v {row}\n" for row in WALL) + vt + "mtllib a.mtl\nusemtl a\nf 1/1 2/2 3/3 4/4 5/5\n"
    (tmp_path / "a.obj").write_text(text)
    mesh = read_mesh(tmp_path / "a.obj", images=False)
    assert mesh.corner_uvs is not None
    assert (mesh.corner_uvs[:, 0] * 8).tolist() == mesh.faces.reshape(-1).tolist()

"""Read OBJ files: vertices, faces and vertex colours."""

import random

import numpy as np
import pytest

from msb.meshes import text

from .builders import OBJ_SQUARE, SQUARE, SQUARE_FACES, Read, assert_colors


@pytest.mark.parametrize(
    "faces",
    [
        b"f 1 2 3\nf 1 3 4\n",
        b"f 1/1 2/2 3/3\nf 1/9 3/8 4/7\n",
        b"f 1//1 2//2 3//3\nf 1//4 3//5 4//6\n",
        b"f 1/1/1 2/2/2 3/3/3\nf 1/2/3 3/2/1 4/1/2\n",
        b"f 1// 2// 3//\nfo 1/ 3/ 4/\n",
        b"f 1 2 3 4\n",
        b"f -4 -3 -2\nf -4 -2 -1",
        b"\tf  1\t2 3 \r\nf 1 3 4 # the rest\r\n",
        b"f 1 2 \\\n3\nf \\\r\n1 3 4\n",
        b"g f 1 2 4\nusemtl v 1\nf 1 2 3\nl 1 2\np 1\ns 1\nvp 1 2\no v\nf 1 3 4\n",
        b"f 1 2 3\nf 1 2\nf 1\nf\nf 1 3 4\n",
        b"#f 9 9 9\n # v 1\nmtllib /etc/passwd\nf 1 2 3\nunknown \xff\xfe words\nf 1 3 4\n",
    ],
)
def test_spellings_of_the_square(read: Read, faces: bytes) -> None:
    mesh = read(OBJ_SQUARE + faces, ".obj")
    assert mesh.vertices.dtype == np.float64
    assert mesh.vertices.tolist() == SQUARE
    assert mesh.faces.tolist() == SQUARE_FACES


@pytest.mark.parametrize(
    ("tail", "expected"),
    [
        (b" 1 0.5 0", np.float32([1, 0.5, 0])),
        (b" 1 0.5 0 0.25", np.float32([1, 0.5, 0, 0.25])),
        (b" 255 0 7", np.uint8([255, 0, 7])),
        (b" 1 0 0", np.float32([1, 0, 0])),
        (b" 1", None),
    ],
)
def test_vertex_colors(read: Read, tail: bytes, expected: np.ndarray | None) -> None:
    mesh = read(OBJ_SQUARE.replace(b"\n", tail + b"\n"), ".obj")
    assert mesh.vertices.tolist() == SQUARE
    assert_colors(mesh.vertex_colors, None if expected is None else np.stack([expected] * 4))


def test_colors_of_only_some_vertices_are_ignored(read: Read) -> None:
    assert read(OBJ_SQUARE + b"v 2 2 2 1 0 0\n", ".obj").vertex_colors is None


def random_obj(seed: int) -> tuple[str, list[list[float]], list[list[int]]]:
    """Return a random OBJ text, and its vertices and triangles."""
    rng = random.Random(seed)
    lines, vertices, faces = ["v 0 0 0"], [[0.0, 0.0, 0.0]], []
    for _ in range(60):
        kind = rng.choice(["v", "v", "f", "f", "vt", "#", "", "g"])
        if kind == "v":
            # All vertices are on a line, so that every polygon stays a fan.
            place = rng.uniform(-1e3, 1e3)
            vertices.append([place, 2 * place, -4 * place])
            lines.append(f"v {' '.join(map(repr, vertices[-1]))}")
        elif kind == "f":
            corners = [rng.randrange(len(vertices)) for _ in range(rng.randint(1, 6))]
            relative = rng.random() < 0.3
            indices = [corner - len(vertices) if relative else corner + 1 for corner in corners]
            tails = [rng.choice(["", "/7", "//3", "/1/-2"]) for _ in corners]
            lines.append(" ".join(["f", *(f"{i}{tail}" for i, tail in zip(indices, tails, strict=True))]))
            faces += [[corners[0], *corners[at : at + 2]] for at in range(1, len(corners) - 1)]
        else:
            lines.append(f"{kind} 0.5 0.5")
    return "\n".join(lines), vertices, faces


@pytest.mark.parametrize("block", [1, 97, text.BLOCK_BYTES])
def test_random_files_against_a_line_by_line_reader(
    read: Read, monkeypatch: pytest.MonkeyPatch, block: int
) -> None:
    monkeypatch.setattr(text, "BLOCK_BYTES", block)
    for seed in range(12):
        content, vertices, faces = random_obj(seed)
        mesh = read(content.encode("ascii"), ".obj")
        assert mesh.vertices.tolist() == vertices
        assert mesh.faces.tolist() == faces


def test_faces_may_come_before_their_vertices(read: Read) -> None:
    assert read(b"f 1 2 3\n" + OBJ_SQUARE, ".obj").faces.tolist() == [[0, 1, 2]]

"""Read GLB files: accessors, primitives in node order, node transforms and colours."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msb.errors import MeshFileError
from msb.meshes import read_mesh

from .builders import SMALL, SQUARE, SQUARE_FACES, Glb, Read, assert_colors, glb_square

MOVED = [[x + 10, y, z] for x, y, z in SQUARE]
SECOND = [[a + 4, b + 4, c + 4] for a, b, c in SQUARE_FACES]


@pytest.mark.parametrize("dtype", ["u1", "u2", "u4"])
def test_square(read: Read, dtype: str) -> None:
    mesh = read(glb_square(dtype=dtype).bytes(), ".glb")
    assert mesh.vertices.dtype == np.float32
    assert mesh.vertices.tolist() == SQUARE
    assert mesh.faces.dtype == np.int64
    assert mesh.faces.tolist() == SQUARE_FACES
    assert mesh.vertex_colors is None


@pytest.mark.parametrize(
    ("mode", "indices", "faces"),
    [
        (4, [0, 1, 2, 0, 2, 3], SQUARE_FACES),
        (5, [0, 1, 3, 2], [[0, 1, 3], [1, 2, 3]]),
        (5, [0, 1, 2, 3, 0], [[0, 1, 2], [1, 3, 2], [2, 3, 0]]),
        (6, [0, 1, 2, 3], SQUARE_FACES),
        (6, [], []),
    ],
)
def test_triangles_strips_and_fans(read: Read, mode: int, indices: list[int], faces: list[list[int]]) -> None:
    assert read(glb_square(mode, indices).bytes(), ".glb").faces.tolist() == faces


@pytest.mark.parametrize("mode", [0, 1, 2, 3])
def test_points_and_lines_are_ignored(read: Read, mode: int) -> None:
    glb = glb_square()
    glb.primitive(glb.accessor(MOVED, "f4", "VEC3"), mode=mode)
    assert read(glb.bytes(), ".glb").vertices.tolist() == SQUARE


def test_without_indices_three_vertices_make_a_face(read: Read) -> None:
    glb = Glb()
    glb.primitive(glb.accessor([*SQUARE[:3], *SQUARE[:3]], "f4", "VEC3"))
    mesh = read(glb.bytes(), ".glb")
    assert mesh.vertices.shape == (6, 3)
    assert mesh.faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def test_interleaved_vertices(read: Read) -> None:
    glb = glb_square()
    rows = np.zeros(4, dtype=[("normal", "<f4", 3), ("position", "<f4", 3), ("color", "u1", 4)])
    rows["position"] = MOVED
    rows["color"] = [1, 2, 3, 4]
    view = glb.view(rows.tobytes(), byteStride=28)
    glb.root["accessors"][0] |= {"bufferView": view, "byteOffset": 12}
    color = {"bufferView": view, "byteOffset": 24, "componentType": 5121, "count": 4, "type": "VEC4"}
    glb.root["accessors"].append(color)
    glb.root["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = 2
    mesh = read(glb.bytes(), ".glb")
    assert mesh.vertices.tolist() == MOVED
    assert_colors(mesh.vertex_colors, np.uint8([[13, 22, 28, 4]] * 4))


@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_accessors_are_applied(read: Read, has_base: bool) -> None:
    glb = glb_square()
    sparse = {
        "count": 2,
        "indices": {"bufferView": glb.view(np.array([1, 3], "<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": glb.view(np.array([[7, 7, 7], [8, 8, 8]], "<f4").tobytes())},
    }
    glb.root["accessors"][0]["sparse"] = sparse
    if not has_base:
        del glb.root["accessors"][0]["bufferView"]
    base = SQUARE if has_base else [[0.0, 0.0, 0.0]] * 4
    vertices = read(glb.bytes(), ".glb").vertices.tolist()
    assert vertices == [base[0], [7, 7, 7], base[2], [8, 8, 8]]


@pytest.mark.parametrize(
    ("dtype", "normalized", "stored", "expected"),
    [
        ("i2", False, [-5, 0, 7], [-5, 0, 7]),
        ("i2", True, [-32768, 0, 32767], [-1, 0, 1]),
        ("u1", True, [255, 0, 51], [1, 0, 0.2]),
    ],
)
def test_quantized_positions(
    read: Read, dtype: str, normalized: bool, stored: list[int], expected: list[float]
) -> None:
    glb = Glb()
    glb.primitive(glb.accessor([stored] * 3, dtype, "VEC3", normalized=normalized))
    glb.root["extensionsRequired"] = ["KHR_mesh_quantization"]
    # The rows are not aligned to four bytes, although the format requires it. Readers can ignore this.
    mesh = read(glb.bytes(), ".glb")
    assert mesh.vertices.dtype == np.float64
    np.testing.assert_allclose(mesh.vertices, [expected] * 3, rtol=1e-15)


def two_nodes(nodes: list[dict[str, Any]], roots: list[int] | None = None) -> bytes:
    """Return a file with the square as mesh 0 and these nodes. If `roots` is None, it has no scenes."""
    glb = glb_square()
    glb.root["nodes"] = nodes
    if roots is None:
        del glb.root["scene"], glb.root["scenes"]
    else:
        glb.root["scenes"] = [{"nodes": roots}]
    return glb.bytes()


@pytest.mark.parametrize("roots", [[0, 1], [1, 0], None])
def test_nodes_are_taken_in_ascending_order(read: Read, roots: list[int] | None) -> None:
    mesh = read(two_nodes([{"mesh": 0, "translation": [10, 0, 0]}, {"mesh": 0}], roots), ".glb")
    assert mesh.vertices.dtype == np.float64
    assert mesh.vertices.tolist() == MOVED + SQUARE
    assert mesh.faces.tolist() == SQUARE_FACES + SECOND


def test_only_the_default_scene_is_read(read: Read) -> None:
    glb = glb_square()
    glb.root["nodes"] = [{"mesh": 0, "translation": [10, 0, 0]}, {"mesh": 0}]
    glb.root["scenes"] = [{"nodes": [0]}, {"nodes": [1]}]
    assert read(glb.bytes(), ".glb").vertices.tolist() == MOVED
    glb.root["scene"] = 1
    mesh = read(glb.bytes(), ".glb")
    assert mesh.vertices.tolist() == SQUARE
    assert mesh.vertices.dtype == np.float32


HALF = 0.5**0.5


@pytest.mark.parametrize(
    ("node", "expected"),
    [
        ({"translation": [1, 2, 3]}, [2, 2, 3]),
        ({"scale": [2, 3, 4]}, [2, 0, 0]),
        ({"rotation": [0, 0, HALF, HALF]}, [0, 1, 0]),
        ({"rotation": [0, HALF, 0, HALF]}, [0, 0, -1]),
        ({"translation": [1, 2, 3], "rotation": [0, 0, HALF, HALF], "scale": [5, 1, 1]}, [1, 7, 3]),
        ({"matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 4, 5, 6, 1]}, [4, 6, 6]),
    ],
)
def test_transform_of_the_x_axis(read: Read, node: dict[str, Any], expected: list[float]) -> None:
    mesh = read(two_nodes([{"mesh": 0, **node}], [0]), ".glb")
    np.testing.assert_allclose(mesh.vertices[1], expected, atol=1e-15)


@pytest.mark.parametrize(
    ("node", "turned"),
    [
        ({"scale": [-1, 1, 1]}, True),
        ({"scale": [-1, -1, -1], "rotation": [0, HALF, 0, HALF]}, True),
        ({"scale": [0, 1, 1]}, False),
    ],
)
def test_mirrored_nodes_reverse_the_winding(read: Read, node: dict[str, Any], turned: bool) -> None:
    """Mirroring turns faces inside out, so the order of their corners must be reversed."""
    mesh = read(two_nodes([{"mesh": 0, **node}, {"mesh": 0}], [0, 1]), ".glb")
    first = [[a, c, b] for a, b, c in SQUARE_FACES] if turned else SQUARE_FACES
    assert mesh.faces.tolist() == first + SECOND


def test_the_identity_keeps_float32(read: Read) -> None:
    node = {"mesh": 0, "translation": [0, 0, 0], "matrix": np.eye(4).ravel().tolist()}
    assert read(two_nodes([node], [0]), ".glb").vertices.dtype == np.float32


@pytest.mark.parametrize(
    ("dtype", "values", "expected"),
    [
        ("u1", [255, 0, 7, 9], np.uint8([255, 0, 46, 9])),
        ("u1", [255, 0, 7], np.uint8([255, 0, 46])),
        ("u2", [65535, 0, 13107], np.float32([1, 0, 0.484529])),
        ("u2", [65535, 0, 14146], np.uint8([255, 0, 128])),
        ("f4", [1, 0.5, 0], np.float32([1, 0.735357, 0])),
        ("f4", [1.5, -0.5, 0, 1], np.uint8([255, 0, 0, 255])),
    ],
)
@pytest.mark.parametrize("normalized", [True, False])
def test_colors(read: Read, dtype: str, values: list[float], expected: np.ndarray, normalized: bool) -> None:
    glb = glb_square()
    color = glb.accessor([values] * 4, dtype, f"VEC{len(values)}", normalized=normalized)
    glb.root["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = color
    assert_colors(read(glb.bytes(), ".glb").vertex_colors, np.stack([expected] * 4))


def test_primitives_join_with_white_where_one_has_no_color(read: Read) -> None:
    glb = glb_square()
    position = glb.accessor(MOVED[:3], "f4", "VEC3")
    glb.primitive(position, attributes={"COLOR_0": glb.accessor([[0, 0.5, 1, 0.25]] * 3, "f4", "VEC4")})
    glb.primitive(position, attributes={"COLOR_0": glb.accessor([[255, 0, 51]] * 3, "u1", "VEC3")})
    mesh = read(glb.bytes(), ".glb")
    assert mesh.vertices.tolist() == SQUARE + MOVED[:3] * 2
    assert mesh.faces.tolist() == [*SQUARE_FACES, [4, 5, 6], [7, 8, 9]]
    expected = [[1, 1, 1, 1]] * 4 + [[0, 0.735357, 1, 0.25]] * 3 + [[1, 0, 124 / 255, 1]] * 3
    assert_colors(mesh.vertex_colors, np.float32(expected))


def test_an_index_outside_its_primitive_stays_outside_the_mesh(read: Read) -> None:
    glb = glb_square(indices=[0, 1, 2, 0, 2, 9])
    assert read(glb.bytes(), ".glb").faces.tolist() == [[0, 1, 2], [0, 2, 9]]
    glb.primitive(glb.accessor(MOVED * 3, "f4", "VEC3"))
    mesh = read(glb.bytes(), ".glb")
    # Index 9 is out of range in the first primitive, and must not refer to the second primitive.
    assert mesh.faces[1].tolist() == [0, 2, 9 - 4 + len(mesh.vertices)]


def test_an_empty_scene_is_an_empty_mesh(read: Read) -> None:
    glb = Glb()
    glb.root |= {"scenes": [{}], "meshes": [], "nodes": []}
    assert read(glb.bytes(), ".glb").vertices.shape == (0, 3)


def test_harmless_requirements_and_later_chunks(read: Read) -> None:
    glb = glb_square()
    glb.root["extensionsRequired"] = ["KHR_materials_unlit", "KHR_texture_transform"]
    content = bytearray(glb.bytes() + b"\4\0\0\0XTRAdata")
    content[8:12] = len(content).to_bytes(4, "little")
    assert read(bytes(content), ".glb").faces.tolist() == SQUARE_FACES


def test_too_many_nodes_are_rejected(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("msb.meshes.gltf.MAX_NODES", 0)
    (tmp_path / "nodes.glb").write_bytes(SMALL[".glb"])
    with pytest.raises(MeshFileError, match="MESH_FILE_TOO_LARGE"):
        read_mesh(tmp_path / "nodes.glb")


def test_transforms_multiply_from_the_root_down(read: Read) -> None:
    nodes = [
        {"translation": [1, 0, 0], "children": [1]},
        {"rotation": [0, 0, HALF, HALF], "children": [2]},
        {"scale": [3, 1, 1], "mesh": 0},
    ]
    np.testing.assert_allclose(read(two_nodes(nodes, [0]), ".glb").vertices[1], [1, 3, 0], atol=1e-15)


@pytest.mark.parametrize("is_sparse", [True, False])
def test_an_accessor_without_data_is_all_zeros(read: Read, is_sparse: bool) -> None:
    glb = glb_square()
    uvs = {"componentType": 5126, "type": "VEC2", "count": 4}
    if is_sparse:
        places = {"bufferView": glb.view(np.array([2], "<u2").tobytes()), "componentType": 5123}
        values = {"bufferView": glb.view(np.array([[0.5, 1]], "<f4").tobytes())}
        uvs["sparse"] = {"count": 1, "indices": places, "values": values}
    glb.root["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = glb.add("accessors", **uvs)
    mesh = read(glb.bytes(), ".glb")
    expected = [[0, 0], [0, 0], [0.5, 1] if is_sparse else [0, 0], [0, 0]]
    assert mesh.vertex_uvs is not None
    assert (mesh.vertices.tolist(), mesh.vertex_uvs.tolist()) == (SQUARE, expected)


def test_a_huge_accessor_without_data_is_rejected(read: Read) -> None:
    glb = glb_square()
    glb.root["accessors"][0] = {"componentType": 5126, "type": "VEC3", "count": 10**12}
    with pytest.raises(MeshFileError, match="MESH_FILE_TOO_LARGE"):
        read(glb.bytes(), ".glb")


HIDDEN = {"extensions": {"KHR_node_visibility": {"visible": False}}}


def test_hidden_nodes_and_their_children_are_left_out(read: Read) -> None:
    nodes = [{"mesh": 0}, HIDDEN | {"children": [2]}, {"mesh": 0}]
    mesh = read(two_nodes(nodes, [0, 1]), ".glb")
    assert (mesh.faces.tolist(), len(mesh.left_out)) == (SQUARE_FACES, 1)


def test_a_file_with_hidden_meshes_only_is_rejected(read: Read) -> None:
    with pytest.raises(MeshFileError, match="MESH_FILE_INVALID"):
        read(two_nodes([HIDDEN | {"mesh": 0}], [0]), ".glb")


@pytest.mark.parametrize(("table", "is_read"), [("materials", True), ("meshes", False), ("", False)])
def test_unknown_requirements_are_harmless_in_materials_only(read: Read, table: str, is_read: bool) -> None:
    glb = glb_square()
    glb.material()
    owner = glb.root[table][0] if table else glb.root
    owner["extensions"] = {"EXT_unknown": {}}
    glb.root["extensionsRequired"] = ["EXT_unknown"]
    if is_read:
        assert read(glb.bytes(), ".glb").left_out == ("EXT_unknown",)
        return
    with pytest.raises(MeshFileError, match="MESH_FILE_UNSUPPORTED"):
        read(glb.bytes(), ".glb")

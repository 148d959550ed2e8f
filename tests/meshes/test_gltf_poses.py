"""Read glTF meshes in their stored pose: skins with joints, and morph targets with weights."""

from typing import Any

import numpy as np
import pytest

from .builders import SQUARE, SQUARE_FACES, Glb, Read, glb_square

ROWS = np.array(SQUARE)
SCALE = {"scale": [100, 100, 100]}


def glb_skinned(weights: Any = None, inverse: Any = None, dtype: str = "f4") -> Glb:
    """Return the square on two joints, below a node whose scale must not apply.

    Joint 1 is a child of joint 0. `weights` (4, 2) are the weights of the two joints. By default joint 0 has
    all the weight.
    """
    glb = glb_square()
    shares = np.zeros((4, 4))
    shares[:, :2] = [[1, 0]] * 4 if weights is None else weights
    top = {"f4": 1, "u1": 255, "u2": 65535}[dtype]
    attributes = glb.root["meshes"][0]["primitives"][0]["attributes"]
    attributes["JOINTS_0"] = glb.accessor([[0, 1, 0, 0]] * 4, "u1", "VEC4")
    attributes["WEIGHTS_0"] = glb.accessor(
        np.rint(shares * top) if top > 1 else shares, dtype, "VEC4", normalized=top > 1
    )
    glb.root["nodes"] = [{"mesh": 0, "skin": 0, **SCALE}, {"children": [2]}, {}]
    glb.root["scenes"][0]["nodes"] = [0, 1]
    skin: dict[str, Any] = {"joints": [1, 2]}
    if inverse is not None:
        columns = np.swapaxes(inverse, 1, 2).reshape(-1, 16)
        skin["inverseBindMatrices"] = glb.accessor(columns, "f4", "MAT4")
    glb.root["skins"] = [skin]
    return glb


def moved(x: float) -> np.ndarray:
    """Return the matrix of a translation along x."""
    matrix = np.eye(4)
    matrix[0, 3] = x
    return matrix


def test_the_node_of_a_skinned_mesh_has_no_effect(read: Read) -> None:
    mesh = read(glb_skinned().bytes(), ".glb")
    assert mesh.vertices.tolist() == SQUARE
    assert mesh.vertices.dtype == np.float32
    assert len(mesh.left_out) == 1


@pytest.mark.parametrize("dtype", ["f4", "u1", "u2"])
def test_joints_move_vertices_by_their_weights(read: Read, dtype: str) -> None:
    glb = glb_skinned([[1, 0], [1, 0], [0, 1], [0.6, 0.4]], dtype=dtype)
    glb.root["nodes"][1]["translation"] = [1, 0, 0]
    glb.root["nodes"][2]["translation"] = [0, 5, 0]
    shift = np.array([[1, 0, 0], [1, 0, 0], [1, 5, 0], [1, 2, 0]])
    np.testing.assert_allclose(read(glb.bytes(), ".glb").vertices, ROWS + shift, atol=1e-4)


def test_inverse_bind_matrices_come_before_the_joints(read: Read) -> None:
    glb = glb_skinned(inverse=np.stack([moved(-2), moved(-2)]))
    glb.root["nodes"][1] |= {"translation": [2, 0, 0], "scale": [3, 1, 1]}
    expected = ROWS * (3, 1, 1) - (4, 0, 0)
    np.testing.assert_allclose(read(glb.bytes(), ".glb").vertices, expected, atol=1e-6)


def test_weights_need_not_add_up_to_one(read: Read) -> None:
    glb = glb_skinned([[2, 2], [0, 0], [0, 0.5], [1, 0]])
    glb.root["nodes"][2]["translation"] = [0, 0, 6]
    assert read(glb.bytes(), ".glb").vertices[:, 2].tolist() == [3, 0, 6, 0]


def test_a_mirroring_skin_turns_the_faces(read: Read) -> None:
    glb = glb_skinned()
    glb.root["nodes"][1]["scale"] = [-1, 1, 1]
    assert read(glb.bytes(), ".glb").faces.tolist() == [[a, c, b] for a, b, c in SQUARE_FACES]


@pytest.mark.parametrize(
    "change",
    [{"joints": [0, 9]}, {"joints": []}, {"joints": [3, 3]}, {"inverseBindMatrices": 0}, {"joints": [1]}],
)
def test_a_skin_that_cannot_be_read_leaves_the_mesh_as_stored(read: Read, change: dict[str, Any]) -> None:
    glb = glb_skinned([[0, 1]] * 4)
    glb.root["nodes"].append({})  # outside the scene
    glb.root["skins"][0] |= change
    mesh = read(glb.bytes(), ".glb")
    assert mesh.vertices.tolist() == SQUARE
    assert len(mesh.left_out) == 2


@pytest.mark.parametrize("owner", ["nodes", "meshes"])
def test_morph_targets_are_added_with_their_weights(read: Read, owner: str) -> None:
    glb = glb_square()
    up = glb.accessor([[0, 0, 2]] * 4, "f4", "VEC3")
    nothing = glb.add("accessors", componentType=5126, type="VEC3", count=4)
    targets = [{"POSITION": up}, {"POSITION": nothing}, {"NORMAL": up}]
    glb.root["meshes"][0]["primitives"][0]["targets"] = targets
    glb.root["meshes"][0]["weights"] = [0, 0, 0]
    assert read(glb.bytes(), ".glb").vertices.tolist() == SQUARE
    glb.root[owner][0]["weights"] = [0.5, 1, 1]
    assert read(glb.bytes(), ".glb").vertices.tolist() == np.add(ROWS, (0, 0, 1)).tolist()
    glb.root["accessors"][up]["count"] = 3
    mesh = read(glb.bytes(), ".glb")
    assert (mesh.vertices.tolist(), len(mesh.left_out)) == (SQUARE, 2)

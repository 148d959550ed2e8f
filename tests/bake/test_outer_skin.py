"""The outer skin makes an interior a solid, and leaves its inner side as it is."""

import numpy as np
import pytest

import msb
from data_stubs.surface import icosphere
from msb.bake.outer_skin import add_outer_skin, is_interior
from msb.meshes.assets import asset_from_mesh
from msb.meshes.mesh import Mesh
from msb.topology.crossings import find_crossing_pairs
from msb.topology.faces import signed_volume
from tests.bake.test_fairing import box


def room(kind: str) -> Mesh:
    """Return a closed surface that is wound inwards."""
    if kind == "box":  # its two far ends are large faces, seen at wide angles
        points, faces = box(1)
        points = points * (12, 2, 1)
    else:
        points, faces = icosphere(6)
        if kind == "star":
            points = points * (1 + 0.4 * np.sin(5 * points[:, :1]) * np.cos(4 * points[:, 1:2]))
        if kind == "far":
            points = 1e-2 * points + 3
    return Mesh(points.astype(np.float32), faces[:, ::-1].astype(np.int64))


@pytest.mark.parametrize("kind", ["box", "ball", "star", "far"])
@pytest.mark.parametrize("thickness", [0.01, 0.3])
def test_a_room_becomes_a_solid(kind: str, thickness: float) -> None:
    inner = room(kind)
    assert is_interior(inner)
    solid = add_outer_skin(inner, thickness)
    np.testing.assert_array_equal(solid.vertices[: len(inner.vertices)], inner.vertices)
    np.testing.assert_array_equal(solid.faces[: len(inner.faces)], inner.faces)
    assert signed_volume(solid.vertices, solid.faces) > 0
    assert not is_interior(solid)
    assert not len(find_crossing_pairs(solid.vertices[solid.faces].astype(np.float64)))
    assert msb.audit(asset_from_mesh(solid)).verdict == "ok"


def test_an_object_is_no_interior() -> None:
    points, faces = icosphere(2)
    assert not is_interior(Mesh(points.astype(np.float32), faces.astype(np.int64)))
    assert not is_interior(Mesh(points.astype(np.float32), faces[:-1, ::-1].astype(np.int64)))


def test_the_skin_has_a_colour() -> None:
    inner = room("ball")
    colored = Mesh(inner.vertices, inner.faces, np.zeros((len(inner.vertices), 3), np.uint8))
    assert (add_outer_skin(colored, 0.1).vertex_colors[len(inner.vertices) :] == 128).all()
    uvs = np.random.default_rng(1).random((3 * len(inner.faces), 2)).astype(np.float32)
    textured = Mesh(inner.vertices, inner.faces, corner_uvs=uvs, textures=(np.zeros((4, 4, 3), np.uint8),))
    skin = add_outer_skin(textured, 0.1).corner_uvs[len(uvs) :]
    assert (skin == uvs[0]).all()

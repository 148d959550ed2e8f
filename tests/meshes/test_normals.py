"""Smooth normals: creases stay, seams vanish, and files store them."""

import io
import json
import struct
from typing import Any

import numpy as np
import pytest

from data_stubs.surface import icosphere
from msb.meshes.assets import fit_to_format
from msb.meshes.files import write_mesh
from msb.meshes.formats import Style
from msb.meshes.mesh import Mesh
from msb.meshes.normals import vertex_normals, with_smooth_normals

CUBE = Mesh(
    np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32),
    np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
         [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], np.int64
    ),
)  # fmt: skip


def ball() -> Mesh:
    points, faces = icosphere(6)
    return Mesh(points.astype(np.float32), faces.astype(np.int64))


def test_the_normals_of_a_ball_point_outwards() -> None:
    mesh = with_smooth_normals(ball())
    assert mesh.corner_normals is not None
    cosine = (mesh.corner_normals * mesh.vertices[mesh.faces.reshape(-1)]).sum(axis=1)
    assert cosine.min() > 0.999


def test_a_cube_keeps_its_creases() -> None:
    mesh = with_smooth_normals(CUBE)
    corners = CUBE.vertices[CUBE.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_array_equal(mesh.corner_normals, np.repeat(flat, 3, axis=0))


def test_doubled_vertices_of_a_seam_have_one_normal() -> None:
    whole = ball()
    soup = Mesh(whole.vertices[whole.faces].reshape(-1, 3), np.arange(3 * len(whole.faces)).reshape(-1, 3))
    np.testing.assert_array_equal(
        with_smooth_normals(soup).corner_normals, with_smooth_normals(whole).corner_normals
    )


def test_faces_without_area_do_not_count() -> None:
    faces = np.concatenate([ball().faces, [[0, 0, 1]]])
    mesh = with_smooth_normals(Mesh(ball().vertices, faces))
    assert mesh.corner_normals is not None
    np.testing.assert_array_equal(mesh.corner_normals[:-3], with_smooth_normals(ball()).corner_normals)
    assert np.isfinite(mesh.corner_normals).all()


def read_glb(content: bytes) -> tuple[dict[str, Any], bytes]:
    length = struct.unpack_from("<I", content, 12)[0]
    return json.loads(content[20 : 20 + length]), content[28 + length :]


@pytest.mark.parametrize("is_lit", [False, True])
def test_a_glb_stores_normals_and_the_kind_of_material(is_lit: bool) -> None:
    stream = io.BytesIO()
    mesh = with_smooth_normals(fit_to_format(CUBE, ".glb"))
    write_mesh(mesh, stream, suffix=".glb", style=Style(is_lit=is_lit))
    root, binary = read_glb(stream.getvalue())
    (primitive,) = root["meshes"][0]["primitives"]
    accessor = root["accessors"][primitive["attributes"]["NORMAL"]]
    view = root["bufferViews"][accessor["bufferView"]]
    rows = np.frombuffer(binary, np.float32, 3 * accessor["count"], view["byteOffset"]).reshape(-1, 3)
    assert accessor["count"] == 24  # a vertex of a cube has three normals
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 1)
    material = root["materials"][primitive["material"]]
    assert ("KHR_materials_unlit" in material.get("extensions", {})) == (not is_lit)
    assert ("extensionsUsed" in root) == (not is_lit)


def test_an_obj_stores_normals_of_corners() -> None:
    stream = io.BytesIO()
    write_mesh(with_smooth_normals(CUBE), stream, suffix=".obj")
    lines = stream.getvalue().decode().splitlines()
    normals = np.array([line.split()[1:] for line in lines if line.startswith("vn ")], float)
    first = next(line for line in lines if line.startswith("f ")).split()[1:]
    numbers = [int(corner.split("//")[1]) for corner in first]
    np.testing.assert_array_equal(normals[np.array(numbers) - 1], [[-1, 0, 0]] * 3)


def test_normals_follow_their_vertices() -> None:
    mesh = with_smooth_normals(fit_to_format(ball(), ".glb"))
    normals = vertex_normals(mesh)
    np.testing.assert_allclose(normals, mesh.vertices, atol=0.02)

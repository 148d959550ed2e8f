"""Compressed glTF gives the same mesh as uncompressed glTF. Damaged data gives clear errors."""

from typing import Any

import numpy as np
import pytest

import msb
from fuzz.readers import run_here
from msb.errors import MeshFileError, UsageError
from msb.meshes import Mesh
from msb.topology import audit_arrays
from tests.topology.seamed import CUBE

from .builders import TEXELS, Glb, Read, picture

meshopt = pytest.importorskip("meshopt", reason="the extra compressed")
DracoPy = pytest.importorskip("DracoPy", reason="the extra compressed")


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Decode in this process instead of a child process, which is faster."""
    monkeypatch.setattr("msb.meshes.gltf_packed.run_in_child", run_here)


def bumpy(size: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the positions (multiples of 1/4096), faces, UVs and colours of a bent grid.

    It has a hole and a face of opposite winding.
    """
    row, column = np.mgrid[:size, :size].reshape(2, -1)
    height = np.random.default_rng(0).integers(0, 900, len(row))
    points = np.stack((row * 300, column * 300, height), axis=1).astype(np.float32) / 4096
    corner = np.arange(size * size).reshape(size, size)
    quads = np.stack((corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]), axis=-1).reshape(
        -1, 4
    )
    faces = np.concatenate((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]))
    faces[7] = faces[7, ::-1]
    faces = np.delete(faces, [30, 31, 90], axis=0).astype(np.uint32)
    uvs = (np.stack((column, row), axis=1) / size).astype(np.float32)
    colors = np.random.default_rng(1).integers(0, 256, (len(points), 4)).astype(np.uint8)
    return points, faces, uvs, colors


def plain(quantized: bool = False) -> Glb:
    """Return the textured mesh without compression, optionally with 16-bit positions and a node scale."""
    points, faces, uvs, colors = bumpy()
    glb = Glb()
    if quantized:
        padded = np.zeros((len(points), 4), np.uint16)
        padded[:, :3] = np.rint(points * 4096)
        position = glb.accessor(padded, "u2", "VEC3")
        glb.root["bufferViews"][-1]["byteStride"] = 8
        glb.root["nodes"][0]["scale"] = [1 / 4096] * 3
        glb.root["extensionsRequired"] = ["KHR_mesh_quantization"]
    else:
        position = glb.accessor(points, "f4", "VEC3")
    attributes = {
        "TEXCOORD_0": glb.accessor(uvs, "f4", "VEC2"),
        "COLOR_0": glb.accessor(colors, "u1", "VEC4", normalized=True),
    }
    glb.primitive(position, glb.accessor(faces.reshape(-1), "u4", "SCALAR"), attributes=attributes)
    glb.material(picture())
    return glb


def by_meshopt(glb: Glb, name: str = "EXT_meshopt_compression") -> Glb:
    """Return the file with all arrays compressed by meshopt, without uncompressed copies."""
    arrays, views, binary = glb.root["accessors"], glb.root["bufferViews"], glb.binary
    glb.binary = b""
    packed: list[dict[str, Any]] = []
    for number, view in enumerate(views):
        data = binary[view["byteOffset"] :][: view["byteLength"]]
        entry = next((item for item in arrays if item.get("bufferView") == number), None)
        if entry is None:
            packed.append(view | {"byteOffset": len(glb.binary)})
            glb.binary += data + b"\0" * (-len(data) % 4)
            continue
        stride = len(data) // entry["count"]
        mode = "TRIANGLES" if entry["type"] == "SCALAR" else "ATTRIBUTES"
        given = np.frombuffer(data, np.uint32 if mode == "TRIANGLES" else np.uint8)
        content = meshopt.encode_gltf_buffer(
            given if mode == "TRIANGLES" else given.reshape(-1, stride), mode
        )
        about = {"buffer": 0, "byteOffset": len(glb.binary), "byteLength": len(content)}
        about |= {"byteStride": stride, "count": entry["count"], "mode": mode}
        packed.append(view | {"buffer": 1, "extensions": {name: about}})
        glb.binary += content + b"\0" * (-len(content) % 4)
    glb.root["bufferViews"] = packed
    glb.root["buffers"] = [{"byteLength": len(glb.binary)}, {"byteLength": len(binary)}]
    glb.root["extensionsRequired"] = [*glb.root.get("extensionsRequired", []), name]
    return glb


def by_draco() -> Glb:
    """Return the mesh as a Draco primitive in the same order. The grid represents its positions exactly."""
    glb = plain()
    points, faces, uvs, colors = bumpy()
    content = DracoPy.encode(
        points, faces, quantization_bits=16, quantization_range=15.99975586, quantization_origin=[0, 0, 0],
        preserve_order=True, colors=colors, tex_coord=uvs.astype(np.float64),
    )  # fmt: skip
    ids = {entry["attribute_type"]: entry["unique_id"] for entry in DracoPy.decode(content).attributes}
    view = glb.view(content)
    for entry in glb.root["accessors"]:
        del entry["bufferView"]
    attributes = {"POSITION": ids[0], "COLOR_0": ids[2], "TEXCOORD_0": ids[3]}
    about = {"KHR_draco_mesh_compression": {"bufferView": view, "attributes": attributes}}
    glb.root["meshes"][0]["primitives"][0]["extensions"] = about
    glb.root["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return glb


def hard_cube() -> tuple[Glb, np.ndarray, np.ndarray, np.ndarray]:
    """Return a cube of 24 vertices whose normals differ at its edges: a GLB, positions, normals and faces."""
    points, corners = CUBE[0][CUBE[1]], CUBE[0][CUBE[1]].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    rows = np.concatenate([points.reshape(-1, 3), np.repeat(normals, 3, axis=0)], axis=1)
    rows, number = np.unique(rows.astype(np.float32), axis=0, return_inverse=True)
    faces = number.reshape(-1, 3).astype(np.uint32)
    glb = Glb()
    position, normal = (glb.accessor(rows[:, place], "f4", "VEC3") for place in (slice(3), slice(3, 6)))
    attributes = {"NORMAL": normal}
    glb.primitive(position, glb.accessor(faces.reshape(-1), "u4", "SCALAR"), attributes=attributes)
    return glb, rows[:, :3], rows[:, 3:], faces


def pack_hard_cube(lost: bool = False) -> Glb:
    """Return the cube as a Draco primitive. If `lost`, its normals have a wrong number."""
    glb, points, normals, faces = hard_cube()
    content = DracoPy.encode(
        points, faces, quantization_bits=8, preserve_order=True, normals=normals.astype(np.float64)
    )
    ids = {entry["attribute_type"]: entry["unique_id"] for entry in DracoPy.decode(content).attributes}
    view = glb.view(content)
    for entry in glb.root["accessors"]:
        del entry["bufferView"]
    attributes = {"POSITION": ids[0], "NORMAL": 99 if lost else ids[1]}
    about = {"KHR_draco_mesh_compression": {"bufferView": view, "attributes": attributes}}
    glb.root["meshes"][0]["primitives"][0]["extensions"] = about
    glb.root["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return glb


@pytest.mark.usefixtures("here")
def test_compressed_normals_explain_duplicated_vertices(read: Read) -> None:
    damaged = by_meshopt(hard_cube()[0])
    view = damaged.root["bufferViews"][1]["extensions"]["EXT_meshopt_compression"]
    start, size = view["byteOffset"], view["byteLength"]
    damaged.binary = damaged.binary[:start] + b"\7" * size + damaged.binary[start + size :]
    for glb, verdict in (
        (pack_hard_cube(), "ok"),
        (by_meshopt(hard_cube()[0]), "ok"),
        # Normals that cannot be decoded do not reject the mesh.
        (pack_hard_cube(lost=True), "limited"),
        (damaged, "limited"),
    ):
        mesh = read(glb.bytes(), ".glb")
        assert len(mesh.vertices) == 24
        assert audit_arrays(mesh.vertices, mesh.faces, attributes=mesh.attributes)[0].verdict == verdict


def rotate_to_smallest(faces: np.ndarray) -> np.ndarray:
    """Return the faces, each rotated to begin with its smallest index, because meshopt may rotate faces."""
    first = faces.argmin(axis=1)
    return np.take_along_axis(faces, (first[:, None] + [0, 1, 2]) % 3, axis=1)


def assert_same(mesh: Mesh, expected: Mesh) -> None:
    assert rotate_to_smallest(mesh.faces).tolist() == rotate_to_smallest(expected.faces).tolist()
    np.testing.assert_allclose(mesh.vertices, expected.vertices, atol=2e-4)
    np.testing.assert_allclose(mesh.vertex_uvs, expected.vertex_uvs, atol=1e-6)
    assert mesh.vertex_colors is not None
    assert expected.vertex_colors is not None
    assert mesh.vertex_colors.tolist() == expected.vertex_colors.tolist()
    assert np.array_equal(mesh.textures[0], TEXELS)
    assert mesh.left_out == ()


@pytest.mark.slow
def test_compressed_files_hold_the_same_mesh_and_have_the_same_counts(read: Read) -> None:
    files = {
        "plain": plain(),
        "quantized": plain(quantized=True),
        "meshopt": by_meshopt(plain()),
        "quantized, meshopt": by_meshopt(plain(quantized=True), "KHR_meshopt_compression"),
        "draco": by_draco(),
    }
    wanted = read(files["plain"].bytes(), ".glb")
    counts = {}
    for name, glb in files.items():
        mesh = read(glb.bytes(), ".glb")
        assert_same(mesh, wanted)
        counts[name] = msb.audit(mesh.vertices, mesh.faces).counts
    assert all(count == counts["plain"] for count in counts.values()), counts
    assert counts["plain"].boundary_edges


def test_uncompressed_copies_are_preferred(
    read: Read, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    glb = by_meshopt(plain())
    (tmp_path / "copy.bin").write_bytes(plain().binary)
    glb.root["buffers"][1]["uri"] = "copy.bin"
    for number, view in enumerate(plain().root["bufferViews"][:4]):
        glb.root["bufferViews"][number]["byteOffset"] = view["byteOffset"]
    monkeypatch.setattr("msb.meshes.gltf_packed.run_in_child", None)
    assert_same(read(glb.bytes(), ".glb"), read(plain().bytes(), ".glb"))


def test_a_missing_extra_is_reported(read: Read, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("msb.base.extras.is_installed", lambda name: False)
    with pytest.raises(UsageError, match=r"EXTRA_MISSING: .*meshopt"):
        read(by_meshopt(plain()).bytes(), ".glb")
    with pytest.raises(UsageError, match=r"EXTRA_MISSING: .*DracoPy"):
        read(by_draco().bytes(), ".glb")


@pytest.mark.usefixtures("here")
def test_damaged_compressed_data_gives_a_one_line_error(read: Read) -> None:
    damaged = by_meshopt(plain())
    damaged.binary = b"\7" * len(damaged.binary)
    short, other = by_draco(), by_draco()
    short.root["bufferViews"][-1]["byteLength"] -= 400
    other.root["accessors"][0]["count"] -= 1
    for glb, place in (
        (damaged, "/bufferViews/"),
        (short, "/meshes/0/primitives/0"),
        (other, "/meshes/0/primitives/0"),
    ):
        with pytest.raises(MeshFileError, match=f"MESH_FILE_INVALID: .*{place}") as caught:
            read(glb.bytes(), ".glb")
        assert str(caught.value).isprintable()


@pytest.mark.usefixtures("here")
def test_draco_integers_are_converted_to_the_accessor_type(read: Read) -> None:
    glb = by_draco()
    points, faces, _, colors = bumpy()
    content = DracoPy.encode(
        points, faces, preserve_order=True, generic_attributes={7: colors.astype(np.uint32) * 257}
    )
    ids = {entry["attribute_type"]: entry["unique_id"] for entry in DracoPy.decode(content).attributes}
    glb.root["accessors"][2] |= {"componentType": 5123}
    about = glb.root["meshes"][0]["primitives"][0]
    about["extensions"]["KHR_draco_mesh_compression"] = {
        "bufferView": glb.view(content),
        "attributes": {"POSITION": ids[0], "COLOR_0": ids[4]},
    }
    del about["attributes"]["TEXCOORD_0"]
    mesh, wanted = read(glb.bytes(), ".glb"), read(plain().bytes(), ".glb")
    assert (mesh.vertex_colors is None, wanted.vertex_colors is None) == (False, False)
    np.testing.assert_allclose(mesh.vertex_colors, wanted.vertex_colors, atol=1e-6)

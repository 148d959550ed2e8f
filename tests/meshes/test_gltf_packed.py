"""Compressed glTF: the same mesh as without compression, and one clear line of what cannot be decoded."""

from typing import Any

import numpy as np
import pytest

import msb
from fuzz.readers import run_here
from msb.errors import MeshFileError, UsageError
from msb.meshes import Mesh

from .builders import TEXELS, Glb, Read, picture

meshopt = pytest.importorskip("meshopt", reason="the extra compressed")
DracoPy = pytest.importorskip("DracoPy", reason="the extra compressed")


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Decode in this process, which takes less time."""
    monkeypatch.setattr("msb.meshes.gltf_packed.run_apart", run_here)


def bumpy(size: int = 12) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a bent grid with a hole and a flipped face: positions in 1/4096, faces, UVs and colours."""
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
    """Return the mesh as it is, with a texture; or its positions in 16 bits, which a node brings back."""
    points, faces, uvs, colors = bumpy()
    made = Glb()
    if quantized:
        padded = np.zeros((len(points), 4), np.uint16)
        padded[:, :3] = np.rint(points * 4096)
        position = made.accessor(padded, "u2", "VEC3")
        made.root["bufferViews"][-1]["byteStride"] = 8
        made.root["nodes"][0]["scale"] = [1 / 4096] * 3
        made.root["extensionsRequired"] = ["KHR_mesh_quantization"]
    else:
        position = made.accessor(points, "f4", "VEC3")
    attributes = {
        "TEXCOORD_0": made.accessor(uvs, "f4", "VEC2"),
        "COLOR_0": made.accessor(colors, "u1", "VEC4", normalized=True),
    }
    made.primitive(position, made.accessor(faces.reshape(-1), "u4", "SCALAR"), attributes=attributes)
    made.material(picture())
    return made


def by_meshopt(made: Glb, name: str = "EXT_meshopt_compression") -> Glb:
    """Return the file with every view of an array compressed, and no other copy of it."""
    arrays, views, binary = made.root["accessors"], made.root["bufferViews"], made.binary
    made.binary = b""
    packed: list[dict[str, Any]] = []
    for number, view in enumerate(views):
        data = binary[view["byteOffset"] :][: view["byteLength"]]
        entry = next((each for each in arrays if each.get("bufferView") == number), None)
        if entry is None:
            packed.append(view | {"byteOffset": len(made.binary)})
            made.binary += data + b"\0" * (-len(data) % 4)
            continue
        stride = len(data) // entry["count"]
        mode = "TRIANGLES" if entry["type"] == "SCALAR" else "ATTRIBUTES"
        given = np.frombuffer(data, np.uint32 if mode == "TRIANGLES" else np.uint8)
        content = meshopt.encode_gltf_buffer(
            given if mode == "TRIANGLES" else given.reshape(-1, stride), mode
        )
        about = {"buffer": 0, "byteOffset": len(made.binary), "byteLength": len(content)}
        about |= {"byteStride": stride, "count": entry["count"], "mode": mode}
        packed.append(view | {"buffer": 1, "extensions": {name: about}})
        made.binary += content + b"\0" * (-len(content) % 4)
    made.root["bufferViews"] = packed
    made.root["buffers"] = [{"byteLength": len(made.binary)}, {"byteLength": len(binary)}]
    made.root["extensionsRequired"] = [*made.root.get("extensionsRequired", []), name]
    return made


def by_draco() -> Glb:
    """Return the file with its primitive compressed, in the order that it has, on a grid that holds it."""
    made = plain()
    points, faces, uvs, colors = bumpy()
    content = DracoPy.encode(
        points, faces, quantization_bits=16, quantization_range=15.99975586, quantization_origin=[0, 0, 0],
        preserve_order=True, colors=colors, tex_coord=uvs.astype(np.float64),
    )  # fmt: skip
    ids = {each["attribute_type"]: each["unique_id"] for each in DracoPy.decode(content).attributes}
    view = made.view(content)
    for entry in made.root["accessors"]:
        del entry["bufferView"]
    attributes = {"POSITION": ids[0], "COLOR_0": ids[2], "TEXCOORD_0": ids[3]}
    about = {"KHR_draco_mesh_compression": {"bufferView": view, "attributes": attributes}}
    made.root["meshes"][0]["primitives"][0]["extensions"] = about
    made.root["extensionsRequired"] = ["KHR_draco_mesh_compression"]
    return made


def turned(faces: np.ndarray) -> np.ndarray:
    """Return faces that begin with their least vertex: meshopt keeps their order and their side only."""
    first = faces.argmin(axis=1)
    return np.take_along_axis(faces, (first[:, None] + [0, 1, 2]) % 3, axis=1)


def assert_same(found: Mesh, wanted: Mesh) -> None:
    assert turned(found.faces).tolist() == turned(wanted.faces).tolist()
    np.testing.assert_allclose(found.vertices, wanted.vertices, atol=2e-4)
    np.testing.assert_allclose(found.vertex_uvs, wanted.vertex_uvs, atol=1e-6)
    assert found.vertex_colors is not None
    assert wanted.vertex_colors is not None
    assert found.vertex_colors.tolist() == wanted.vertex_colors.tolist()
    assert np.array_equal(found.textures[0], TEXELS)
    assert found.left_out == ()


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
    for name, made in files.items():
        mesh = read(made.bytes(), ".glb")
        assert_same(mesh, wanted)
        counts[name] = msb.audit(mesh.vertices, mesh.faces).counts
    assert all(each == counts["plain"] for each in counts.values()), counts
    assert counts["plain"].boundary_edges


def test_where_there_is_an_uncompressed_copy_it_is_read(
    read: Read, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = by_meshopt(plain())
    (tmp_path / "copy.bin").write_bytes(plain().binary)
    made.root["buffers"][1]["uri"] = "copy.bin"
    for number, view in enumerate(plain().root["bufferViews"][:4]):
        made.root["bufferViews"][number]["byteOffset"] = view["byteOffset"]
    monkeypatch.setattr("msb.meshes.gltf_packed.run_apart", None)
    assert_same(read(made.bytes(), ".glb"), read(plain().bytes(), ".glb"))


def test_the_extra_is_named_where_it_is_missing(read: Read, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("msb.base.extras.is_installed", lambda name: False)
    with pytest.raises(UsageError, match=r"EXTRA_MISSING: .*meshopt"):
        read(by_meshopt(plain()).bytes(), ".glb")
    with pytest.raises(UsageError, match=r"EXTRA_MISSING: .*DracoPy"):
        read(by_draco().bytes(), ".glb")


@pytest.mark.usefixtures("here")
def test_what_cannot_be_decoded_is_one_line(read: Read) -> None:
    damaged = by_meshopt(plain())
    damaged.binary = b"\7" * len(damaged.binary)
    short, other = by_draco(), by_draco()
    short.root["bufferViews"][-1]["byteLength"] -= 400
    other.root["accessors"][0]["count"] -= 1
    for made, place in (
        (damaged, "/bufferViews/"),
        (short, "/meshes/0/primitives/0"),
        (other, "/meshes/0/primitives/0"),
    ):
        with pytest.raises(MeshFileError, match=f"MESH_FILE_INVALID: .*{place}") as caught:
            read(made.bytes(), ".glb")
        assert str(caught.value).isprintable()


@pytest.mark.usefixtures("here")
def test_integers_that_draco_stores_wider_are_what_their_accessor_says(read: Read) -> None:
    made = by_draco()
    points, faces, _, colors = bumpy()
    content = DracoPy.encode(
        points, faces, preserve_order=True, generic_attributes={7: colors.astype(np.uint32) * 257}
    )
    ids = {each["attribute_type"]: each["unique_id"] for each in DracoPy.decode(content).attributes}
    made.root["accessors"][2] |= {"componentType": 5123}
    about = made.root["meshes"][0]["primitives"][0]
    about["extensions"]["KHR_draco_mesh_compression"] = {
        "bufferView": made.view(content),
        "attributes": {"POSITION": ids[0], "COLOR_0": ids[4]},
    }
    del about["attributes"]["TEXCOORD_0"]
    mesh, wanted = read(made.bytes(), ".glb"), read(plain().bytes(), ".glb")
    assert (mesh.vertex_colors is None, wanted.vertex_colors is None) == (False, False)
    np.testing.assert_allclose(mesh.vertex_colors, wanted.vertex_colors, atol=1e-6)

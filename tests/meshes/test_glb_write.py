"""Write GLB files: linear colours, textures, and as few vertices as possible."""

import io
import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from msb.asset.texture import Sampler, linear_to_srgb
from msb.meshes import Mesh, read_mesh, write_mesh
from msb.meshes.charts import with_vertex_uvs
from msb.meshes.formats import Style

from .checks import equal

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [5, 5, 5], [2, 0, 0]], np.float32)
FACES = np.array([[0, 1, 2], [2, 1, 3], [1, 5, 3]])
"""Two triangles of a chart, and a third triangle that meets them at vertices 1 and 3. Vertex 4 is unused."""
UVS = np.array([[0, 1], [1, 1], [0, 0], [0, 0], [1, 1], [1, 0], [0, 0.5], [1, 0.5], [1, 0]], np.float32)
IMAGES = tuple(
    np.random.default_rng(channels).integers(0, 256, (4, 8, channels), np.uint8) for channels in (3, 4)
)


def file(mesh: Mesh, **style: Any) -> bytes:
    stream = io.BytesIO()
    write_mesh(mesh, stream, suffix=".glb", style=Style(**style))
    return stream.getvalue()


def opened(content: bytes) -> tuple[dict[str, Any], bytes]:
    """Return the JSON and the binary chunk of a GLB."""
    (size,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + size]), content[28 + size :]


def values(content: bytes, number: int) -> NDArray[Any]:
    """Return the elements of an accessor."""
    root, binary = opened(content)
    accessor = root["accessors"][number]
    view = root["bufferViews"][accessor["bufferView"]]
    kind = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}[accessor["componentType"]]
    width = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    start = view["byteOffset"] + accessor.get("byteOffset", 0)
    count = accessor["count"] * width
    return np.frombuffer(binary, kind, count, start).reshape(-1, width)


def colors_of(mesh: Mesh, **style: Any) -> NDArray[Any]:
    content = file(mesh, **style)
    return values(content, opened(content)[0]["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"])


@pytest.mark.parametrize("darkest", [0, 140])
def test_colors_are_linear_in_the_smallest_sufficient_type(tmp_path: Path, darkest: int) -> None:
    grey = np.arange(darkest, 256, dtype=np.uint8)
    points = np.zeros((len(grey), 3), np.float32)
    for colors in (grey[:, None].repeat(3, 1), (grey[:, None].repeat(3, 1) / 255.3).astype(np.float32)):
        stored = colors_of(Mesh(points, FACES, colors))
        assert stored.dtype == (np.uint16 if darkest == 0 else np.uint8)
        assert stored.shape[1] == 4
        top = np.iinfo(stored.dtype).max
        assert (stored[:, 3] == top).all()
        levels = colors * (1 if colors.dtype == np.uint8 else 255)
        assert np.abs(linear_to_srgb(stored[:, :3] / top) * 255 - levels).max() < 0.5
        as_stored = file(Mesh(points, FACES, colors), color="srgb")
        (tmp_path / "srgb.glb").write_bytes(as_stored)
        assert equal(read_mesh(tmp_path / "srgb.glb").vertex_colors[:, :3].copy(), colors)


def test_white_and_alpha_are_unchanged() -> None:
    colors = np.array([[255, 0, 255, 128]] * 6, np.uint8)
    assert colors_of(Mesh(CORNERS, FACES, colors)).tolist() == colors.tolist()


def test_indices_are_uint16_if_they_fit() -> None:
    for count, kind in ((65535, np.uint16), (65536, np.uint16), (65537, np.uint32)):
        content = file(Mesh(np.zeros((count, 3), np.float32), np.array([[0, 1, count - 2]])))
        indices = values(content, opened(content)[0]["meshes"][0]["primitives"][0]["indices"])
        assert indices.dtype == (kind if count != 65536 else np.uint32)
        assert indices[:, 0].tolist() == [0, 1, count - 2]


def textured(**changes: Any) -> Mesh:
    colors = np.arange(18, dtype=np.uint8).reshape(6, 3)
    return replace(Mesh(CORNERS, FACES, colors, corner_uvs=UVS, textures=IMAGES[:1]), **changes)


def test_vertices_are_split_only_if_uvs_differ() -> None:
    mesh = textured()
    held = with_vertex_uvs(mesh)
    assert np.array_equal(held.vertices[:6], mesh.vertices)
    # Vertex 1 has different coordinates in the two charts. Vertex 3 has the same coordinates in both.
    assert held.faces.tolist() == [[0, 1, 2], [2, 1, 3], [6, 5, 3]]
    assert held.vertices[6].tolist() == [1, 0, 0]
    assert equal(held.vertex_uvs[held.faces].reshape(-1, 2), UVS)
    assert held.vertex_colors[6].tolist() == mesh.vertex_colors[1].tolist()
    assert with_vertex_uvs(held) is held


def test_each_texture_is_a_primitive_with_its_own_vertices() -> None:
    textures = np.array([1, 0, 1], np.uint32)
    sampler = Sampler("nearest", True, "clamp", "mirror", 0.25)
    content = file(textured(textures=IMAGES, face_textures=textures, sampler=sampler))
    root, binary = opened(content)
    first, second = root["meshes"][0]["primitives"]
    assert values(content, first["indices"])[:, 0].tolist() == [1, 0, 2]
    for primitive, faces in ((first, [1]), (second, [0, 2])):
        rows = {name: values(content, number) for name, number in primitive["attributes"].items()}
        corners = values(content, primitive["indices"])[:, 0]
        assert rows["POSITION"][corners].tolist() == CORNERS[FACES[faces]].reshape(-1, 3).tolist()
        assert rows["TEXCOORD_0"][corners].tolist() == UVS.reshape(3, 6)[faces].reshape(-1, 2).tolist()
    assert root["samplers"] == [{"magFilter": 9728, "minFilter": 9984, "wrapS": 33071, "wrapT": 33648}]
    for number, material in enumerate(root["materials"]):
        assert (material["alphaMode"], material["alphaCutoff"], material["doubleSided"]) == (
            "MASK",
            0.25,
            True,
        )
        surface = material["pbrMetallicRoughness"]
        assert (surface["metallicFactor"], surface["roughnessFactor"]) == (0, 1)
        texture = root["textures"][surface["baseColorTexture"]["index"]]
        view = root["bufferViews"][root["images"][texture["source"]]["bufferView"]]
        png = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        assert equal(np.array(Image.open(io.BytesIO(png))), IMAGES[number])


@pytest.mark.parametrize("uvs", [UVS, UVS / 3, UVS + 0.5])
def test_uvs_are_floats_because_some_programs_do_not_scale_integers(uvs: NDArray[np.float32]) -> None:
    content = file(textured(corner_uvs=uvs))
    (primitive,) = opened(content)[0]["meshes"][0]["primitives"]
    stored = values(content, primitive["attributes"]["TEXCOORD_0"])
    assert stored.dtype == np.float32
    assert equal(stored[values(content, primitive["indices"])[:, 0]], uvs)


@pytest.mark.parametrize("kind", ["jpeg", "webp"])
def test_textures_as_jpeg_and_webp(kind: str) -> None:
    ramp = np.arange(0, 256, 8, dtype=np.uint8)[:, None, None].repeat(16, 1).repeat(3, 2)
    root, binary = opened(file(textured(textures=(ramp,)), texture=kind))
    assert root["images"][0]["mimeType"] == f"image/{kind}"
    view = root["bufferViews"][root["images"][0]["bufferView"]]
    image = np.array(Image.open(io.BytesIO(binary[view["byteOffset"] :][: view["byteLength"]])))
    assert np.abs(image.astype(int) - ramp).max() < 8
    assert root.get("extensionsRequired", []) == (["EXT_texture_webp"] if kind == "webp" else [])
    see_through = textured(textures=IMAGES[1:], sampler=Sampler(alpha_cutoff=0.5))
    kept = opened(file(see_through, texture=kind))[0]["images"][0]["mimeType"]
    assert kept == ("image/webp" if kind == "webp" else "image/png")

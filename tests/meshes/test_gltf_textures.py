"""Read textures and colours of glTF materials, embedded and linked, and list the ignored properties."""

import base64
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import pytest

from msb.asset.texture import Sampler, srgb_to_linear
from msb.base.files import read_file
from msb.errors import MeshFileError
from msb.meshes import read_mesh
from msb.meshes.assets import asset_from_mesh, mesh_from_asset

from .bad_files import BAD_IMAGES
from .builders import (
    SQUARE,
    SQUARE_FACES,
    TEXELS,
    UVS,
    Glb,
    Read,
    assert_colors,
    glb_square,
    glb_textured,
    picture,
)

RGBA = np.concatenate([TEXELS, np.uint8([[[0], [255]], [[60], [200]]])], axis=2)
BYTES = picture()


def surface(glb: Glb, material: int = 0) -> dict[str, Any]:
    return glb.root["materials"][material]["pbrMetallicRoughness"]


def two_parts(first: dict[str, Any], second: dict[str, Any], **attributes: Any) -> Glb:
    """Return the square twice, with two materials that use the same texture."""
    glb = glb_textured(picture(RGBA), **first)
    uvs = glb.accessor(UVS, "f4", "VEC2")
    glb.primitive(0, 1, attributes={"TEXCOORD_0": uvs, **attributes})
    glb.material(primitive=1, **second)
    surface(glb, 1)["baseColorTexture"] = {"index": 0}
    return glb


def test_a_texture_is_read_with_its_coordinates(read: Read) -> None:
    mesh = read(glb_textured().bytes(), ".glb")
    assert [image.tolist() for image in mesh.textures] == [TEXELS.tolist()]
    assert mesh.vertex_uvs is not None
    assert mesh.vertex_uvs.tolist() == UVS
    assert (mesh.face_textures, mesh.vertex_colors, mesh.sampler) == (None, None, Sampler())
    assert mesh.left_out == ()
    asset = asset_from_mesh(mesh)
    assert asset.manifest.appearance == Sampler().appearance
    assert np.array_equal(mesh_from_asset(asset).textures[0], TEXELS)


GREY = np.uint8([[0, 70], [200, 255]])


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (picture(TEXELS, "WEBP", lossless=True), TEXELS),
        (picture(RGBA, "WEBP", lossless=True, exact=True), TEXELS),
        (picture(np.full((8, 8, 3), 200, np.uint8), "JPEG"), np.full((8, 8, 3), 200, np.uint8)),
        (picture(GREY), np.repeat(GREY[..., None], 3, axis=2)),
        (picture(GREY.astype(np.uint16) * 257), np.repeat(GREY[..., None], 3, axis=2)),
        (picture(RGBA), TEXELS),
    ],
)
def test_image_formats(read: Read, content: bytes, expected: np.ndarray) -> None:
    (image,) = read(glb_textured(content).bytes(), ".glb").textures
    assert image.tolist() == expected.tolist()


def test_linked_and_embedded_images(read: Read, tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "a b.png").write_bytes(BYTES)
    text = base64.b64encode(BYTES).decode()
    bare = "data:image/png," + "".join(f"%{byte:02x}" for byte in BYTES)
    quoted = "DATA:image/png;base64," + quote(text, safe="")
    assert "%3D" in quoted or "%2B" in quoted or "%2F" in quoted
    for uri in ("maps/a%20b.png", f"data:image/png;base64,{text}", quoted, bare):
        assert np.array_equal(read(glb_textured(uri).bytes(), ".glb").textures[0], TEXELS)


def test_each_image_is_read_once_and_faces_without_one_are_white(read: Read, tmp_path: Path) -> None:
    glb = two_parts({}, {})
    glb.primitive(0, 1)
    glb.material(primitive=2)
    surface(glb, 2)["baseColorFactor"] = [0.5, 0.25, 1, 1]
    mesh = read(glb.bytes(), ".glb")
    assert [image.tolist() for image in mesh.textures] == [TEXELS.tolist(), [[[255] * 3]]]
    assert mesh.face_textures is not None
    assert mesh.face_textures.tolist() == [0, 0, 0, 0, 1, 1]
    bare = read_mesh(tmp_path / "mesh.glb", images=False)  # an audit needs them to find seams
    assert bare.textures == ()
    assert np.array_equal(bare.face_textures, mesh.face_textures)
    assert mesh.vertex_uvs is not None
    assert mesh.vertex_uvs.tolist() == UVS + UVS + [[0, 0]] * 4
    assert mesh.vertex_colors is not None
    assert mesh.vertex_colors[:8].tolist() == [[1, 1, 1]] * 8
    np.testing.assert_allclose(srgb_to_linear(mesh.vertex_colors[8:]), [[0.5, 0.25, 1]] * 4, rtol=1e-5)


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ({}, Sampler()),
        ({"magFilter": 9728, "minFilter": 9984, "wrapS": 33071}, Sampler("nearest", True, "clamp", "repeat")),
        (
            {"minFilter": 9729, "wrapT": 33648},
            Sampler("linear", False, "repeat", "mirror"),
        ),
        ({"minFilter": 9728}, Sampler("nearest", False)),
    ],
)
def test_samplers(read: Read, entry: dict[str, int], expected: Sampler) -> None:
    glb = glb_textured()
    glb.root["samplers"] = [entry]
    glb.root["textures"][0]["sampler"] = 0
    assert read(glb.bytes(), ".glb").sampler == expected


def test_a_second_sampler_is_ignored(read: Read) -> None:
    glb = two_parts({}, {})
    glb.root["samplers"] = [{"wrapS": 33071}]
    glb.root["textures"].append({"source": 0, "sampler": 0})
    surface(glb, 1)["baseColorTexture"] = {"index": 1}
    mesh = read(glb.bytes(), ".glb")
    assert (mesh.sampler, len(mesh.textures), mesh.left_out) == (Sampler(), 1, ("further samplers",))


def test_texture_transform_and_uv_set(read: Read) -> None:
    """Test the example of the extension, which shows the lower left quadrant of the image rotated by 90
    degrees.
    """
    glb = glb_textured()
    attributes = glb.root["meshes"][0]["primitives"][0]["attributes"]
    uvs = [[0, 0], [255, 0], [255, 255], [0, 51]]
    attributes["TEXCOORD_3"] = glb.accessor(uvs, "u1", "VEC2", normalized=True)
    moved = {"offset": [0, 1], "rotation": np.pi / 2, "scale": [0.5, 0.5], "texCoord": 3}
    surface(glb)["baseColorTexture"]["extensions"] = {"KHR_texture_transform": moved}
    mesh = read(glb.bytes(), ".glb")
    np.testing.assert_allclose(mesh.vertex_uvs, [[0, 1], [0, 0.5], [0.5, 0.5], [0.1, 1]], atol=1e-7)
    assert mesh.left_out == ("further UVs",)


def test_alpha_cut_offs_are_unified_and_other_alpha_is_dropped(read: Read) -> None:
    mesh = read(two_parts({"alphaMode": "MASK", "alphaCutoff": 0.25}, {}).bytes(), ".glb")
    assert mesh.sampler.alpha_cutoff == 0.25
    assert [image.tolist() for image in mesh.textures] == [RGBA.tolist(), TEXELS.tolist()]
    assert mesh.vertex_colors is None
    masked = two_parts({"alphaMode": "MASK"}, {"alphaMode": "MASK", "alphaCutoff": 0.25})
    surface(masked, 0)["baseColorFactor"] = [1, 1, 1, 0.8]
    mesh = read(masked.bytes(), ".glb")
    assert (mesh.sampler.alpha_cutoff, len(mesh.textures)) == (0.25, 1)
    assert_colors(mesh.vertex_colors, np.uint8([[255, 255, 255, 102]] * 4 + [[255] * 4] * 4))
    rows = np.tile([1, 1, 1, 0.5], (4, 1))
    for cutoff in (1e-46, 1e300):  # out of range for float32
        odd = two_parts({}, {})
        for material in odd.root["materials"]:
            material |= {"alphaMode": "MASK", "alphaCutoff": cutoff}
        odd.root["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = odd.accessor(rows, "f4", "VEC4")
        colors = read(odd.bytes(), ".glb").vertex_colors
        assert colors is not None
        assert np.isfinite(colors).all()
    opaque = read(two_parts({}, {"alphaMode": "BLEND"}).bytes(), ".glb")
    assert opaque.sampler.alpha_cutoff is None
    assert opaque.textures[0].shape[2] == 3
    assert opaque.left_out == ("alpha blending",)


def test_ignored_properties_are_listed(read: Read) -> None:
    glb = glb_textured(normalTexture={"index": 0}, emissiveFactor=[0, 0.5, 0])
    glb.root["materials"][0]["extensions"] = {"KHR_materials_unlit": {}, "KHR_materials_ior": {}}
    mesh = read(glb.bytes(), ".glb")
    assert mesh.left_out == ("normal maps", "emission", "KHR_materials_ior")
    glb = glb_textured()
    glb.root["textures"] = [{"extensions": {"KHR_texture_basisu": {"source": 0}}}]
    mesh = read(glb.bytes(), ".glb")
    assert mesh.textures == ()
    assert len(mesh.left_out) == 2
    glb = glb_textured()
    glb.root["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {}}
    (left_out,) = read(glb.bytes(), ".glb").left_out
    assert "EXT_mesh_gpu_instancing" in left_out


def test_no_image_is_decoded_without_images(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    path.write_bytes(glb_textured(b"no image").bytes())
    mesh = read_mesh(path, images=False)
    assert (mesh.vertices.tolist(), mesh.textures) == (SQUARE, ())
    assert mesh.vertex_uvs is not None
    assert mesh.vertex_uvs.tolist() == UVS
    assert "/images/0" in read_mesh(path).left_out[0]


@pytest.mark.parametrize("image", BAD_IMAGES.values(), ids=BAD_IMAGES)
def test_a_mesh_is_read_without_an_image_that_cannot_be_read(read: Read, image: bytes | str) -> None:
    glb = glb_textured(image)
    surface(glb)["baseColorFactor"] = [1, 0, 0, 1]
    mesh = read(glb.bytes(), ".glb")
    assert (mesh.vertices.tolist(), mesh.faces.tolist(), mesh.textures) == (SQUARE, SQUARE_FACES, ())
    assert len(mesh.left_out) == 1
    assert_colors(mesh.vertex_colors, np.uint8([[255, 0, 0]] * 4))


def test_other_parts_keep_their_textures_beside_a_missing_image(read: Read) -> None:
    glb = glb_textured()
    uvs = glb.accessor(UVS, "f4", "VEC2")
    glb.primitive(0, 1, attributes={"TEXCOORD_0": uvs})
    glb.material("gone.png", primitive=1)
    mesh = read(glb.bytes(), ".glb")
    assert [image.tolist() for image in mesh.textures] == [TEXELS.tolist(), [[[255] * 3]]]
    assert ["gone.png" in text for text in mesh.left_out] == [True]


GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"


@pytest.mark.parametrize("is_textured", [True, False])
def test_specular_glossiness_gives_its_diffuse_colour(read: Read, is_textured: bool) -> None:
    glb = glb_textured()
    shine = {"diffuseFactor": [1, 0, 0, 1]} | ({"diffuseTexture": {"index": 0}} if is_textured else {})
    glb.root["materials"] = [{"extensions": {GLOSSINESS: shine}}]
    mesh = read(glb.bytes(), ".glb")
    assert [image.tolist() for image in mesh.textures] == ([TEXELS.tolist()] if is_textured else [])
    assert_colors(mesh.vertex_colors, np.uint8([[255, 0, 0]] * 4))
    assert mesh.left_out == (() if is_textured else ("UVs",))


def test_a_metallic_roughness_texture_takes_precedence_over_specular_glossiness(read: Read) -> None:
    glb = glb_textured()
    shine = {"diffuseFactor": [1, 0, 0, 1], "glossinessFactor": 0.5}
    glb.root["materials"][0]["extensions"] = {GLOSSINESS: shine}
    mesh = read(glb.bytes(), ".glb")
    assert (len(mesh.textures), mesh.vertex_colors, len(mesh.left_out)) == (1, None, 1)


def test_links_to_other_folders_are_rejected(read: Read, tmp_path: Path) -> None:
    (tmp_path / "inside.png").write_bytes(BYTES)
    (tmp_path / "to_inside.png").symlink_to(tmp_path / "inside.png")
    (tmp_path / "to_outside.png").symlink_to(Path(__file__))
    assert read(glb_textured("to_inside.png").bytes(), ".glb").textures
    outside = read(glb_textured("to_outside.png").bytes(), ".glb")
    assert (outside.textures, len(outside.left_out)) == ((), 1)


def test_too_many_textures_are_rejected(read: Read) -> None:
    glb = glb_square()
    uvs = glb.accessor(UVS, "f4", "VEC2")
    glb.root["meshes"][0]["primitives"] = []
    for number in range(60):
        glb.primitive(0, 1, attributes={"TEXCOORD_0": uvs})
        glb.material(BYTES, number)
    with pytest.raises(MeshFileError, match="MESH_FILE_TOO_LARGE"):
        read(glb.bytes(), ".glb")


def assert_square(path: Path) -> None:
    mesh = read_mesh(path)
    assert (mesh.vertices.tolist(), mesh.faces.tolist()) == (SQUARE, SQUARE_FACES)
    assert np.array_equal(mesh.textures[0], TEXELS)
    assert (mesh.up, mesh.left_out) == ("+y", ())


@pytest.mark.parametrize("uri", ["a.bin", "a%20folder/b.bin"])
def test_linked_buffers_and_images(tmp_path: Path, uri: str) -> None:
    glb = glb_textured("a%20folder/map.png")
    (tmp_path / "a folder").mkdir()
    (tmp_path / "a folder" / "map.png").write_bytes(picture())
    (tmp_path / uri.replace("%20", " ")).write_bytes(glb.binary + b"more")
    (tmp_path / "a.gltf").write_bytes(glb.text(uri))
    assert_square(tmp_path / "a.gltf")


def test_embedded_data_does_not_count_for_the_json_limit(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("msb.meshes.gltf.MAX_JSON_BYTES", 2000)
    path = tmp_path / "a.gltf"
    glb = glb_textured()
    glb.view(bytes(6000))
    path.write_bytes(glb.text())
    assert path.stat().st_size > 8000
    assert_square(path)


def test_a_file_that_several_buffers_link_to_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[Path] = []
    monkeypatch.setattr(
        "msb.meshes.linked_files.read_file",
        lambda path, most: (opened.append(path), read_file(path, most))[1],
    )
    glb = glb_textured()
    whole = glb.root["buffers"][0]["byteLength"]
    glb.root["buffers"] += [{"uri": "./a.bin", "byteLength": whole}, {"uri": "%61.bin", "byteLength": 40}]
    glb.root["bufferViews"][1]["buffer"] = 1
    path = tmp_path / "a.gltf"
    (tmp_path / "a.bin").write_bytes(glb.binary)
    path.write_bytes(glb.text("a.bin"))
    assert_square(path)
    assert opened == [tmp_path.resolve() / "a.bin"]
    glb.root["bufferViews"][0]["buffer"] = 2
    path.write_bytes(glb.text("a.bin"))
    with pytest.raises(MeshFileError, match="MESH_FILE_TRUNCATED"):
        read_mesh(path)

"""Read the materials of OBJ files: images and colours of MTL files."""

import codecs
from pathlib import Path

import numpy as np
import pytest

from msb.errors import MeshFileError
from msb.meshes import Mesh, obj_materials, read_mesh, text

from .builders import OBJ_SQUARE, OBJ_TEXTURED, SQUARE, SQUARE_FACES, TEXELS, picture

UVS = b"vt 0 0\nvt 1 0 0\n"
LIBRARY = b"newmtl one\nKd 0.5 0.5 0.5\nmap_Kd map.png\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "map.png").write_bytes(picture())
    return tmp_path


def read(folder: Path, obj: bytes, mtl: bytes | None = LIBRARY) -> Mesh:
    (folder / "a.obj").write_bytes(obj)
    if mtl is not None:
        (folder / "a.mtl").write_bytes(mtl)
    mesh = read_mesh(folder / "a.obj")
    assert (mesh.vertices.tolist(), mesh.faces.tolist()) == (SQUARE, SQUARE_FACES)
    return mesh


def test_uvs_are_read_per_corner_with_v_downwards(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for block in (1, text.BLOCK_BYTES):
        monkeypatch.setattr(text, "BLOCK_BYTES", block)
        mesh = read(folder, OBJ_TEXTURED, codecs.BOM_UTF8 + LIBRARY)
        assert np.array_equal(mesh.textures[0], TEXELS)
        assert mesh.face_textures is None
        assert mesh.corner_uvs is not None
        assert mesh.corner_uvs.tolist() == [[0, 1], [1, 1], [1, 0], [0.25, 0.25], [1, 0], [1, 1]]
        assert mesh.left_out == ()


def test_a_material_becomes_its_image_or_a_texel_of_its_colour(folder: Path) -> None:
    obj = b"mtllib a.mtl\n" + OBJ_SQUARE + UVS + b"f 1 2 3\nusemtl red\nf 1/1 3/2 4//\n"
    mesh = read(folder, obj, b"newmtl red\nKd 1 0.2 0\n" + LIBRARY)
    assert [image.tolist() for image in mesh.textures] == [[[[255] * 3]], [[[255, 51, 0]]]]
    assert mesh.face_textures is not None
    assert mesh.face_textures.tolist() == [0, 1]
    assert mesh.corner_uvs is not None
    assert mesh.corner_uvs.tolist() == [[0, 0]] * 3 + [[0, 1], [1, 1], [0, 0]]
    both = obj.replace(b"f 1 2 3", b"usemtl one\nf 1 2 3")
    mesh = read(folder, both, b"newmtl red\nKd 1 0.2 0\n" + LIBRARY)
    assert [image.shape for image in mesh.textures] == [(2, 2, 3), (1, 1, 3)]


@pytest.mark.parametrize(
    ("mtl", "left_out"),
    [
        (LIBRARY.replace(b"map.png", b"-s 1 1 1 -o 0 0 -clamp off map.png"), ()),
        (LIBRARY.replace(b"map.png", b"-s 2 2 map.png"), ("options of maps",)),
        (
            LIBRARY.replace(b"map.png", b"-bm 0.3 map.png") + b"map_Bump b.png\n",
            ("options of maps", "further maps of materials"),
        ),
        (b"\r\n# x\r\n" + LIBRARY.replace(b"\n", b"\r\n").replace(b"map.png", b".\\map.png"), ()),
    ],
)
def test_options_of_maps(folder: Path, mtl: bytes, left_out: tuple[str, ...]) -> None:
    mesh = read(folder, OBJ_TEXTURED, mtl)
    assert np.array_equal(mesh.textures[0], TEXELS)
    assert mesh.left_out == left_out


@pytest.mark.parametrize(
    ("mtl", "words"),
    [
        (None, "a.mtl"),
        (LIBRARY.replace(b"map", b"../map", 2).replace(b"../map_", b"map_"), "../map.png"),
        (LIBRARY.replace(b"map.png", b"C:\\maps\\a.png"), "C:"),
        (LIBRARY.replace(b"map.png", b"/etc/passwd"), "/etc/passwd"),
        (LIBRARY.replace(b"map.png", b"a.mtl"), "image a.mtl"),
        (LIBRARY.replace(b"one", b"One"), "material one"),
    ],
)
def test_unreadable_materials_are_listed_and_the_mesh_is_read(
    folder: Path, mtl: bytes | None, words: str
) -> None:
    assert words in ", ".join(read(folder, OBJ_TEXTURED, mtl).left_out)


@pytest.mark.parametrize(
    "line",
    [
        b"Kd %sx 0 0",
        b"Kd 0 0 0%s.%sx",
        b"map_Kd -s%s 1 map.png",
        b"map_Kd %s",
        b"map_Kd " + b"-bm 1 " * 10**6,
    ],
)
def test_long_lines_are_read_in_linear_time(line: bytes, folder: Path) -> None:
    mtl = LIBRARY + line.replace(b"%s", b"1" * 10**6) + b"\n"
    assert read(folder, OBJ_TEXTURED, mtl).textures


def test_libraries_are_read_once_and_limited_in_size(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert len(read(folder, b"mtllib a.mtl\n" * 10**5 + OBJ_TEXTURED).textures) == 1
    assert len(read(folder, b"mtllib " + b"a" * 10**6 + b"\n" + OBJ_TEXTURED).textures) == 1
    (folder / "b c.mtl").write_bytes(LIBRARY)
    (folder / "d.MTL").write_bytes(LIBRARY + b"newmtl two\n")
    two = OBJ_TEXTURED.replace(b"a.mtl", b"b c.mtl  d.MTL").replace(b"usemtl one", b"usemtl two")
    assert read(folder, two).left_out == ("UVs",)
    monkeypatch.setattr(obj_materials, "_MAX_LIBRARY_BYTES", len(LIBRARY))
    left_out = read(folder, two).left_out
    assert [text for text in left_out if "material two" in text]


@pytest.mark.parametrize(("mask", "is_cut"), [("map.png", True), ("other.png", False)])
def test_the_alpha_of_an_image_that_is_its_own_mask_cuts_holes(folder: Path, mask: str, is_cut: bool) -> None:
    rgba = np.concatenate((TEXELS, np.uint8([[[0], [255]], [[9], [200]]])), axis=2)
    (folder / "map.png").write_bytes(picture(rgba))
    mesh = read(folder, OBJ_TEXTURED, LIBRARY + f"map_d {mask}\n".encode())
    assert mesh.sampler.alpha_cutoff == (0.5 if is_cut else None)
    assert mesh.textures[0].tolist() == (rgba if is_cut else TEXELS).tolist()
    assert len(mesh.left_out) == (0 if is_cut else 1)


def test_no_library_is_opened_without_images(folder: Path) -> None:
    (folder / "a.obj").write_bytes(OBJ_TEXTURED)
    mesh = read_mesh(folder / "a.obj", images=False)
    assert (mesh.textures, mesh.left_out) == ((), ())
    assert mesh.corner_uvs is not None  # an audit needs them to find seams
    assert len(mesh.corner_uvs) == 6


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"3/3/1", b"3/9/1"),
        (b"3/3/1", b"3/0/1"),
        (b"-4/-1", b"-4/-9"),
        (b"3/3/1", b"3/1.5/1"),
        (b"vt 1 1\n", b"vt 1 1 1 1\n"),
    ],
)
def test_bad_coordinates(folder: Path, old: bytes, new: bytes) -> None:
    (folder / "a.mtl").write_bytes(LIBRARY)
    (folder / "a.obj").write_bytes(OBJ_TEXTURED.replace(old, new))
    with pytest.raises(MeshFileError, match="MESH_FILE_INVALID"):
        read_mesh(folder / "a.obj")


def test_vertex_colours_take_precedence_over_material_colours(folder: Path) -> None:
    lines = OBJ_TEXTURED.split(b"\n")
    colored = b"\n".join(line + b" 1 0 0" if line.startswith(b"v ") else line for line in lines)
    mesh = read(folder, colored, b"newmtl one\nKd 0.5 0.5 0.5\n")
    assert (mesh.textures, mesh.left_out) == ((), ("UVs", "colours of materials"))
    assert read(folder, colored).textures

"""Read and write USD: round trips, foreign and invalid stages, and the validators of usd-core."""

import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import msb
from msb.asset.texture import Sampler
from msb.errors import MeshFileError
from msb.meshes import Mesh, read_mesh, write_mesh
from msb.meshes.files import write_whole
from msb.meshes.formats import Style
from tests.conftest import ROOT

from .builders import SQUARE, SQUARE_FACES
from .checks import check_refusals, make

pxr = pytest.importorskip("pxr", reason="usd-core, of the extra usd, is not installed")
from msb.meshes.usd import FORMATS  # noqa: E402

STAGE = """#usda 1.0
(
    upAxis = "Z"
)
def Xform "root"
{
    double3 xformOp:translate = (0, 0, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "quad"
    {
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        uniform token orientation = "leftHanded"
        color3f[] primvars:displayColor = [(1, 0, 0)] (
            interpolation = "uniform"
        )
    }
    def Mesh "hidden"
    {
        token visibility = "invisible"
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0)]
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
    }
    def Sphere "ball"
    {
    }
}
"""


def textured() -> Mesh:
    """Return a square with a texture for each triangle, repeated in one direction."""
    rng = np.random.default_rng(3)
    images = tuple(rng.integers(0, 256, (4, 4, 3), np.uint8) for _ in range(2))
    return Mesh(
        np.array(SQUARE, np.float32),
        np.array(SQUARE_FACES),
        corner_uvs=rng.random((6, 2), np.float32).round(2),
        textures=images,
        face_textures=np.array([0, 1], np.uint32),
        sampler=Sampler(wrap_u="repeat", wrap_v="clamp"),
    )


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_textures_round_trip(suffix: str, tmp_path: Path) -> None:
    mesh, path = textured(), tmp_path / f"a{suffix}"
    write_whole(mesh, path)
    first = path.read_bytes()
    write_whole(mesh, path)
    assert path.read_bytes() == first
    again = read_mesh(path)
    np.testing.assert_array_equal(again.vertices[again.faces], mesh.vertices[mesh.faces])
    assert again.corner_uvs is not None
    np.testing.assert_allclose(again.corner_uvs, mesh.corner_uvs, atol=1e-6)
    assert again.face_textures is not None
    for face in range(2):
        np.testing.assert_array_equal(again.textures[again.face_textures[face]], mesh.textures[face])
    assert again.sampler == mesh.sampler


@pytest.mark.parametrize("kind", ["vertex_colors", "face_colors"])
def test_colors_round_trip(kind: str, tmp_path: Path) -> None:
    mesh = make(np.float32, *(("uint8 rgb", "none") if kind == "vertex_colors" else ("none", "uint8 rgb")))
    path = tmp_path / "a.usdc"
    write_mesh(mesh, path, suffix=".usdc")
    again = read_mesh(path)
    np.testing.assert_array_equal(again.faces, mesh.faces)
    np.testing.assert_array_equal(again.vertices, mesh.vertices)
    np.testing.assert_array_equal(getattr(again, kind), getattr(mesh, kind))


def test_a_foreign_stage_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.usda").write_text(STAGE)
    mesh = read_mesh("a.usda")
    assert mesh.up == "+z"
    # The corners of left-handed polygons are in clockwise order.
    np.testing.assert_array_equal(mesh.faces, [[0, 2, 1], [0, 3, 2]])
    # A stage that does not state its unit is in centimetres.
    np.testing.assert_array_equal(mesh.vertices[:, 2], 0.05)
    np.testing.assert_array_equal(mesh.face_colors, np.array([[255, 0, 0]] * 2, np.uint8))
    assert ["Sphere" in text for text in mesh.left_out] == [True]


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("def Xform", "dfe Xform", "INVALID"),
        ("Counts = [4]", "Counts = [5]", "INVALID"),
        ("[(1, 0, 0)] (", "[] (", "INVALID"),
        ('def Sphere "ball"', 'def "ball" (references = @/etc/other.usda@)', "UNSUPPORTED"),
    ],
)
def test_invalid_and_composed_stages_are_rejected(old: str, new: str, code: str, tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    path.write_text(STAGE.replace(old, new, 1))
    with pytest.raises(MeshFileError, match=f"MESH_FILE_{code}: {path}"):
        read_mesh(path)


def test_an_image_in_another_folder_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    write_whole(textured(), path)
    path.write_text(path.read_text().replace("@./a_0.png@", "@/etc/passwd@"))
    mesh = read_mesh(path)
    assert [part.startswith("image /etc/passwd") for part in mesh.left_out if "image" in part] == [True]
    assert [image.shape for image in mesh.textures] == [(1, 1, 3), (4, 4, 3)]


SUBSETS = """        def Material "%s" {
            token outputs:surface.connect = </root/quad/%s/s.outputs:surface>
            def Shader "s" {
                uniform token info:id = "UsdPreviewSurface"
                color3f inputs:diffuseColor = %s
                token outputs:surface
            }
        }
        def GeomSubset "of_%s" (prepend apiSchemas = ["MaterialBindingAPI"]) {
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [%d]
            rel material:binding = </root/quad/%s>
        }
"""


def stage_with_subsets() -> str:
    """Return the stage with a red triangle and a green one."""
    before, _, after = STAGE.partition("        color3f[]")
    subsets = "".join(
        SUBSETS % (name, name, color, name, face, name)
        for name, color, face in (("red", "(1, 0, 0)", 0), ("green", "(0, 1, 0)", 1))
    )
    text = before + subsets + after.partition('            interpolation = "uniform"\n        )\n')[2]
    return text.replace("Counts = [4]", "Counts = [3, 3]").replace("[0, 1, 2, 3]", "[0, 1, 2, 0, 2, 3]")


def test_material_colours_of_subsets_become_face_colours(tmp_path: Path) -> None:
    path = tmp_path / "a.usda"
    path.write_text(stage_with_subsets())
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.face_colors, np.array([[255, 0, 0], [0, 255, 0]], np.uint8))


def test_a_package_is_uncompressed_and_aligned(tmp_path: Path) -> None:
    path = tmp_path / "Fläche.usdz"
    write_whole(textured(), path)
    data = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
    assert [member.filename for member in members] == ["asset.usdc", "Fläche_0.png", "Fläche_1.png"]
    for member in members:
        head = data[member.header_offset :][:30]
        start = member.header_offset + 30 + sum(np.frombuffer(head, "<u2", 2, 26).tolist())
        assert (member.compress_type, start % 64) == (zipfile.ZIP_STORED, 0)


def test_truncated_packages_are_rejected(tmp_path: Path) -> None:
    path = tmp_path / "a.usdz"
    write_whole(textured(), path)
    whole = path.read_bytes()
    for size in (1, 4, 40, len(whole) // 2, *range(len(whole) - 100, len(whole))):
        path.write_bytes(whole[:size])
        with pytest.raises(MeshFileError, match="MESH_FILE_TRUNCATED"):
            read_mesh(path)


def test_invalid_meshes_are_not_written() -> None:
    check_refusals(FORMATS[1])


def problems(path: Path) -> list[str]:
    """Return the messages of usd-core's validators."""
    from pxr import Usd, UsdValidation

    known = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    stage = Usd.Stage.Open(str(path))
    return [error.GetMessage() for error in UsdValidation.ValidationContext(known).Validate(stage)]


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_the_validators_of_usd_core_find_no_problems(suffix: str, tmp_path: Path) -> None:
    pytest.importorskip("pxr.UsdValidation", reason="this usd-core has no validators in Python")
    rows = np.array([[255, 0, 0], [9, 90, 200]], np.uint8)
    plain = replace(textured(), textures=(textured().textures[0], np.full((1, 1, 3), 255, np.uint8)))
    colored = make(np.float32, "uint8 rgb")
    for number, mesh in enumerate((textured(), colored, replace(plain, face_colors=rows))):
        path = tmp_path / f"{number}{suffix}"
        write_whole(mesh, path, Style(collision=(replace(mesh, vertex_colors=None),)))
        assert problems(path) == []


@pytest.mark.slow
def test_repaired_models_pass_the_validators(tmp_path: Path) -> None:
    pytest.importorskip("usd_validation_nvidia", reason="usd-validation-nvidia is not installed")
    for model in ("walled/mesh_splatting", "pebble/mesh_splatting", "pebble/two_dts"):
        path = tmp_path / f"{model.replace('/', '_')}.usdc"
        msb.save(msb.repair(ROOT / "data_stubs/models" / model).asset, path)
        assert problems(path) == []
    program = Path(sys.executable).with_name("nvidia_usd_validate")
    done = subprocess.run([program, tmp_path], capture_output=True, text=True, check=False)
    output = done.stdout + done.stderr
    assert "Failures: 0" in output, output
    assert "Errors: 0" in output, output
    assert "[ManifoldChecker]" not in output, output

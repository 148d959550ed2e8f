"""Write textures in formats with companion files, and in formats without textures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import msb
from msb.asset.texture import Sampler
from msb.errors import AssetError, OutputError, UsageError
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import asset_from_mesh, fit_to_format
from msb.meshes.colors import linear_light
from msb.meshes.files import write_whole
from msb.meshes.losses import list_losses
from msb.meshes.obj_colors import list_stored

from .checks import equal
from .test_glb_write import CORNERS, FACES, IMAGES, UVS, textured

FLAT = np.full((4, 8, 3), (200, 100, 50), np.uint8)


def two_textures() -> Mesh:
    numbers = np.array([1, 0, 1], np.uint32)
    return textured(textures=IMAGES, face_textures=numbers, sampler=Sampler(alpha_cutoff=0.5))


def test_an_obj_with_its_materials_reads_back(tmp_path: Path) -> None:
    for mesh, names in (
        (textured(), {"a b.obj", "a_b.mtl", "a_b.png"}),
        (two_textures(), {"a b.obj", "a_b.mtl", "a_b_0.png", "a_b_1.png"}),
    ):
        folder = tmp_path / str(len(names))
        folder.mkdir()
        write_whole(fit_to_format(mesh, ".obj"), folder / "a b.obj")
        assert {path.name for path in folder.iterdir()} == names
        again = read_mesh(folder / "a b.obj")
        assert equal(again.vertices, mesh.vertices.astype(np.float64))
        assert equal(again.faces, mesh.faces)
        uvs = again.vertex_uvs[again.faces].reshape(-1, 2) if again.corner_uvs is None else again.corner_uvs
        np.testing.assert_allclose(uvs, UVS, rtol=0, atol=1e-7)
        for face in range(len(FACES)):
            texture = 0 if mesh.face_textures is None else mesh.face_textures[face]
            number = 0 if again.face_textures is None else again.face_textures[face]
            image = mesh.textures[texture]
            assert equal(again.textures[number][..., :3].copy(), image[..., :3].copy())


def test_an_obj_and_its_companion_files_are_written_together_or_not_at_all(tmp_path: Path) -> None:
    asset = asset_from_mesh(textured())
    (tmp_path / "a.png").write_bytes(b"another file")
    with pytest.raises(UsageError, match=r"OUTPUT_EXISTS: .*a\.png"):
        msb.save(asset, tmp_path / "a.obj")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    (tmp_path / "a.obj").mkdir()
    with pytest.raises(OutputError, match="OUTPUT_UNWRITABLE"):
        msb.save(asset, tmp_path / "a.obj", overwrite=True)
    assert (tmp_path / "a.png").read_bytes() == b"another file"
    (tmp_path / "a.obj").rmdir()
    msb.save(asset, tmp_path / "a.obj", overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == {"a.obj", "a.mtl", "a.png"}
    assert msb.open(tmp_path / "a.obj").manifest.appearance["kind"] == "texture"


@pytest.mark.parametrize("suffix", [".ply", ".off"])
def test_textures_become_vertex_colours_in_formats_without_textures(suffix: str, tmp_path: Path) -> None:
    tinted = textured(textures=(FLAT,), vertex_colors=np.full((6, 3), 188, np.uint8))
    held = fit_to_format(tinted, suffix)
    assert not held.textures
    assert equal(held.faces, FACES)
    # sRGB 188 is half the light. Vertex 4 is unused and keeps its colour.
    assert np.abs(held.vertex_colors[[0, 1, 2, 3, 5]] - np.array([146, 71, 34])).max() <= 1
    write_whole(held, tmp_path / f"a{suffix}")
    assert equal(read_mesh(tmp_path / f"a{suffix}").vertex_colors, held.vertex_colors)
    assert fit_to_format(replace(tinted, vertex_colors=None), ".stl").vertex_colors is None


@pytest.mark.parametrize("suffix", [".ply", ".off"])
def test_face_colours_are_multiplied_with_textures(suffix: str) -> None:
    white = np.full((1, 1, 3), 255, np.uint8)
    colors = np.array([[255, 0, 0], [255, 0, 0], [0, 0, 255]], np.uint8)
    mesh = textured(textures=(white,), vertex_colors=None, face_colors=colors)
    held = fit_to_format(mesh, suffix)
    assert held.face_colors is None  # vertices 1 and 3 belong to faces of both colours, vertex 4 to no face
    assert held.vertex_colors[[0, 2, 4, 5]].tolist() == [[255, 0, 0], [255, 0, 0], [255] * 3, [0, 0, 255]]
    assert held.vertex_colors[[1, 3], 1].tolist() == [0, 0]
    assert (held.vertex_colors[[1, 3]][:, [0, 2]] > 100).all()


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".obj"])
def test_non_finite_values_are_rejected_before_sampling(suffix: str) -> None:
    uvs = UVS.copy()
    uvs[4, 1] = np.nan
    with pytest.raises(AssetError, match="TRIASSET_VALUE_NONFINITE"):
        fit_to_format(textured(corner_uvs=uvs), suffix)
    with pytest.raises(OutputError, match="OUTPUT_FORMAT_LIMIT"):
        fit_to_format(textured(vertices=np.full_like(CORNERS, np.inf)), suffix)
    assert not fit_to_format(textured(corner_uvs=uvs), ".stl").textures


def test_textures_are_filtered_to_the_size_of_the_faces() -> None:
    checks = (np.indices((64, 64)).sum(axis=0) % 2 * 255).astype(np.uint8)[..., None].repeat(3, 2)
    uvs = CORNERS[FACES].reshape(-1, 3)[:, :2] / 2
    mesh = Mesh(CORNERS, FACES, corner_uvs=uvs.astype(np.float32), textures=(checks,))
    colors = fit_to_format(mesh, ".ply").vertex_colors[[0, 1, 2, 3, 5]]
    assert (
        np.abs(colors.astype(int) - 188).max() <= 2
    )  # sRGB 188 is half the light: the average of black and white


@pytest.mark.parametrize("size", [1e-30, 1e78, 1e99, 1e200])
def test_textures_of_extremely_large_meshes_are_sampled(size: float) -> None:
    usual, huge = (fit_to_format(textured(vertices=CORNERS.astype(float) * by), ".ply") for by in (1, size))
    assert np.abs(usual.vertex_colors.astype(int) - huge.vertex_colors).max() <= 1


WHITE = np.full((1, 1, 3), 255, np.uint8)


def parts(colors: list[list[int]], textures: tuple[np.ndarray, ...], **more: object) -> Mesh:
    """Return two triangles without common vertices. The first has texture 0, the second has texture 1."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]] * 2, np.float32) + np.repeat([[0], [2]], 3, axis=0)
    mesh = Mesh(vertices.astype(np.float32), np.arange(6).reshape(2, 3), np.uint8(colors))
    uvs = np.zeros((6, 2), np.float32)
    return replace(mesh, corner_uvs=uvs, textures=textures, face_textures=np.uint32([0, 1]), **more)


def shown(mesh: Mesh) -> list[list[float]]:
    """Return the colours (3F, 3) of the corners in linear light, for textures of one colour."""
    light = np.ones((3 * len(mesh.faces), 3))
    if mesh.vertex_colors is not None:
        light *= linear_light(mesh.vertex_colors)[mesh.faces.reshape(-1), :3]
    numbers = np.zeros(len(mesh.faces), int) if mesh.face_textures is None else mesh.face_textures
    texels = np.stack([image[0, 0, :3] for image in mesh.textures])
    return (light * np.repeat(linear_light(texels)[numbers], 3, axis=0)).round(3).tolist()


def kd_lines(path: Path) -> list[str]:
    return [line for line in path.read_text().splitlines() if line.startswith("Kd")]


def test_plain_colours_beside_a_texture_are_kd(tmp_path: Path) -> None:
    mesh = parts([[255] * 3] * 3 + [[255, 0, 51]] * 3, (FLAT, WHITE))
    write_whole(fit_to_format(mesh, ".obj"), tmp_path / "a.obj")
    assert sorted(kd_lines(tmp_path / "a.mtl")) == ["Kd 1 0 0.2", "Kd 1 1 1"]
    assert {path.name for path in tmp_path.iterdir()} == {"a.obj", "a.mtl", "a_0.png"}
    again = read_mesh(tmp_path / "a.obj")
    assert again.vertex_colors is None
    assert shown(again) == shown(mesh)


@pytest.mark.parametrize(
    "colors",
    [
        [[200, 100, 9]] * 3 + [[255, 0, 51]] * 3,
        [[255] * 3] * 3 + [[255, 0, 51], [0, 255, 0], [0, 0, 255]],
        [[0, 0, 0]] * 3 + [[255] * 3] * 3,
    ],
    ids=["tint", "gradient", "black"],
)
@pytest.mark.parametrize(
    "textures",
    [(FLAT, WHITE), (WHITE, np.uint8([[[9, 200, 30]]])), (FLAT, np.uint8([[[9, 200, 30]]]))],
    ids=["image and white", "colours", "image and colour"],
)
def test_colours_and_textures_of_an_obj_read_back(
    tmp_path: Path, colors: list[list[int]], textures: tuple[np.ndarray, ...]
) -> None:
    mesh = parts(colors, textures)
    write_whole(fit_to_format(mesh, ".obj"), tmp_path / "a.obj")
    np.testing.assert_allclose(shown(read_mesh(tmp_path / "a.obj")), shown(mesh), atol=0.005)


def test_vertices_shared_with_a_texture_keep_their_colours(tmp_path: Path) -> None:
    mesh = parts([[255, 0, 51]] * 6, (FLAT, WHITE))
    mesh = replace(mesh, faces=np.array([[0, 1, 2], [2, 3, 4]]))
    write_whole(fit_to_format(mesh, ".obj"), tmp_path / "a.obj")
    assert kd_lines(tmp_path / "a.mtl") == ["Kd 1 1 1"] * 2
    assert shown(read_mesh(tmp_path / "a.obj")) == shown(mesh)


@pytest.mark.parametrize("cutoff", [0.5, 0.3])
def test_an_obj_keeps_its_cut_outs(tmp_path: Path, cutoff: float) -> None:
    image = np.concatenate((FLAT, np.full((4, 8, 1), 100, np.uint8)), axis=2)
    image[:2, :, 3] = 0
    mesh = parts([[255] * 3] * 6, (image, FLAT), sampler=Sampler(alpha_cutoff=cutoff))
    write_whole(fit_to_format(mesh, ".obj"), tmp_path / "a.obj")
    assert (tmp_path / "a.mtl").read_text().count("map_d") == 1
    again = read_mesh(tmp_path / "a.obj")
    assert again.sampler.alpha_cutoff == cutoff
    assert sorted(image.shape[2] for image in again.textures) == [3, 4]
    assert any(np.array_equal(texels, image) for texels in again.textures)
    assert again.left_out == ()


def lost(mesh: Mesh, suffix: str) -> str:
    return "; ".join(list_losses(mesh, fit_to_format(mesh, suffix), suffix, ()))


def test_losses_are_those_of_the_written_file() -> None:
    masked = np.concatenate((FLAT, np.full((4, 8, 1), 100, np.uint8)), axis=2)
    colors = [[255] * 3] * 3 + [[255, 0, 51]] * 3
    opaque, cut = (
        parts(colors, (FLAT, WHITE)),
        parts(colors, (masked, WHITE), sampler=Sampler(alpha_cutoff=0.5)),
    )
    for suffix in (".ply", ".off"):
        assert ("cut-outs" in lost(cut, suffix), "cut-outs" in lost(opaque, suffix)) == (True, False)
        assert "vertex colours" in lost(opaque, suffix)
    for suffix in (".obj", ".glb"):
        assert lost(cut, suffix) == lost(opaque, suffix) == ""
    assert all(word in lost(opaque, ".stl") for word in ("textures", "colours"))
    both = replace(opaque, textures=(), face_textures=None, face_colors=np.zeros((2, 3), np.uint8))
    assert ["face colours" in lost(both, suffix) for suffix in (".ply", ".obj", ".glb")] == [
        False,
        True,
        True,
    ]
    assert ["UVs" in lost(both, suffix) for suffix in (".ply", ".obj", ".glb")] == [True, False, False]


@pytest.mark.parametrize(
    ("colors", "stored"),
    [
        ([[255] * 3] * 3 + [[255, 0, 51]] * 3, ["1 texture", "1 material colour"]),
        ([[9] * 3] * 3 + [[255, 0, 51]] * 3, ["1 texture", "1 material colour", "vertex colours"]),
        ([[255] * 3] * 5 + [[255, 0, 51]], ["1 texture", "1 material colour", "vertex colours"]),
    ],
)
def test_the_contents_of_an_obj_are_those_of_the_file(colors: list[list[int]], stored: list[str]) -> None:
    assert list_stored(fit_to_format(parts(colors, (FLAT, WHITE)), ".obj")) == stored

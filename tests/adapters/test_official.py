"""Official exports, compared with files of the official exporters."""

import filecmp
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import msb
from msb.adapters.official import write_official
from msb.errors import Unsupported, UsageError
from msb.meshes import read_mesh
from msb.meshes.colors import srgb_colors
from tests.adapters.models import GOLDEN, two_dts, write_model
from tests.adapters.test_golden_exports import name, scenes


@pytest.mark.parametrize("official", ["glb/60000.glb", "mesh_ply/60000_mesh.ply"])
def test_two_dts(official: str, tmp_path: Path) -> None:
    folder = GOLDEN / "two_dts" / "ring_solid" / "checkpoint"
    target = tmp_path / official.replace("/", "_")
    write_official(msb.export(folder), target)
    ours, theirs = read_mesh(target), read_mesh(folder / official)
    for field in ("vertices", "faces", "vertex_colors", "face_colors"):
        a, b = getattr(ours, field), getattr(theirs, field)
        assert (a is None) == (b is None)
        if a is not None:
            if official.endswith(".glb") and field == "vertex_colors":
                a = srgb_colors(a)  # the reader converts the colours of the official file as defined by glTF
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)


def test_two_dts_with_culling_writes_each_face_once(tmp_path: Path) -> None:
    folder = GOLDEN / "two_dts" / "ring_solid" / "checkpoint"
    write_official(msb.export(folder, settings={"back_culling": True}), tmp_path / "once.ply")
    theirs = read_mesh(folder / "mesh_ply" / "60000_mesh.ply")
    np.testing.assert_array_equal(
        read_mesh(tmp_path / "once.ply").faces, theirs.faces[: len(theirs.faces) // 2]
    )


@pytest.mark.parametrize("box", [[-0.5, -0.5, 0.5, 0.5], [-0.5, -0.5, -0.4, 0.5, 0.5, 0.4]])
def test_two_dts_omits_faces_outside_the_scene_box(box: list[float], tmp_path: Path) -> None:
    values = two_dts(200)
    folder = write_model(tmp_path / "run", "two_dts", (values, {}, box, 1.0))
    asset = msb.export(folder)
    write_official(asset, tmp_path / "boxed.ply")
    axes = len(box) // 2
    center = values["_vertex"].mean(axis=1)[:, :axes]
    inside = ((center >= box[:axes]) & (center <= box[axes:])).all(axis=1)
    assert 0 < inside.sum() < 200
    ours = read_mesh(tmp_path / "boxed.ply")
    np.testing.assert_array_equal(ours.vertices, values["_vertex"][inside].reshape(-1, 3))
    assert asset.manifest.face_count == 200


def test_triangle_splatting(tmp_path: Path) -> None:
    scene = GOLDEN / "triangle_splatting" / "torus_sh0_white"
    write_official(msb.export(scene / "checkpoint"), tmp_path / "ours.off")
    theirs = (scene / "create_off.off").read_text().splitlines()
    ours = (tmp_path / "ours.off").read_text().splitlines()
    assert len(ours) == len(theirs)
    vertices = int(ours[1].split()[0])
    assert ours[: 2 + vertices] == theirs[: 2 + vertices]
    faces = np.array([line.split() for line in ours[2 + vertices :]], int)
    expected = np.array([line.split() for line in theirs[2 + vertices :]], int)
    np.testing.assert_array_equal(faces[:, :4], expected[:, :4])
    off_by = np.abs(faces[:, 4:] - expected[:, 4:])
    assert off_by.max() <= 1  # truncation of a borderline value can differ by 1
    assert np.count_nonzero(off_by) <= 3


@pytest.mark.parametrize("scene", scenes("mesh_splatting"), ids=name)
def test_mesh_splatting(scene: Path, tmp_path: Path) -> None:
    asset = msb.export(scene / "checkpoint")
    write_official(asset, tmp_path / "mesh.ply")
    mesh = read_mesh(tmp_path / "mesh.ply")
    with np.load(scene / "bake.npz") as bake:
        np.testing.assert_array_equal(mesh.vertex_colors[:, :3], bake["color_u8"][:, :3])
        raw = np.float32(0.28209479177387814) * asset.buffers["f_dc"] + np.float32(0.5)
        np.testing.assert_allclose(raw, bake["color_raw"], atol=1e-6)
    assert (mesh.vertex_colors[:, 3] == 255).all()
    np.testing.assert_array_equal(mesh.vertices, asset.buffers["positions"])
    np.testing.assert_array_equal(mesh.faces, asset.buffers["indices"])


@pytest.mark.parametrize("form", ["checkpoint", "web_export"])
@pytest.mark.parametrize("scene", scenes("diffsoup"), ids=name)
def test_diffsoup(scene: Path, form: str, tmp_path: Path) -> None:
    official = scene / "web_export" / scene.name
    write_official(msb.export(scene / form), tmp_path / "web")
    assert sorted(p.name for p in (tmp_path / "web").iterdir()) == sorted(p.name for p in official.iterdir())
    for json_file in ("mlp_weights.json", "meta.json"):
        assert filecmp.cmp(tmp_path / "web" / json_file, official / json_file, shallow=False)
    for image in ("lut0.png", "lut1.png"):
        with Image.open(tmp_path / "web" / image) as ours, Image.open(official / image) as theirs:
            np.testing.assert_array_equal(np.asarray(ours), np.asarray(theirs))
    ours, theirs = read_mesh(tmp_path / "web" / "mesh.ply"), read_mesh(official / "mesh.ply")
    np.testing.assert_array_equal(ours.vertices, theirs.vertices)
    np.testing.assert_array_equal(ours.faces, theirs.faces)


def test_mesh_splatting_reads_its_official_ply(tmp_path: Path) -> None:
    asset = msb.export(scenes("mesh_splatting")[0] / "checkpoint")
    write_official(asset, tmp_path / "mesh.ply")
    again = msb.export(tmp_path / "mesh.ply", method="mesh_splatting")
    colors = read_mesh(tmp_path / "mesh.ply").vertex_colors[:, :3] / np.float32(255)
    expected = np.clip((colors - 0.5) / 0.28209479177387814, -4, 4)
    np.testing.assert_allclose(again.buffers["f_dc"], expected, atol=1e-6)
    assert (again.buffers["opacity"] == np.inf).all()
    settings = {key: s.value for key, s in again.manifest.settings.items()}
    assert settings == {"sh_degree": 0, "supersample": 4, "opacity_floor": 0.9999, "sigma": 1e-4}
    assert msb.export(tmp_path / "mesh.ply").manifest.method == "mesh"


def test_wrong_format_and_methods_without_exporter(tmp_path: Path, demo_asset: Path) -> None:
    with pytest.raises(UsageError, match="NAME_UNKNOWN"):
        write_official(msb.load(demo_asset), tmp_path / "a.glb")
    mesh = msb.export(GOLDEN / "meshes" / "synthetic_splat_small.ply")
    with pytest.raises(Unsupported, match="UNSUPPORTED") as none:
        write_official(mesh, tmp_path / "a.ply")
    assert none.value.exit_status == 4
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "official",
    ["two_dts/ring_solid/checkpoint/glb/60000.glb", "triangle_splatting/torus_sh0_white/create_off.off"],
)
def test_official_meshes_are_accepted_as_indexed_meshes(official: str) -> None:
    asset = msb.export(GOLDEN / official)
    assert (asset.manifest.method, asset.manifest.topology) == ("mesh", "indexed_mesh")
    assert asset.manifest.appearance == {"kind": "static_color"}

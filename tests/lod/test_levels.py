"""Levels of detail: what they keep, how many faces they have, and when they are usable."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import msb
from msb.errors import MeshError
from msb.lod.opening import open_mesh
from msb.lod.quality import draw, place_views, read_lit
from msb.lod.report import Level, find_threshold
from msb.lod.run import _judge
from msb.lod.scene import read_parts
from msb.lod.simplification import simplify_arrays, simplify_scene
from msb.lod.textures import choose_factor, shrink
from msb.meshes import Mesh, read_mesh
from msb.meshes.gltf_materials import read_image_bytes
from msb.meshes.gltf_scene import read_scene
from msb.views import psnr_over_views
from tests.lod.builders import make_glb, open_glb, picture, root_of
from tests.validator import Validator


@pytest.fixture
def ball(tmp_path: Path) -> Path:
    path = tmp_path / "ball.glb"
    path.write_bytes(make_glb(parts=3))
    return path


def count_open_edges(mesh: Mesh) -> int:
    """Return the number of edges of one face, with vertices at one place merged."""
    _, place = np.unique(mesh.vertices.round(5), axis=0, return_inverse=True)
    faces = place.reshape(-1)[mesh.faces]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    return int((np.unique(edges, axis=0, return_counts=True)[1] == 1).sum())


def test_levels_keep_everything_but_faces(ball: Path) -> None:
    before = root_of(ball.read_bytes())
    made = msb.lod(ball, lods=[0.5, 0.1])
    whole = read_parts(open_glb(ball.read_bytes()))
    originals = {
        name: {row.tobytes() for part in whole.parts for row in np.asarray(part.read(name))}
        for name in ("NORMAL", "TANGENT", "TEXCOORD_0")
    }
    for glb in (made.glb, *made.levels):
        root = root_of(glb)
        for key in ("materials", "textures", "samplers", "animations", "extensionsUsed"):
            if key == "animations":
                assert [entry["channels"] for entry in root[key]] == [e["channels"] for e in before[key]]
            else:
                assert root[key] == before[key]
        assert root["asset"]["copyright"] == "us"
        assert (root["nodes"][0]["extras"], root["meshes"][0]["extras"]) == ({"team": 7}, {"price": 3})
        assert [n.get("translation", n.get("rotation")) for n in root["nodes"]] == [
            [0, 2, 0],
            [0, 0.6, 0, 0.8],
        ]
        assert [image["mimeType"] for image in root["images"]] == ["image/jpeg", "image/png"]
        scene = read_parts(open_glb(glb))
        assert len(scene.parts) == 3
        for part in scene.parts:
            for name, rows in originals.items():
                assert {row.tobytes() for row in np.asarray(part.read(name))} <= rows
    times = open_glb(made.levels[0]).root["animations"][0]["samplers"][0]["input"]
    assert root_of(made.levels[0])["accessors"][times]["max"] == [1]


@pytest.mark.slow
def test_levels_have_the_requested_faces_and_fewer_texels(ball: Path) -> None:
    made = msb.lod(ball, lods="0.5,0.25,0.06")
    faces = made.report.faces
    for level, glb in zip(made.report.levels, made.levels, strict=True):
        assert len(read_scene(open_glb(glb)).faces) == level.faces
        assert level.faces == pytest.approx(level.share * faces, rel=0.03)
        assert level.bytes == len(glb)
    assert [level.texture for level in made.report.levels] == [(64, 64), (32, 32), (16, 16)]
    by_count = msb.lod(ball, lods=[faces // 2])
    assert by_count.report.levels[0].faces == pytest.approx(faces // 2, rel=0.03)


def test_seams_and_borders_of_materials_stay_closed(ball: Path) -> None:
    assert count_open_edges(read_mesh(ball)) == 0
    for glb in msb.lod(ball, lods=[0.5, 0.2]).levels:
        assert count_open_edges(read_scene(open_glb(glb))) == 0


def test_open_borders_stay() -> None:
    """Half the faces of a flat grid can go without a change of its outline."""
    x, y = np.meshgrid(np.arange(20.0), np.arange(20.0))
    points = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3).astype(np.float32)
    first = (np.arange(19)[:, None] * 20 + np.arange(19)).reshape(-1)
    faces = np.concatenate(
        [np.stack([first, first + 1, first + 21], 1), np.stack([first, first + 21, first + 20], 1)]
    )
    (half,) = simplify_arrays(points, faces, [len(faces) // 2])
    a, b, c = points[half].transpose(1, 0, 2)
    assert len(half) <= len(faces) // 2
    assert np.cross(b - a, c - a)[:, 2].sum() / 2 == pytest.approx(19 * 19)
    assert np.ptp(points[half].reshape(-1, 3), axis=0).tolist() == [19, 19, 0]


def test_hard_edges_can_be_reduced() -> None:
    """Every vertex of a flat-shaded mesh has several normals, which must not stop the reduction."""
    rng = np.random.default_rng(0)
    mesh = read_scene(open_glb(make_glb()))
    corners = mesh.vertices[mesh.faces].reshape(-1, 3) + 0
    normals = np.repeat(rng.normal(size=(len(mesh.faces), 3)), 3, axis=0)
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    flat = Mesh(corners.astype(np.float32), np.arange(len(corners)).reshape(-1, 3), corner_normals=normals)
    scene = read_parts(open_mesh(flat, is_lit=False))
    (level,) = simplify_scene(scene, [len(mesh.faces) // 4])
    assert sum(map(len, level)) == pytest.approx(len(mesh.faces) // 4, rel=0.1)


def test_nothing_collapses_where_nothing_can_go() -> None:
    """Two parts at the same places lock each other; both stay instead of disappearing."""
    scene = read_parts(open_glb(make_glb(parts=2)))
    doubled = type(scene)(scene.document, (scene.parts[0], scene.parts[0]))
    (level,) = simplify_scene(doubled, [10])
    assert all(len(faces) for faces in level)


def test_a_level_equal_to_the_whole_has_infinite_psnr_and_a_broken_one_little(ball: Path) -> None:
    document = open_glb(ball.read_bytes())
    mesh = read_lit(document)
    cameras = place_views(mesh)
    images = draw(mesh, cameras)
    assert len(images) == 8
    assert psnr_over_views(images, draw(mesh, cameras)) == np.inf
    # The light shows a surface whose normals point elsewhere.
    turned = read_lit(open_mesh(read_scene(document), is_lit=True))
    assert psnr_over_views(images, draw(turned, cameras)) > 30
    half = Mesh(mesh.vertices, mesh.faces[::2], mesh.vertex_colors)
    assert psnr_over_views(images, draw(half, cameras)) < 25


def test_unusable_levels_are_only_written_on_request(ball: Path, tmp_path: Path) -> None:
    made = msb.lod(ball, lods=[0.5, 0.004])
    good, bad = made.report.levels
    assert good.is_usable
    assert good.psnr > 35
    assert not bad.is_usable
    assert bad.psnr < find_threshold(bad.share) == 25
    report = made.save(tmp_path / "a.glb")
    assert [level.output for level in report.levels] == [tmp_path / "a_lod1.glb", None]
    assert not (tmp_path / "a_lod2.glb").exists()
    report = made.save(tmp_path / "b.glb", unusable=True)
    assert report.levels[1].output == tmp_path / "b_lod2.glb"
    assert (tmp_path / "b_lod2.glb").read_bytes() == made.levels[1]


@pytest.mark.parametrize(("share", "psnr", "is_usable"), [
    (0.5, 35.0, True), (0.5, 34.9, False), (0.25, 30.0, True), (0.4, 29.9, False), (0.1, 25.0, True),
    (0.1, 24.9, False),
])  # fmt: skip
def test_thresholds(share: float, psnr: float, is_usable: bool) -> None:
    level = Level(None, share, 50, 1, None, psnr)
    assert (_judge(level, 100) is None) == is_usable
    assert _judge(level, 50) is not None, "no face was removed"


@pytest.mark.parametrize(("share", "factor"), [(1, 1), (0.5, 1), (0.25, 0.5), (0.1, 0.25), (0.01, 0.125)])
def test_texels_follow_faces(share: float, factor: float) -> None:
    assert choose_factor(share) == factor


def test_normal_maps_keep_unit_vectors() -> None:
    content, size = shrink(picture("normal"), 0.5, is_normal=True)
    assert size == (32, 32)
    texels = np.asarray(Image.open(io.BytesIO(content)), float)
    length = np.linalg.norm(texels / 127.5 - 1, axis=2)
    assert np.abs(length - 1).max() < 0.01
    assert shrink(b"\xabKTX 20\xbb....", 0.5, is_normal=False) == (b"\xabKTX 20\xbb....", (0, 0))


def test_other_formats_come_and_go(tmp_path: Path, ball: Path) -> None:
    source = tmp_path / "ball.obj"
    msb.convert(ball, source)
    made = msb.lod(source, lods=[0.5])
    report = made.save(tmp_path / "out.obj")
    assert report.levels[0].is_usable
    level = read_mesh(tmp_path / "out_lod1.obj")
    assert len(level.faces) == report.levels[0].faces
    assert level.textures
    assert report.levels[0].bytes == sum(p.stat().st_size for p in tmp_path.glob("out_lod1*"))


@pytest.mark.slow
def test_a_compressed_file_comes_out_uncompressed(tmp_path: Path, ball: Path) -> None:
    pytest.importorskip("meshopt")
    web = tmp_path / "web.glb"
    msb.convert(ball, web, engine="web")
    made = msb.lod(web, lods=[0.5])
    assert "EXT_meshopt_compression" in root_of(web.read_bytes())["extensionsUsed"]
    for glb in (made.glb, *made.levels):
        assert "EXT_meshopt_compression" not in root_of(glb).get("extensionsUsed", [])
    assert made.report.levels[0].is_usable


@pytest.mark.slow
def test_no_warning_of_the_validator(ball: Path, validator: Validator | None) -> None:
    if validator is None:
        pytest.skip("glTF-Validator is not installed")
    assert validator.problems(ball.read_bytes()) == []
    for settings in ({}, {"one_file": True}, {"target": "unreal", "collision": "box", "scale": 0.1}):
        made = msb.lod(ball, lods=[0.5], **settings)  # type: ignore[arg-type]
        for glb in (made.glb, *made.levels):
            assert validator.problems(glb) == []


def test_a_file_without_faces_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "none.glb"
    made: dict[str, Any] = {"meshes": [], "nodes": [{"name": "nothing"}]}
    path.write_bytes(make_glb(**made))
    with pytest.raises(MeshError, match="valid triangle") as caught:
        msb.lod(path)
    assert caught.value.code == "MESH_ARRAY"


def test_image_bytes_of_the_whole_stay(ball: Path) -> None:
    made, before = open_glb(msb.lod(ball, lods="none").glb), open_glb(ball.read_bytes())
    for number in range(2):
        assert bytes(read_image_bytes(made, number)) == bytes(read_image_bytes(before, number))


@pytest.mark.slow
def test_no_face_joins_two_parts_without_attributes() -> None:
    """Two bands of a sphere share a circle of vertices; they have positions only."""
    scene = read_parts(open_glb(make_glb(parts=2)))
    bare = [replace(part, attributes={"POSITION": part.attributes["POSITION"]}) for part in scene.parts]
    for count in (600, 200, 20):
        (level,) = simplify_scene(replace(scene, parts=tuple(bare)), [count])
        for part, faces in zip(bare, level, strict=True):
            assert np.isin(faces, part.faces).all()

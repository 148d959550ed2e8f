"""Meshes far from zero, as in map coordinates: the origin, and the round trip in every format."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from msb.base.origin import NO_ORIGIN, find_origin, round_coordinates
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import align_baked, asset_from_mesh, fit_to_format, mesh_from_asset
from msb.meshes.files import write_whole
from msb.meshes.formats import Style, Web
from msb.meshes.losses import list_losses
from msb.meshes.mesh import report_origin
from msb.topology.faces import signed_volume
from msb.topology.weld import merge_coincident
from tests.meshes.builders import Glb

UTM = np.array([500_000.0, 4_649_776.0, 100.0])
Floats = NDArray[np.float64]


def ball(rings: int = 12, sides: int = 16) -> Mesh:
    """Return a closed ball of radius 1 with coloured vertices, wound outwards."""
    polar, around = np.pi * np.arange(1, rings) / rings, 2 * np.pi * np.arange(sides) / sides
    across, high = np.sin(polar)[:, None], np.repeat(np.cos(polar)[:, None], sides, axis=1)
    grid = np.stack([across * np.cos(around), across * np.sin(around), high], axis=-1).reshape(-1, 3)
    points = np.concatenate([grid, [[0, 0, 1], [0, 0, -1]]])
    faces = []
    for side in range(sides):
        following = (side + 1) % sides
        faces += [(len(grid), side, following)]
        faces += [(len(grid) + 1, len(grid) - sides + following, len(grid) - sides + side)]
        for ring in range(rings - 2):
            a, b = ring * sides + side, ring * sides + following
            faces += [(a, a + sides, b), (b, a + sides, b + sides)]
    colors = np.floor(127 + 127 * points).astype(np.uint8)
    return Mesh(points, np.array(faces), colors)


def far_ball() -> Mesh:
    near = ball()
    return replace(near, vertices=near.vertices + UTM)


def corners(mesh: Mesh) -> Floats:
    return np.asarray(mesh.vertices[mesh.faces], np.float64)


# ---- the rule


def test_the_origin_is_near_the_middle_and_has_short_decimals() -> None:
    assert find_origin(far_ball().vertices) == tuple(UTM)
    assert find_origin(far_ball().vertices / 1000) != NO_ORIGIN


@pytest.mark.parametrize(
    "vertices",
    [
        ball().vertices,
        ball().vertices + np.array([20.0, -30.0, 0.0]),
        far_ball().vertices.astype(np.float32),  # exact as it is
        np.concatenate([ball().vertices, far_ball().vertices]),
        np.full((3, 3), 1e6),
        np.full((40, 3), np.nan),
        np.zeros((0, 3)),
        ball().vertices * 1e20 + 1e22,  # farther than cameras can be
        ball().vertices * 1e300,
    ],
)
def test_other_meshes_have_no_origin(vertices: NDArray[Any]) -> None:
    assert find_origin(vertices) == NO_ORIGIN


def test_a_stray_vertex_and_nan_do_not_hide_the_origin() -> None:
    stray = np.concatenate([far_ball().vertices, np.zeros((1, 3)), np.full((1, 3), np.nan)])
    assert find_origin(stray) == tuple(UTM)


def test_no_surface_needs_an_origin_below_32_sizes() -> None:
    mesh = ball()
    assert find_origin(mesh.vertices + np.array([0, 0, 60.0])) == NO_ORIGIN
    assert find_origin(mesh.vertices + np.array([0, 0, 70.0])) == (0, 0, 70)


# ---- files


@pytest.mark.parametrize(
    "suffix",
    [
        ".ply",
        ".obj",
        ".off",
        ".glb",
        *(pytest.param(s, marks=pytest.mark.slow) for s in (".usda", ".usdc", ".usdz")),
    ],
)
def test_files_keep_the_coordinates(suffix: str, tmp_path: Path) -> None:
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr")
    mesh, path = far_ball(), tmp_path / f"ball{suffix}"
    written = fit_to_format(mesh, suffix)
    write_whole(written, path)
    again = read_mesh(path)
    assert again.vertices.dtype == np.float64
    assert np.abs(corners(again) - corners(mesh)).max() < 1e-6
    assert (corners(again) == corners(written)).all()  # the audit of a repair sees the same
    assert not [text for text in list_losses(mesh, written, suffix, ()) if "moves vertices" in text]
    # The asset of the file, and its way back.
    asset = msb.open(path)
    assert asset.manifest.origin == tuple(UTM)
    assert "MESH_ORIGIN" in [warning.code for warning in asset.warnings]
    msb.save(asset, tmp_path / "ball.triasset")
    loaded = msb.load(tmp_path / "ball.triasset")
    assert not msb.validate(tmp_path / "ball.triasset").findings
    assert (loaded.manifest.origin, loaded.manifest.version) == (tuple(UTM), "1.1")
    assert np.abs(loaded.vertices[loaded.faces] - corners(mesh)).max() < 1e-6
    msb.save(loaded, tmp_path / f"again{suffix}")
    assert np.abs(corners(read_mesh(tmp_path / f"again{suffix}")) - corners(mesh)).max() < 1e-6


def test_text_stl_keeps_the_coordinates_and_binary_stl_says_what_it_loses(tmp_path: Path) -> None:
    mesh = far_ball()
    lines = ["solid ball"]
    for face in corners(mesh).tolist():
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x!r} {y!r} {z!r}" for x, y, z in face)]
        lines += ["endloop", "endfacet"]
    (tmp_path / "text.stl").write_text("\n".join([*lines, "endsolid ball", ""]))
    assert (corners(read_mesh(tmp_path / "text.stl")) == corners(mesh)).all()
    written = fit_to_format(mesh, ".stl")
    assert written.vertices.dtype == np.float32
    assert any("float32 moves vertices" in text for text in list_losses(mesh, written, ".stl", ()))
    near = ball()
    assert not any("float32" in text for text in list_losses(near, fit_to_format(near, ".stl"), ".stl", ()))


def test_files_of_ordinary_meshes_stay_the_same(tmp_path: Path) -> None:
    mesh = ball()
    write_whole(fit_to_format(mesh, ".glb"), tmp_path / "ball.glb")
    assert b"translation" not in (tmp_path / "ball.glb").read_bytes()
    asset = asset_from_mesh(mesh)
    assert "origin" not in asset.manifest.to_dict()
    assert (asset.buffers["positions"] == mesh.vertices.astype(np.float32)).all()
    assert mesh_from_asset(asset).vertices.dtype == np.float32


def test_a_glb_for_the_web_keeps_the_shape(tmp_path: Path) -> None:
    pytest.importorskip("meshopt")
    mesh, path = far_ball(), tmp_path / "web.glb"
    write_whole(fit_to_format(mesh, ".glb"), path, Style(web=Web(80)))
    again = read_mesh(path)
    assert abs(signed_volume(again.vertices, again.faces) - signed_volume(mesh.vertices, mesh.faces)) < 1e-4
    assert np.abs(again.vertices.min(axis=0) - mesh.vertices.min(axis=0)).max() < 1e-4


# ---- transforms in files


@pytest.mark.parametrize(
    "nodes",
    [
        [{"mesh": 0, "translation": UTM.tolist()}],
        [{"mesh": 0, "scale": [0.001] * 3, "translation": UTM.tolist()}],
        [{"children": [1], "translation": UTM.tolist()}, {"mesh": 0, "scale": [10, 10, 10]}],
        [
            {"mesh": 0, "translation": UTM.tolist()},
            {"mesh": 0, "translation": (UTM + np.array([3, 0, 0])).tolist()},
        ],
    ],
)
def test_a_node_with_the_offset_becomes_the_origin(nodes: list[dict[str, Any]], tmp_path: Path) -> None:
    near = ball()
    glb, path = Glb(), tmp_path / "placed.gltf"
    glb.primitive(glb.accessor(near.vertices, "f4", "VEC3"), glb.accessor(near.faces.ravel(), "u4", "SCALAR"))
    children = {number for node in nodes for number in node.get("children", [])}
    glb.root["nodes"] = nodes
    glb.root["scenes"] = [{"nodes": [number for number in range(len(nodes)) if number not in children]}]
    path.write_bytes(glb.text())
    scale = next((node["scale"][0] for node in nodes if "scale" in node), 1)
    placed = [node["translation"] for node in nodes if "translation" in node]
    expected = np.concatenate([scale * near.vertices.astype(np.float32) + np.array(at) for at in placed])
    asset = msb.open(path)
    assert any(asset.manifest.origin)
    assert np.abs(asset.vertices - expected).max() < 1e-6 * max(scale, 1)
    # Relative to its size, the shape is that of float32.
    volume = signed_volume(asset.vertices, asset.faces) / len(placed)
    assert volume == pytest.approx(scale**3 * signed_volume(near.vertices, near.faces), rel=1e-4)


def test_a_usd_transform_with_the_offset_becomes_the_origin(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    near = ball()
    points = ", ".join(str(tuple(point)) for point in near.vertices.tolist())
    x, y, z = UTM.tolist()
    (tmp_path / "placed.usda").write_text(
        f"""#usda 1.0
( metersPerUnit = 1
  upAxis = "Z" )
def Xform "at" {{
  double3 xformOp:translate = ({x}, {y}, {z})
  uniform token[] xformOpOrder = ["xformOp:translate"]
  def Mesh "ball" {{
    int[] faceVertexCounts = {[3] * len(near.faces)}
    int[] faceVertexIndices = {near.faces.ravel().tolist()}
    point3f[] points = [{points}]
  }}
}}
"""
    )
    asset = msb.open(tmp_path / "placed.usda")
    assert asset.manifest.origin == tuple(UTM)
    assert np.abs(asset.vertices - far_ball().vertices).max() < 1e-6


# ---- parts far apart


def test_parts_that_no_origin_can_hold_are_reported(tmp_path: Path) -> None:
    near, far = ball(), far_ball()
    count = len(near.vertices)
    both = Mesh(
        np.concatenate([far.vertices, far.vertices + np.array([100_000, 0, 0])]),
        np.concatenate([near.faces, near.faces + count]),
    )
    codes = [item.code for item in report_origin(both)]
    assert codes == ["MESH_ORIGIN", "MESH_ROUNDED"]
    written = fit_to_format(both, ".glb")
    assert any("float32 moves vertices" in text for text in list_losses(both, written, ".glb", ()))
    assert np.abs(written.vertices - both.vertices).max() < 0.01
    assert not report_origin(near)
    assert [item.code for item in report_origin(far)] == ["MESH_ORIGIN"]


# ---- equality


def test_equality_is_decided_relative_to_the_origin() -> None:
    mesh = far_ball()
    doubled = np.concatenate([mesh.vertices, mesh.vertices])
    first, number = merge_coincident(doubled, "exact")
    assert len(first) == len(mesh.vertices)
    assert (number == np.tile(np.arange(len(first)), 2)).all()
    # A near twin stays separate, as it does at zero.
    twin = np.concatenate([ball().vertices, ball().vertices[:1] + 1e-3])
    assert (
        len(merge_coincident(twin + UTM, "exact")[0]) == len(merge_coincident(twin, "exact")[0]) == len(twin)
    )


@pytest.mark.parametrize("move", [0.0, UTM])
def test_an_exact_weld_keeps_all_faces(move: Any, tmp_path: Path) -> None:
    mesh = replace(ball(), vertices=ball().vertices + move)
    write_whole(mesh, tmp_path / "ball.ply")
    fixed = msb.repair(tmp_path / "ball.ply", ["weld:exact", "orient", "pair"])
    assert fixed.after.counts == fixed.before.counts
    assert fixed.after.verdict == "ok"
    assert np.abs(fixed.asset.vertices - mesh.vertices).max() < 1e-6


# ---- audits and repairs


def test_audits_equal_those_at_zero(tmp_path: Path) -> None:
    near, far = ball(), far_ball()
    expected = msb.audit(near)
    for audited in (msb.audit(far), msb.audit(asset_from_mesh(far))):
        assert audited.counts == expected.counts
        assert audited.judged.bodies == expected.judged.bodies
        assert audited.sentence == expected.sentence
        assert audited.metrics.total_area == pytest.approx(expected.metrics.total_area, rel=1e-6)


def test_reported_places_and_repairs_are_in_the_scene() -> None:
    far = far_ball()
    open_mesh = replace(far, faces=far.faces[5:])
    asset = asset_from_mesh(open_mesh)
    fixed = msb.repair(asset, ["close"])
    for audited in (msb.audit(asset), fixed.before):
        sample = audited.samples["boundary_edges"][0]
        assert np.abs(np.array(sample.coordinates) - far.vertices[list(sample.vertices)]).max() < 1e-6
    # Vertices that stay keep their bits, new ones are on the ball.
    assert fixed.asset.manifest.origin == asset.manifest.origin
    stays = fixed.vertex_map >= 0
    kept = asset.buffers["positions"][fixed.vertex_map[stays]]
    assert (fixed.asset.buffers["positions"][stays] == kept).all()
    assert np.linalg.norm(fixed.asset.vertices - UTM, axis=1).max() <= 1 + 1e-6


def test_a_baked_mesh_is_moved_to_the_origin_of_its_model() -> None:
    model = asset_from_mesh(far_ball())
    shifted = asset_from_mesh(replace(far_ball(), vertices=far_ball().vertices + np.array([3.0, 0, 0])))
    assert shifted.manifest.origin != model.manifest.origin
    aligned = align_baked(shifted, model)
    assert aligned.manifest.origin == model.manifest.origin
    assert np.abs(aligned.vertices - shifted.vertices).max() < 1e-6


def test_rounding_gives_what_an_asset_holds() -> None:
    mesh = far_ball()
    assert (round_coordinates(mesh.vertices) == asset_from_mesh(mesh).vertices).all()


# ---- the manifest


@pytest.mark.parametrize("origin", [[1.0, 2.0], "0 0 0", [1, 2, None], [1e16, 0, 0], [[1, 2, 3]]])
def test_an_invalid_origin_is_rejected(origin: object, tmp_path: Path) -> None:
    path = tmp_path / "ball.triasset"
    msb.save(asset_from_mesh(far_ball()), path, form="folder")
    manifest = path / "manifest.json"
    manifest.write_text(json.dumps({**json.loads(manifest.read_text()), "origin": origin}))
    with pytest.raises(msb.MsbError) as caught:
        msb.load(path)
    assert caught.value.code == "TRIASSET_FIELD"

"""Repair assets and meshes: they become manifold, and keep their buffers, seams and textures."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import Asset, Description, build_asset
from msb.base.limits import Limits
from msb.errors import MeshError, MsbError, Unsupported
from msb.meshes import Mesh
from msb.meshes.assets import asset_from_mesh, fit_to_format
from msb.repair import Repaired
from msb.repair.assets import repair_asset, repair_mesh
from msb.repair.buffers import build_lattice_permutation, carry
from msb.repair.plan import Options, parse_plan
from msb.repair.run import run_plan
from msb.topology import audit_arrays
from msb.topology.steps import Change, orient
from msb.topology.steps.change import Rims, unchanged
from tests.conftest import BOOK, ROOT, TETRAHEDRON
from tests.topology.seamed import CUBE, TEXTURE, doubled, textured_cube, torus
from tests.topology.test_repair_steps import strip

MODELS = ROOT / "tests" / "tiny" / "models" / "pebble"


@pytest.fixture(scope="module")
def splat(demo_asset: Path) -> Asset:
    return msb.load(demo_asset)


@pytest.fixture(scope="module")
def fixed(splat: Asset) -> Repaired:
    return msb.repair(splat)


def test_a_one_sided_strip_is_cut_and_pages_are_paired() -> None:
    points = np.random.default_rng(1).random((24, 3))
    mesh = Mesh(np.concatenate([points, BOOK[0]]), np.concatenate([strip(8, 2), BOOK[1] + 24]))
    after = repair_mesh(mesh, Options())[1].after
    assert (after.counts.inconsistent_winding_edges, after.counts.nonmanifold_edges) == (0, 0)
    assert after.counts.components == 3  # the strip, a pair of pages, and the third page


def test_the_default_plan_makes_a_model_manifold_with_few_components(
    fixed: Repaired,
) -> None:
    after = fixed.after.counts
    assert (after.nonmanifold_edges, after.nonmanifold_vertices, after.inconsistent_winding_edges) == (
        0,
        0,
        0,
    )
    assert 5_799 <= after.components < 7_500  # libigl's cut: 25,434
    assert (fixed.before.verdict, fixed.after.verdict) == ("bad", "limited")
    assert len(fixed.left) == 1
    assert "close" in fixed.left[0]


def test_maps_give_the_exact_original_row(splat: Asset, fixed: Repaired) -> None:
    old, new = splat.buffers, fixed.asset.buffers
    assert set(old) == set(new)
    for name in ("positions", "f_dc", "opacity"):
        assert np.array_equal(old[name][fixed.vertex_map], new[name])
    corners = np.where(fixed.turned[:, None], [0, 2, 1], [0, 1, 2])
    faces = np.take_along_axis(old["indices"][fixed.face_map], corners, axis=1)
    assert np.array_equal(fixed.vertex_map[new["indices"]], faces)
    assert fixed.asset.manifest.method == "mesh_splatting"
    assert fixed.asset.manifest.settings == splat.manifest.settings


def test_a_second_repair_changes_nothing(fixed: Repaired) -> None:
    assert msb.repair(fixed.asset).asset is fixed.asset


def test_cut_edges_are_the_nonmanifold_edges(splat: Asset, fixed: Repaired) -> None:
    ends = fixed.cut_edges
    assert len(ends) == len(np.unique(ends, axis=0)) == fixed.before.counts.nonmanifold_edges
    assert ends.max() < len(splat.buffers["positions"])


def mesh_asset(points: Any, faces: Any, **buffers: np.ndarray) -> Asset:
    arrays = {"positions": np.asarray(points, np.float32), "indices": np.asarray(faces, np.uint32)}
    return build_asset({**arrays, **buffers}, dict.fromkeys(buffers, "vertex"), Description())


def test_a_plan_is_repeated_until_nothing_changes() -> None:
    done = msb.repair(mesh_asset(*BOOK), "orient,pair")
    assert [step.step for step in done.steps] == ["orient", "pair", "orient"]
    assert done.after.counts.inconsistent_winding_edges == 0


def test_maps_of_several_steps_are_composed() -> None:
    points = np.concatenate([BOOK[0], TETRAHEDRON[0] + 9])
    faces = np.concatenate([[[0, 0, 1]], BOOK[1], (TETRAHEDRON[1] + 5)[1:]])
    done = msb.repair(mesh_asset(points, faces), "drop,orient,close,debris", debris_faces=3, close_share=1)
    assert done.face_map.tolist() == [0, 4, 5, 6, -1]
    assert done.vertex_map.tolist() == [0, 1, 5, 6, 7, 8]
    assert np.array_equal(done.asset.buffers["positions"], points[done.vertex_map].astype(np.float32))
    assert done.after.counts.boundary_edges == 0


def test_steps_of_a_plan_may_have_numbers() -> None:
    plan = parse_plan("weld:0.5,pair:1,debris:3:0.5,close:9", close_share=1)
    assert plan == Options(("weld", "pair", "debris", "close"), 0.5, 1.0, 3, 0.5, 9, 1.0)
    assert parse_plan(None, peer="igl").plan == ("cut",)
    assert parse_plan(["weld"], weld="0.5").weld == 0.5


def test_holes_stay_open_without_close() -> None:
    opened = mesh_asset(TETRAHEDRON[0], TETRAHEDRON[1][1:])
    assert msb.repair(opened).after.counts.boundary_edges == 3
    closed = msb.repair(opened, "orient,pair,close", close_share=1)
    assert (closed.after.verdict, closed.left) == ("ok", ())


def test_weld_turns_a_soup_into_a_mesh_with_static_colours() -> None:
    points = TETRAHEDRON[0][TETRAHEDRON[1].reshape(-1)]
    arrays = {
        "positions": points.astype(np.float32),
        "indices": np.arange(12, dtype=np.uint32).reshape(-1, 3),
        "f_dc": np.random.default_rng(0).random((4, 3), np.float32),
        "opacity": np.array([1, 1, 1, -9], np.float32),
    }
    about = Description("two_dts", coverage={"kernel": "gaussian_power", "gamma": 1.0})
    soup = build_asset(arrays, {"f_dc": "face", "opacity": "face"}, about)
    done = msb.repair(soup, "weld,orient,pair")
    assert done.asset.manifest.method == "mesh"
    assert done.after.verdict == "ok"
    assert done.asset.manifest.vertex_count == 4
    reduced = build_asset(arrays, {"f_dc": "face", "opacity": "face"}, add_threshold(about))
    less = msb.repair(reduced, "weld,orient,pair")
    assert less.face_map.tolist() == [0, 1, 2]
    assert np.array_equal(less.asset.buffers["color"], done.asset.buffers["color"][:3])
    assert msb.repair(soup).asset is soup  # nothing to do without a weld


def add_threshold(about: Description) -> Description:
    from msb.asset.manifest import StoredSetting

    return replace(about, settings={"ste_threshold": StoredSetting(0.5, "flag")})


@pytest.mark.parametrize("method", ["mesh_splatting", "two_dts", "triangle_splatting", "diffsoup"])
def test_every_method_is_kept(method: str) -> None:
    original = msb.open(MODELS / method)
    done = msb.repair(original)
    assert done.asset.manifest.method == method
    assert set(done.asset.buffers) == set(original.buffers)


@pytest.mark.slow
@pytest.mark.parametrize("tier", ["standard", "dedicated"])
def test_nothing_visible_changes(splat: Asset, fixed: Repaired, tier: Any) -> None:
    camera = msb.Camera.look_at(
        (1.5, 1.2, 1.4), (0.5, 0.5, 0.5), up=(0, 0, 1), width=320, height=240, fov_y=0.8
    )
    was, now = (msb.render(asset, camera, tier=tier).image for asset in (splat, fixed.asset))
    assert msb.metrics.psnr(now, was) > 70


@pytest.mark.slow
def test_a_turned_lattice_renders_as_before() -> None:
    original = msb.open(MODELS / "diffsoup")
    faces = original.buffers["indices"].copy()
    faces[::7] = faces[::7, ::-1]  # this changes the rendering and reverses the winding
    specs = original.manifest.buffers
    domains = {name: spec.domain for name, spec in specs.items()}
    flipped = build_asset({**original.buffers, "indices": faces}, domains, Description.of(original.manifest))
    done = msb.repair(flipped, "orient")
    assert done.turned.any()
    camera = msb.Camera.look_at((0, -3, 1), (0, 0, 0), up=(0, 0, 1), width=160, height=120, fov_y=0.8)
    was, now = (msb.render(asset, camera, tier="dedicated").image for asset in (flipped, done.asset))
    assert msb.metrics.psnr(now, was) > 50


def test_non_finite_positions_are_rejected() -> None:
    buffers = {
        "positions": np.array([[0, 0, 0], [1, np.nan, 0], [0, 1, 0]]),
        "indices": np.array([[0, 1, 2]]),
    }
    with pytest.raises(MeshError) as caught:
        run_plan(buffers, {}, Options())
    assert caught.value.code == "MESH_NONFINITE"


def test_faces_that_are_not_finite_are_dropped_with_their_values() -> None:
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [np.nan, 0, 1], [np.inf, 0, 0]])
    buffers = {
        "positions": positions,
        "indices": np.array([[0, 1, 2], [1, 3, 4], [1, 3, 2]]),
        "color": np.arange(18, dtype=np.uint8).reshape(6, 3),
    }
    done = run_plan(buffers, {"color": "vertex"}, Options(plan=("orient", "pair")))
    assert done.after.counts.nonfinite_faces == 0
    assert (done.face_map.tolist(), done.vertex_map.tolist()) == ([0, 2], [0, 1, 2, 3])
    assert np.array_equal(done.buffers["color"], buffers["color"][:4])
    assert "face 1" in done.steps[0].notes[0]


@pytest.mark.parametrize("faces", [np.zeros((0, 3), int), np.array([[0, 0, 1]]), np.array([[0, 1, 2]] * 3)])
def test_meshes_with_degenerate_or_duplicate_faces_are_repaired(faces: np.ndarray) -> None:
    buffers = {"positions": np.eye(4, 3), "indices": faces}
    every = ("weld", "orient", "pair", "cut", "drop", "debris", "close")
    done = run_plan(buffers, {}, Options(every, debris_faces=1))
    assert done.after.counts.nonmanifold_edges == 0


def test_debris_split_off_by_cutting_a_one_sided_strip_is_removed() -> None:
    faces = np.concatenate([strip(8, 2), [[1, 4, 24]]])  # a third face at an edge of the strip
    buffers = {"positions": np.random.default_rng(1).random((25, 3)), "indices": faces}
    for plan in ("debris:2,orient", "orient,debris:2"):
        done = run_plan(buffers, {}, parse_plan(plan))
        assert (done.before.counts.nonmanifold_edges, done.after.counts.components) == (1, 1)
        assert len(done.face_map) == len(faces) - 1


def test_a_mesh_keeps_its_precision_and_both_kinds_of_colours() -> None:
    points = BOOK[0].astype(np.float64) + 1e-12
    colors, shades = np.arange(15, dtype=np.uint8).reshape(5, 3), np.arange(9, dtype=np.uint8).reshape(3, 3)
    repaired, done = repair_mesh(Mesh(points, BOOK[1], colors, shades), Options())
    assert repaired.vertices.dtype == np.float64
    assert np.array_equal(repaired.vertices, points[done.vertex_map])
    assert np.array_equal(repaired.vertex_colors, colors[done.vertex_map])
    assert np.array_equal(repaired.face_colors, shades)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ({"plan": "orient,polish"}, "USAGE"),
        ({"plan": []}, "USAGE"),
        ({"peer": "meshfix"}, "USAGE"),
        ({"peer": "igl", "plan": "orient,pair"}, "USAGE"),
        ({"plan": "weld:0.1:2"}, "USAGE"),
        ({"plan": "orient:1"}, "USAGE"),
        ({"plan": "debris:few"}, "USAGE"),
        ({"plan": "debris:1,close,debris:2"}, "USAGE"),
        ({"plan": "close:8:-1"}, "USAGE"),
        ({"close_edges": -1}, "USAGE"),
        ({"weights": np.ones(3), "plan": "drop"}, "USAGE"),
        ({"weld": "near", "plan": "weld"}, "WELD_DISTANCE"),
        ({"plan": "debris", "debris_faces": 99}, "TRIASSET_EMPTY"),
    ],
)
def test_invalid_arguments_are_rejected(arguments: dict[str, Any], code: str) -> None:
    with pytest.raises(MsbError) as caught:
        msb.repair(mesh_asset(*TETRAHEDRON), **arguments)
    assert caught.value.code == code


@pytest.mark.oracle
@pytest.mark.slow
@pytest.mark.parametrize(("peer", "step"), [("igl", "cut"), ("pymeshlab", "drop")])
def test_a_step_can_be_done_by_another_library(splat: Asset, peer: str, step: str) -> None:
    pytest.importorskip(peer)
    done = repair_asset(splat, Options((step,), peer=peer))
    assert done.after.counts.nonmanifold_edges == 0
    assert peer in done.steps[0].notes[0]
    same = splat.buffers["f_dc"][done.vertex_map]
    assert np.array_equal(done.asset.buffers["f_dc"], same)


@pytest.mark.oracle
def test_a_library_that_exceeds_its_time_limit_is_ended() -> None:
    pytest.importorskip("igl")
    with pytest.raises(MsbError) as caught:
        repair_asset(mesh_asset(*BOOK), Options(("cut",), peer="igl", limits=Limits(0.001)))
    assert caught.value.code == "PEER_FAILED"


def corner_uvs(asset: Asset) -> np.ndarray:
    uvs = asset.buffers["uv"]
    by_vertex = asset.manifest.buffers["uv"].domain == "vertex"
    return uvs[asset.buffers["indices"].reshape(-1)] if by_vertex else uvs


@pytest.mark.parametrize("by", ["vertex", "corner"])
def test_a_closed_asset_has_nothing_to_repair(by: str) -> None:
    asset = asset_from_mesh(textured_cube(by))
    done = msb.repair(asset, "weld,orient,pair,drop,debris,close")
    assert done.asset is asset
    assert (done.before.verdict, done.left, len(done.cut_edges)) == ("ok", (), 0)


@pytest.mark.parametrize("by", ["vertex", "corner"])
def test_a_hole_is_closed_and_the_texture_is_unchanged(by: str, tmp_path: Any) -> None:
    asset = asset_from_mesh(textured_cube(by, slice(0, 11)))
    done = msb.repair(asset, "close")
    assert (done.before.verdict, done.after.verdict, done.left) == ("limited", "ok", ())
    repaired = done.asset
    assert np.array_equal(repaired.buffers["texture.0"], TEXTURE)
    assert repaired.manifest.appearance == asset.manifest.appearance
    assert (repaired.manifest.vertex_count, repaired.manifest.face_count) == (8, 12)
    assert np.array_equal(asset.buffers["positions"][done.vertex_map], repaired.buffers["positions"])
    assert np.array_equal(corner_uvs(repaired)[:33], corner_uvs(asset))
    # The UVs of the cap lie on the edge that it shares with its neighbour. They do not lie between the
    # charts.
    cap = corner_uvs(repaired)[33:]
    ends = [uv for uv in np.unique(cap, axis=0) if (corner_uvs(asset) == uv).all(axis=1).any()]
    assert len(ends) == 2
    assert (cap == np.mean(ends, axis=0, dtype=np.float32)).all(axis=1).sum() == 1
    msb.save(repaired, tmp_path / "repaired.triasset")
    assert [
        entry for entry in msb.validate(tmp_path / "repaired.triasset").findings if entry.severity != "info"
    ] == []


@pytest.mark.parametrize("plan", ["orient,pair", "orient,cut", "drop,orient", "close", "debris:2"])
def test_split_vertices_do_not_change_a_repair(plan: str) -> None:
    points, faces = torus(6, 6)
    points = np.concatenate([points, np.eye(4, 3, dtype=np.float32) + 5])
    # Add a hole, a third face at an edge, a lone face, and a face of opposite winding.
    faces = np.concatenate([np.delete(faces, 20, axis=0), [[0, 1, 36], [37, 38, 39]]])
    faces[5] = faces[5, ::-1]
    uvs = np.random.default_rng(3).integers(0, 3, (faces.size, 2)).astype(np.float32)
    # Do not split the edge of three faces, because its copies could be paired in several ways.
    uvs[np.isin(faces.reshape(-1), [0, 1])] = 0
    texture = {"textures": (TEXTURE,)}
    stored, rows, values = doubled(points, faces, uvs)
    merged, done = repair_mesh(Mesh(points, faces, corner_uvs=uvs, **texture), parse_plan(plan))
    split, again = repair_mesh(Mesh(stored, rows, vertex_uvs=values, **texture), parse_plan(plan))
    assert len(merged.faces) == len(split.faces)
    assert replace(again.after.counts, vertices=0) == replace(done.after.counts, vertices=0)
    assert np.array_equal(merged.corner_uvs, split.corner_uvs)
    assert np.array_equal(merged.vertices[merged.faces], split.vertices[split.faces])
    assert np.array_equal(stored[again.vertex_map], split.vertices)


@pytest.mark.parametrize("kinds", [1, 2])
def test_colours_that_differ_at_a_seam_are_kept(kinds: int) -> None:
    colors = np.random.default_rng(0).integers(0, kinds, (36, 3)).astype(np.float32)
    stored, rows, values = doubled(CUBE[0], CUBE[1], colors)
    rows[3] = rows[3, ::-1]
    mesh = Mesh(stored, rows, values)
    repaired, done = repair_mesh(mesh, parse_plan("orient"))
    assert done.after.verdict == "ok"
    assert audit_arrays(repaired.vertices, repaired.faces, attributes=repaired.attributes)[0].verdict == "ok"
    old = values[rows]
    old[done.turned] = old[done.turned][:, [0, 2, 1]]
    assert np.array_equal(repaired.vertex_colors[repaired.faces], old)
    asset = msb.repair(asset_from_mesh(mesh), "orient").asset
    assert asset.manifest.buffers["color"].domain == ("vertex" if kinds == 1 else "corner")


def test_cut_edges_stay_cut_in_a_file() -> None:
    points, faces = np.float32(BOOK[0]), np.asarray(BOOK[1], np.int64)
    mesh = Mesh(points, faces, corner_uvs=np.arange(18, dtype=np.float32).reshape(9, 2), textures=(TEXTURE,))
    for plan in ("orient,pair", "orient,cut"):
        repaired, done = repair_mesh(mesh, parse_plan(plan))
        assert done.before.counts.nonmanifold_edges == 1
        held = fit_to_format(repaired, ".glb")
        counts = audit_arrays(held.vertices, held.faces, attributes=held.attributes)[0].judged.counts
        assert (counts.nonmanifold_edges, counts.nonmanifold_vertices) == (0, 0)


POINTS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
FACES = np.array([[0, 1, 2], [1, 2, 3]], np.uint32)  # both faces use edge 1-2 in the same direction
RNG = np.random.default_rng(0)
BASE = {"positions": POINTS, "indices": FACES}


def turn_second_face() -> Change:
    change = orient(FACES.astype(np.int32), 4)
    assert change.turned.tolist() == [False, True]
    return change


def with_cap() -> Change:
    """Return a change that adds a vertex between the first three vertices, and a face next to the second
    face.
    """
    faces = np.array([[0, 1, 2], [1, 2, 3], [1, 0, 4]])
    rims = Rims(np.array([0, 3]), np.array([0, 1, 2]))
    return Change(
        faces, np.array([0, 1, 2, 3, -1]), np.array([0, 1, -1]), np.zeros(3, bool), rims, np.array([1])
    )


def test_corner_values_are_swapped_when_a_face_is_turned() -> None:
    color = RNG.random((6, 3), np.float32)
    done = carry({**BASE, "color": color}, {"color": "corner"}, turn_second_face())
    assert np.array_equal(done["color"], color[[0, 1, 2, 3, 5, 4]])
    assert done["indices"].dtype == np.uint32
    assert np.array_equal(done["positions"][done["indices"][1]], POINTS[[1, 3, 2]])


@pytest.mark.parametrize("level", [0, 1, 3])
def test_a_lattice_is_permuted_when_a_face_is_turned(level: int) -> None:
    sides = 2**level
    s, y = np.tril_indices(sides + 1)
    weights = np.stack([s - y, y, sides - s], axis=1) / sides  # of the three corners
    value = np.float32([3.0, 5.0, 11.0])
    # The values are a linear function of the position. After the turn, the swapped corners keep their values.
    before = np.stack([weights @ value, weights @ value]).astype(np.float32)
    done = carry(
        {**BASE, "features.opacity": before}, {"features.opacity": "face"}, turn_second_face(), level
    )
    assert np.array_equal(done["features.opacity"][0], before[0])
    np.testing.assert_allclose(done["features.opacity"][1], weights @ value[[0, 2, 1]], rtol=1e-6)
    assert np.array_equal(
        build_lattice_permutation(sides)[build_lattice_permutation(sides)], np.arange(len(s))
    )


def test_added_vertices_and_faces_get_values_of_their_neighbours() -> None:
    buffers = {
        **BASE,
        "color": np.array([[0, 0, 0], [10, 0, 0], [0, 100, 0], [9, 9, 9]], np.uint8),
        "opacity": np.array([1, 2, np.inf, 0], np.float32),
        "sigma": np.array([5, 7], np.float32),
    }
    done = carry(buffers, {"color": "vertex", "opacity": "vertex", "sigma": "face"}, with_cap())
    np.testing.assert_allclose(done["positions"][4], [1 / 3, 1 / 3, 0], rtol=1e-6)
    assert done["color"][4].tolist() == [3, 33, 0]
    assert done["opacity"].tolist() == [1, 2, np.inf, 0, 1]  # an average that includes infinity is undefined
    assert done["sigma"].tolist() == [5, 7, 7]


@pytest.mark.parametrize(
    ("name", "domain", "values", "change"),
    [
        ("of_the_method", "face", np.zeros((2, 4), np.float32), turn_second_face()),
        # A lattice of level 1 has 6 samples, not 4.
        ("features.lattice", "face", np.zeros((2, 4, 7), np.float32), turn_second_face()),
        ("of_the_method", "face", np.zeros((2, 4), np.float32), with_cap()),
        ("of_the_method", "corner", np.zeros((6, 3), np.float32), with_cap()),
        ("of_the_method", "vertex", np.zeros(4, np.uint32), with_cap()),
    ],
)
def test_buffers_that_cannot_be_carried_are_reported(
    name: str, domain: str, values: np.ndarray, change: Change
) -> None:
    with pytest.raises(Unsupported, match=name) as caught:
        carry({**BASE, name: values}, {name: domain}, change, 1)
    assert caught.value.code == "UNSUPPORTED_REPAIR"


def test_unknown_face_buffers_are_carried_if_no_face_is_turned() -> None:
    strange = np.zeros((2, 4), np.float32)
    same = unchanged(FACES.astype(np.int32), 4)
    assert np.array_equal(carry({**BASE, "odd": strange}, {"odd": "face"}, same)["odd"], strange)

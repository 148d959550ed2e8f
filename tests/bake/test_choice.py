"""Which geometry a bake takes, and what each shows: golden decibels of trained models, which are solids."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import msb
from msb.bake import making
from msb.bake.lessons import Lessons
from msb.bake.making import Bake
from msb.errors import AssetError
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.meshes.mesh import Mesh
from msb.topology import audit_arrays
from msb.topology.crossings import crossing_pairs
from tests.bake.conftest import COLORS, solid
from tests.bake.soups import MODELS, all_round, ball, ring, soup_of, sparse
from tests.conftest import TETRAHEDRON

GOLDEN = {"kept": 25.76, "fitted": 26.20, "surface": 26.50}
"""dB to the native rendering with 16 samples, on held-out views."""


@pytest.mark.slow
@pytest.mark.parametrize("geometry", GOLDEN)
def test_each_geometry_shows_what_it_did(geometry: Any) -> None:
    """One seed gives one mesh."""
    scene = sparse("nerf_synthetic/pebble", "triangle_splatting")
    model = MODELS / "pebble" / "triangle_splatting"
    options: Any = {"geometry": geometry, "color": "vertex", "seconds": 0}
    made = [msb.bake(model, scene=scene, **options) for _ in range(2)]
    report, (one, two) = made[0].report, (mesh_from_asset(each.asset) for each in made)
    assert report.own.after_16 == pytest.approx(GOLDEN[geometry], abs=0.3)
    assert not report.own.is_worse
    np.testing.assert_array_equal(one.vertices, two.vertices)
    np.testing.assert_array_equal(one.vertex_colors, two.vertex_colors)


SOUP = soup_of(ball(4))
TORN = Mesh(TETRAHEDRON[0], TETRAHEDRON[1][[0, 0, 0]].astype(np.int64), vertex_colors=COLORS)


@pytest.mark.parametrize(
    ("surface", "taken"),
    [(ball(4), "surface"), (TORN, "fitted"), (None, "fitted")],
    ids=["ok", "bad", "none"],
)
def test_a_surface_is_taken_for_solids_unless_it_is_bad(
    monkeypatch: pytest.MonkeyPatch, surface: Mesh | None, taken: str
) -> None:
    def make(soup: Mesh, *_: object, **__: object) -> tuple[Mesh, list[str]]:
        assert soup is SOUP, "it starts from the soup that it is compared with"
        if surface is None:
            raise AssetError("TRIASSET_EMPTY", "it has no volume")
        return surface, []

    monkeypatch.setattr(making, "fitted", lambda *_, **__: (SOUP, []))
    monkeypatch.setattr(making, "surface", make)
    baked = msb.bake(solid(faces=3), cameras=ring(9), for_solid=True, color="vertex", seconds=0)
    assert baked.report.geometry == taken
    assert set(baked.report.tried) == (set() if surface is None else {"fitted", "surface"})


@pytest.mark.slow
def test_kept_triangles_that_are_no_longer_a_solid_give_way_to_a_surface(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(making, "fitted", lambda *_, **__: (SOUP, []))
    monkeypatch.setattr(making, "surface", lambda *_, **__: (ball(4), []))
    model, views = asset_from_mesh(ball(4)), all_round(4, (-1, 1), 3, side=32)
    for open_it, taken in ((False, "kept"), (True, "surface")):
        if open_it:
            monkeypatch.setattr(making, "kept", lambda *_, **__: SOUP)
        made = msb.bake(model, cameras=views, for_solid=True, color="vertex", seconds=0)
        assert (made.report.geometry, made.report.after.level) == (taken, "ok")


def test_a_level_that_is_too_small_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Levels start from vertex colours, also if the asset gets a texture."""
    begun: list[Mesh] = []

    def lods(mesh: Mesh, *_: object, **__: object) -> Iterator[tuple[Mesh, list[str]]]:
        begun.append(mesh)
        yield mesh, []
        raise AssetError("TRIASSET_EMPTY", "nothing is left")

    monkeypatch.setattr(making, "lods", lods)
    options: dict[str, Any] = {"geometry": "kept", "color": "texture", "texture": 16, "lods": "0.5,0.2,0.1"}
    baked = msb.bake(asset_from_mesh(soup_of(ball(4))), cameras=ring(3), **options)
    assert [level.share for level in baked.report.lods] == [0.5]
    assert any("0.2" in note for note in baked.report.notes)
    assert begun[0].vertex_colors is not None
    assert not begun[0].textures


@pytest.mark.slow
def test_geometries_are_compared_in_colours_without_the_validation_views(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    poses: list[set[bytes]] = []

    def colored(bake: Bake, name: Any, mesh: Mesh, look: Any, lessons: Lessons, *size: Any) -> Mesh:
        poses.append({camera.world_to_camera.tobytes() for camera in lessons.cameras})
        return fit(bake, name, mesh, look, lessons, *size)

    fit = Bake._colored
    monkeypatch.setattr(Bake, "_colored", colored)
    msb.bake(solid(), cameras=ring(9), color="vertex", seconds=0)
    assert poses[0] == poses[1] < poses[2]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "scene"),
    [
        ("pebble/triangle_splatting", "nerf_synthetic/pebble"),
        ("walled/mesh_splatting", "mipnerf360/pebble"),
    ],
)
def test_other_libraries_find_it_closed_manifold_and_oriented(model: str, scene: str) -> None:
    igl = pytest.importorskip("igl", reason="extra trial is not installed")
    manifold3d = pytest.importorskip("manifold3d", reason="extra trial is not installed")
    baked = msb.bake(
        MODELS / model,
        scene=sparse(scene, model.partition("/")[2]),
        geometry="surface",
        color="vertex",
        seconds=0,  # a search that ends by the clock would make another mesh on a busy machine
    )
    buffers = baked.asset.buffers
    vertices, faces = np.array(buffers["positions"]), np.array(buffers["indices"], np.int64)
    assert audit_arrays(vertices, faces)[0].verdict == "ok"
    assert len(crossing_pairs(vertices[faces].astype(np.float64))) == 0
    assert igl.is_edge_manifold(faces)[0]
    assert np.all(igl.is_vertex_manifold(faces))
    assert len(igl.boundary_facets(faces)[0]) == 0
    np.testing.assert_array_equal(igl.bfs_orient(faces)[0], faces)
    solid = manifold3d.Manifold(manifold3d.Mesh(vertices, faces.astype(np.uint32)))
    assert solid.status() == manifold3d.Error.NoError
    assert solid.num_tri() >= 0.999 * len(faces)  # it collapses edges below its precision
    if model.startswith("pebble"):
        assert solid.volume() > 0
        pytest.importorskip("msb.trial")
        outcomes = {one.task: one.outcome for one in msb.trial(baked.asset, ["boolean", "solid"])}
        assert outcomes == {"boolean": "works", "solid": "works"}

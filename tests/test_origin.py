"""Everything that uses an asset in map coordinates together with cameras: the same images as at zero."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import asset_from_mesh, mesh_from_asset
from msb.render.shares import shares_by_view
from msb.scenes import Camera
from msb.scenes.around import find_bulk, make_turntable, place_inside
from msb.scenes.framing import find_framing
from msb.views import choose_views, generate_views, render_standard
from tests.meshes.test_origin import UTM, ball, far_ball


def around(at: Any = 0.0, count: int = 9) -> list[Camera]:
    """Return cameras around a ball at `at`."""
    cameras = make_turntable(asset_from_mesh(ball()), count, 64, 48)
    return [camera.relative_to(-np.asarray(at)) if np.any(at) else camera for camera in cameras]


def test_images_equal_those_at_zero() -> None:
    near, far = asset_from_mesh(ball()), asset_from_mesh(far_ball())
    assert far.manifest.origin == tuple(UTM)
    for here, there in zip(around(), around(UTM), strict=True):
        expected, frame = (msb.render(asset, camera) for asset, camera in ((near, here), (far, there)))
        assert (frame.face_id == expected.face_id).all()
        assert np.abs(frame.image - expected.image).max() < 1e-3
        assert np.abs(frame.depth - expected.depth).max() < 1e-5


def test_a_mesh_is_drawn_where_it_is() -> None:
    expected = render_standard(ball(), around())
    for image, other in zip(render_standard(far_ball(), around(UTM)), expected, strict=True):
        assert np.abs(image - other).max() < 1e-3


def test_contributions_of_faces_equal_those_at_zero() -> None:
    pairs = [(asset_from_mesh(ball()), around()), (asset_from_mesh(far_ball()), around(UTM))]
    near, far = (
        list(shares_by_view(asset, [(camera, None) for camera in cameras], tier="standard"))
        for asset, cameras in pairs
    )
    assert all((a == b).all() for a, b in zip(near, far, strict=True))


@pytest.mark.parametrize("kind", ["outside", "inside"])
def test_generated_views_are_in_the_scene(kind: Any) -> None:
    near, far = (choose_views(asset_from_mesh(mesh), kind=kind) for mesh in (ball(), far_ball()))
    assert near.origin == far.origin
    for here, there in zip(near.cameras, far.cameras, strict=True):
        assert np.abs(there.center - UTM - here.center).max() < 1e-4
        assert np.abs(there.world_to_camera[:3, :3] - here.world_to_camera[:3, :3]).max() < 1e-6


def test_the_kind_of_views_is_that_at_zero() -> None:
    # A room: a ball that is wound inwards.
    for move in (0.0, UTM):
        mesh = replace(ball(), vertices=ball().vertices + move, faces=ball().faces[:, ::-1].copy())
        asset = asset_from_mesh(mesh)
        outside, framing = make_turntable(asset, 8), find_framing(asset)
        assert generate_views(asset, outside, framing).origin == "inside"
        assert len(place_inside(asset, framing, find_bulk(asset, framing), outside)) == 8


def test_causes_equal_those_at_zero() -> None:
    pytest.importorskip("msb.why")
    near, far = (
        msb.why(asset_from_mesh(mesh), cameras)
        for mesh, cameras in ((ball(), around()), (far_ball(), around(UTM)))
    )
    for here, there in zip(near, far, strict=True):
        assert (here.applies, here.reason) == (there.applies, there.reason)
        if here.db is not None:
            assert there.db == pytest.approx(here.db, abs=0.1)


@pytest.mark.slow  # runs libraries in child processes
def test_trials_equal_those_at_zero_and_save_results_in_the_scene(tmp_path: Path) -> None:
    pytest.importorskip("msb.trial")
    pytest.importorskip("manifold3d")
    pytest.importorskip("fast_simplification")
    from msb.trial.run import try_asset

    numbers = []
    for name, mesh in (("near", ball()), ("far", far_ball())):
        (tmp_path / name).mkdir()
        tried = try_asset(
            asset_from_mesh(mesh),
            ["solid", "decimate_50"],
            cameras=around(0.0 if name == "near" else UTM),
            keep=tmp_path / name,
        )
        numbers.append({trial.task: trial.numbers for trial in tried.trials})
        for path in (tmp_path / name).glob("decimate*.glb"):
            middle = 0.0 if name == "near" else UTM
            assert np.abs(read_mesh(path).vertices - middle).max() < 1.1
    near, far = (by_task["solid"]["volume"] for by_task in numbers)
    assert far == pytest.approx(near, rel=1e-5)


@pytest.mark.slow
def test_a_bake_is_in_the_scene(tmp_path: Path) -> None:
    pytest.importorskip("msb.bake")
    model = asset_from_mesh(far_ball())
    cameras = around(UTM)
    baked = msb.bake(model, cameras=cameras, geometry="kept", color="vertex", collision="box")
    assert baked.asset.manifest.origin == model.manifest.origin
    assert baked.report.native is not None
    assert baked.report.native.after_16 is not None
    assert baked.report.native.after_16 > 25
    assert np.abs(baked.preview.cameras[0].center - UTM).max() < 10
    baked.save(tmp_path / "ball.glb", tmp_path / "ball.triasset")
    for name in ("ball.glb", "ball.triasset", "ball_collision.glb", "ball_collision.triasset"):
        asset = msb.open(tmp_path / name)
        assert np.abs(asset.vertices - UTM).max() < 2
    # The bake draws like its model.
    image, expected = (msb.render(asset, cameras[0]).image for asset in (baked.asset, model))
    assert np.abs(image - expected).mean() < 0.02


def test_a_camera_of_another_frame_sees_the_same() -> None:
    camera = around(UTM)[0]
    assert camera.relative_to((0, 0, 0)) is camera
    moved = camera.relative_to(UTM)
    point = np.array([0.1, -0.2, 0.3])
    assert np.abs(moved.project(point)[0] - camera.project(point + UTM)[0]).max() < 1e-6
    assert (moved.name, moved.unit) == (camera.name, camera.unit)


def test_engines_draw_relative_to_the_origin() -> None:
    from msb.engines.engine import engine_mesh

    mesh = engine_mesh(asset_from_mesh(far_ball()), None)
    assert np.abs(mesh.positions).max() < 1.1


def test_a_mesh_of_an_asset_is_in_the_scene() -> None:
    mesh: Mesh = mesh_from_asset(asset_from_mesh(far_ball()))
    assert mesh.vertices.dtype == np.float64
    assert np.abs(mesh.vertices - far_ball().vertices).max() < 1e-6

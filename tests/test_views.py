"""Default views for judging a model, and the results of views that do not see the model."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import msb
from data_stubs.surface import icosphere
from msb.asset import build_asset
from msb.delivery.web_quality import ImageLoss
from msb.meshes.assets import mesh_from_asset
from msb.repair.plan import Options
from msb.scenes import write_cameras
from msb.scenes.around import make_turntable
from msb.scenes.framing import find_framing
from msb.views import MAX_TRAINING_VIEWS, choose_views
from tests.conftest import ROOT

Mesh = tuple[NDArray[Any], NDArray[Any]]

MODELS = ROOT / "data_stubs" / "models"
CAPTURE = MODELS / "walled" / "mesh_splatting"


def asset_of(*meshes: Mesh, turned: bool = False) -> msb.Asset:
    """Return all meshes as one asset.

    `turned` reverses every second face, so that the winding is inconsistent.
    """
    starts = np.cumsum([0, *(len(points) for points, _ in meshes)])
    faces = np.concatenate([faces + start for (_, faces), start in zip(meshes, starts, strict=False)])
    if turned:
        faces[::2] = faces[::2, ::-1]
    points = np.concatenate([points for points, _ in meshes])
    return build_asset({"positions": points.astype(np.float32), "indices": faces.astype(np.uint32)}, {})


def ball(scale: float = 1.0, at: float = 0.0) -> Mesh:
    points, faces = icosphere(6)
    return scale * points + [0.0, at, 0.0], faces.astype(np.int64)


def room(height: float, *, inward: bool, lid: bool = False) -> Mesh:
    """Return a finely divided room of width 2. The room has walls and a floor, and with `lid` a ceiling."""
    steps = np.linspace(-1, 1, 9)
    u, v = (part.ravel() for part in np.meshgrid(steps, steps))
    first = np.flatnonzero((u < 1) & (v < 1))
    square = np.concatenate(
        [np.stack([first, first + 9, first + 1], 1), np.stack([first + 1, first + 9, first + 10], 1)]
    )
    points, faces = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            if axis == 1 and side > 0 and not lid:
                continue
            corner = np.zeros((81, 3))
            corner[:, axis], corner[:, (axis + 1) % 3], corner[:, (axis + 2) % 3] = side, u, v
            faces.append((square[:, ::-1] if side > 0 else square) + 81 * len(points))
            points.append(corner * [1, height, 1])
    joined = np.concatenate(faces)
    return np.concatenate(points), joined[:, ::-1] if inward else joined


def triangle(size: float, at: NDArray[Any]) -> Mesh:
    return size * np.eye(3) + at, np.arange(3)[None]


def spike(length: float) -> Mesh:
    """Return the ball with one vertex pulled out."""
    points, faces = ball()
    points[100] *= length
    return points, faces


def far_mesh(count: int, reach: float, size: float = 0.1) -> list[Mesh]:
    """Return triangles in all directions, up to `reach` away."""
    random = np.random.default_rng(1)
    ways = random.normal(size=(count, 3))
    distances = np.geomspace(3, reach, count)[:, None]
    return [triangle(size, at) for at in distances * ways / np.linalg.norm(ways, axis=1, keepdims=True)]


def sky() -> Mesh:
    points, faces = ball(1000)
    return points, faces[:: len(faces) // 7]


@pytest.mark.parametrize(
    ("outliers", "meshes"),
    [
        pytest.param(1, [ball(), triangle(0.1, np.full(3, 3.0))], id="near"),
        pytest.param(1, [ball(), triangle(0.1, np.full(3, 1e4))], id="far"),
        pytest.param(1, [ball(), triangle(50, np.full(3, 300.0))], id="large"),
        pytest.param(40, [ball(), *far_mesh(40, 200)], id="floaters"),
        pytest.param(8, [ball(), sky()], id="sky"),
        pytest.param(0, [ball(), (np.full((1, 3), 9.0), np.zeros((0, 3), int))], id="loose-vertex"),
        pytest.param(0, [ball(), triangle(0, np.full(3, 9.0))], id="no-area"),
    ],
)
def test_far_outliers_do_not_move_the_views(outliers: int, meshes: list[Mesh]) -> None:
    clean, asset = asset_of(ball()), asset_of(*meshes)
    framing = find_framing(asset)
    assert framing.left_out
    assert framing.framed is not None
    assert framing.framed.sum() == len(ball()[1])
    assert (framing.center, framing.radius) == tuple(vars(clean.manifest.bounding_sphere).values())
    poses = [[view.world_to_camera.tobytes() for view in make_turntable(a, 3)] for a in (clean, asset)]
    assert poses[0] == poses[1]
    chosen = choose_views(asset)
    assert chosen.origin == "turntable"
    assert framing.left_out in chosen.description
    counted = f"{outliers} of " in framing.left_out
    assert counted == bool(outliers)


def test_a_spike_is_not_framed() -> None:
    whole, framing = asset_of(ball()).manifest.bounding_sphere, find_framing(asset_of(spike(30)))
    assert framing.radius == pytest.approx(whole.radius, rel=0.1)
    assert "extend far beyond" in framing.left_out


@pytest.mark.parametrize(
    "meshes",
    [
        pytest.param([ball()], id="ball"),
        pytest.param([ball(), triangle(0.1, np.full(3, 0.9))], id="beside"),
        pytest.param([ball(), ball(0.8, at=40)], id="two"),
        pytest.param([ball(), ball(0.1, at=20)], id="as-many-faces"),
        pytest.param([room(0.01, inward=False), ball(0.1)], id="plate"),
        pytest.param([(ball()[0] * [0.01, 50, 0.01], ball()[1])], id="rod"),
    ],
)
def test_what_carries_area_or_faces_is_framed(meshes: list[Mesh]) -> None:
    asset = asset_of(*meshes)
    framing, whole = find_framing(asset), asset.manifest.bounding_sphere
    assert (framing.center, framing.radius, framing.framed) == (whole.center, whole.radius, None)
    assert not framing.left_out


def diorama() -> msb.Asset:
    """Return small balls on a large disc, all wound outwards. Large faces surround most of the scene."""
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = np.stack([4 * np.cos(angles), np.zeros(24), 4 * np.sin(angles)], axis=1)
    corners = np.arange(24)
    disc = np.stack([np.full(24, 24), np.roll(corners, -1), corners], axis=1)
    return asset_of((np.concatenate([rim, np.zeros((1, 3))]), disc), ball(0.5, at=0.6), ball(0.3, at=1.4))


def test_a_diorama_is_viewed_from_outside_unless_requested() -> None:
    asset = diorama()
    chosen = choose_views(asset)
    assert (chosen.origin, len(chosen.cameras)) == ("turntable", 8)
    inside, both = (choose_views(asset, kind=kind) for kind in ("inside", "both"))
    assert (inside.origin, len(inside.cameras)) == ("inside", 8)
    assert (both.origin, len({view.name for view in both.cameras})) == ("both", 16)
    cameras = [view.world_to_camera.tobytes() for view in (*chosen.cameras, *inside.cameras)]
    assert cameras == [view.world_to_camera.tobytes() for view in both.cameras]
    room_of = asset_of(room(1.0, inward=True, lid=True))
    assert choose_views(room_of).origin == "inside"
    assert choose_views(room_of, kind="outside").origin == "turntable"


def test_views_inside_a_flat_mesh_are_rejected() -> None:
    flat = asset_of(triangle(1, np.zeros(3)))
    assert choose_views(flat, kind="both").origin == "turntable"
    with pytest.raises(msb.MsbError) as caught:
        choose_views(flat, kind="inside")
    assert caught.value.code == "USAGE"


def test_requested_views_replace_training_cameras(tmp_path: Path) -> None:
    asset_of(ball()).save(tmp_path / "a.triasset")
    write_cameras(make_turntable(asset_of(ball()), 2, 48, 36), tmp_path / "cameras.json")
    asset = msb.load(tmp_path / "a.triasset")
    assert [choose_views(asset, kind=kind).origin for kind in (None, "outside")] == ["training", "turntable"]


@pytest.mark.parametrize(("strangers", "origin"), [(2, "training"), (3, "turntable")])
def test_training_cameras_of_another_model_are_not_used(strangers: int, origin: str, tmp_path: Path) -> None:
    """A folder can hold several models and the cameras of one model, which see another by chance."""
    asset_of(ball()).save(tmp_path / "a.triasset")
    cameras = [*make_turntable(asset_of(ball()), 2, 48, 36), *elsewhere(strangers)]
    write_cameras([replace(c, name=f"{k}") for k, c in enumerate(cameras)], tmp_path / "cameras.json")
    assert choose_views(msb.load(tmp_path / "a.triasset")).origin == origin


@pytest.mark.slow
def test_nothing_is_judged_where_the_mesh_is_a_speck() -> None:
    repairs = pytest.importorskip("msb.trial.repairs")
    why = pytest.importorskip("msb.why").why
    asset = asset_of(ball(), ball(at=60))
    chosen = choose_views(asset).without_blind(asset)
    assert chosen.coverage is not None
    assert 0 < chosen.coverage < 0.01
    assert chosen.why_not is not None
    (tried,) = msb.trial(asset, ["decimate_50"])
    assert tried.outcome == "not_run"
    assert str(tried.why).endswith(chosen.why_not)
    assert not any(cause.applies for cause in why(asset))
    rows = repairs.compare(asset, None, Options(), tasks=())
    assert all(look.why for row in rows for look in (row.looks or {}).values())
    mesh = mesh_from_asset(asset)
    images = ImageLoss.of(mesh, asset)
    assert images.why_not is not None
    assert images.describe(mesh) == ""
    assert ImageLoss.of(mesh_from_asset(asset_of(ball())), None).why_not is None
    near = [view.scaled(0.1) for view in make_turntable(asset_of(ball()), 2)]
    assert choose_views(asset, near).without_blind(asset).why_not is None


@pytest.mark.parametrize(
    ("origin", "asset"),
    [
        pytest.param("turntable", asset_of(ball()), id="ball"),
        pytest.param("turntable", asset_of(ball(), turned=True), id="ball-soup"),
        pytest.param("inside", asset_of((ball()[0], ball()[1][:, ::-1])), id="ball-inward"),
        pytest.param("turntable", asset_of(room(1.0, inward=False)), id="room-outward"),
        pytest.param("inside", asset_of(room(1.0, inward=True)), id="room"),
        pytest.param(
            "inside", asset_of(room(1.0, inward=True), ball(0.25, at=-0.75)), id="room-with-a-thing"
        ),
        pytest.param(
            "inside", asset_of(room(1.0, inward=False), ball(0.25, at=-0.75), turned=True), id="soup-of-them"
        ),
        pytest.param("turntable", asset_of(room(0.3, inward=True)), id="low-room"),
        pytest.param("turntable", asset_of(room(0.5, inward=False, lid=True), ball(0.25)), id="box"),
        pytest.param("turntable", msb.load(ROOT / "data_stubs" / "splat_like.triasset"), id="splat"),
        pytest.param("turntable", msb.open(MODELS / "pebble" / "triangle_splatting"), id="pebble"),
        pytest.param("turntable", msb.open(MODELS / "pebble" / "diffsoup"), id="no-static-colour"),
        pytest.param("inside", msb.open(MODELS / "walled" / "two_dts"), id="walled"),
        pytest.param("inside", msb.open(MODELS / "walled" / "diffsoup"), id="walled-no-static-colour"),
    ],
)
def test_interiors_get_views_from_inside(origin: str, asset: msb.Asset) -> None:
    asset = replace(asset, opened_from=None)  # some models have training cameras beside their file
    for scale in (1e-4, 1.0, 1e4):
        positions = asset.buffers["positions"] * np.float32(scale)
        if asset.manifest.method != "mesh":
            positions, scale = asset.buffers["positions"], 1.0
        same = build_asset({"positions": positions, "indices": asset.buffers["indices"]}, {})
        chosen = choose_views(same if asset.manifest.method == "mesh" else asset)
        assert (chosen.origin, len(chosen.cameras)) == (origin, 8)
        assert chosen.without_blind(asset if scale == 1 else same).description == chosen.description


def test_training_cameras_are_found_beside_the_model_or_in_its_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    chosen = choose_views(msb.open(CAPTURE))
    from_scene = f"{MAX_TRAINING_VIEWS} of 57 training cameras (pebble)"
    assert (chosen.origin, chosen.description) == ("training", from_scene)
    assert max(chosen.cameras[0].width, chosen.cameras[0].height) == 640
    moved = tmp_path / "models" / "mine"
    shutil.copytree(CAPTURE, moved)
    asset = msb.open(moved)
    assert choose_views(asset).origin == "inside"
    shutil.copytree(
        ROOT / "data_stubs/scenes/mipnerf360/pebble/sparse", tmp_path / "mipnerf360/pebble/sparse"
    )
    assert choose_views(asset).description == from_scene
    write_cameras(chosen.cameras[:3], moved / "cameras.json")
    (file,) = moved.rglob("*.pt")
    assert choose_views(msb.open(file)).description == "3 training cameras (cameras.json)"
    write_cameras(elsewhere(), moved / "cameras.json")
    assert choose_views(asset).description.endswith("(pebble)"), "the cameras beside the model do not see it"


def test_the_config_of_two_dts_leads_to_its_scene(tmp_path: Path) -> None:
    shutil.copytree(MODELS / "walled" / "two_dts", tmp_path / "model")
    scene = ROOT / "data_stubs/scenes/mipnerf360/pebble"
    with (tmp_path / "model" / "config.yaml").open("a") as file:
        file.write(f"dataset:\n  local_dir: {scene}\n")
    chosen = choose_views(msb.open(tmp_path / "model"))
    assert chosen.description.endswith("training cameras (pebble)")


def elsewhere(count: int = 1) -> list[msb.Camera]:
    size: dict[str, Any] = {"width": 32, "height": 24, "fov_y": 0.8}
    return [msb.Camera.look_at((0, 0, 50 + k), (0, 0, 90), up=(0, 1, 0), **size) for k in range(count)]


@pytest.mark.slow
def test_nothing_is_measured_without_a_view_that_sees_the_asset() -> None:
    repairs = pytest.importorskip("msb.trial.repairs")
    why = pytest.importorskip("msb.why").why
    asset = asset_of(ball())
    (tried,) = msb.trial(asset, ["decimate_50"], cameras=elsewhere())
    assert tried.outcome == "not_run"
    assert tried.why
    assert {numbers["psnr"] for numbers in tried.numbers.values() if isinstance(numbers, dict)} == {None}
    causes = why(asset, elsewhere())
    assert {(cause.applies, cause.db) for cause in causes} == {(False, None)}
    (reason,) = {str(cause.reason) for cause in causes if cause.name in ("shading", "back_faces")}
    assert tried.why.endswith(reason)
    rows = repairs.compare(asset, elsewhere(), Options(), tasks=())
    comparisons = [look for row in rows for look in (row.looks or {}).values()]
    assert not any(look.same or look.psnr is not None for look in comparisons)
    assert all(look.why for look in comparisons)


def test_blind_views_are_ignored() -> None:
    asset = asset_of(ball())
    seeing = make_turntable(asset, 2, 48, 36)
    some = choose_views(asset, [*elsewhere(6), *seeing]).without_blind(asset)
    assert some.cameras == seeing
    why = pytest.importorskip("msb.why").why
    alone, beside = (why(asset, cameras) for cameras in (seeing, [*elsewhere(6), *seeing]))
    assert [cause.db for cause in alone] == [cause.db for cause in beside]


@pytest.mark.slow
def test_blind_views_are_ignored_in_trials() -> None:
    pytest.importorskip("msb.trial")
    asset = asset_of(ball())
    seeing = make_turntable(asset, 2, 48, 36)
    (alone,) = msb.trial(asset, ["decimate_10"], cameras=seeing)
    (beside,) = msb.trial(asset, ["decimate_10"], cameras=[*elsewhere(6), *seeing])
    assert alone.numbers == beside.numbers


def test_an_empty_list_of_cameras_is_rejected() -> None:
    with pytest.raises(msb.MsbError) as caught:
        choose_views(asset_of(ball()), [])
    assert caught.value.code == "USAGE"

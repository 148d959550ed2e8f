"""Files that are turned upright, in metres and on the floor: what they hold, and the way back."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset.frame import Frame, make_frame, parse_length, parse_up, unit_vector
from msb.errors import UsageError
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import asset_from_mesh, fit_to_format, mesh_from_asset
from msb.meshes.files import write_whole
from msb.meshes.placement import take_back
from tests.meshes.glb_json import read_json, read_positions

POINTS = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [1, 1, 5]], np.float32)
FACES = np.array([[0, 1, 2], [0, 1, 3], [1, 2, 3]], np.int64)
TILTED = unit_vector((0.1, -0.8, -0.5))


def mesh(up: str | None = "-y", frame: Frame | None = None) -> Mesh:
    return Mesh(POINTS, FACES, up=up, frame=frame)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".glb", ".ply", ".obj", ".usda", ".usdc"])
@pytest.mark.parametrize(
    "frame",
    [
        Frame(TILTED, 0.25, "given scale", -1.5),
        Frame(TILTED),
        Frame(None, 0.5, "1 m"),
        Frame((0.0, 0.0, 1.0)),
    ],
)
def test_every_format_is_read_back_into_the_frame_of_the_capture(
    suffix: str, frame: Frame, tmp_path: Path
) -> None:
    if suffix.startswith(".usd"):
        pytest.importorskip("pxr")
    asset = asset_from_mesh(mesh(frame=frame))
    path = tmp_path / f"a{suffix}"
    msb.save(asset, path)
    again = msb.open(path)
    np.testing.assert_allclose(again.buffers["positions"], POINTS, atol=2e-6)
    wanted, got = asset.manifest, again.manifest
    if wanted.unit is not None and wanted.unit["meters_per_unit"] is not None:
        assert (got.unit, got.floor) == (wanted.unit, wanted.floor)
    assert got.up in (None, wanted.up)
    assert got.coordinate_frame.up == wanted.coordinate_frame.up
    # A second file from the first is the same.
    msb.save(again, tmp_path / f"b{suffix}")
    second = read_mesh(tmp_path / f"b{suffix}")
    np.testing.assert_allclose(second.vertices, POINTS, atol=4e-6)


def test_a_glb_is_upright_in_metres_and_on_the_floor(tmp_path: Path) -> None:
    floor = float((POINTS @ TILTED).min())
    msb.save(asset_from_mesh(mesh(frame=Frame(TILTED, 0.25, "", floor))), tmp_path / "a.glb")
    stored = read_positions(tmp_path / "a.glb")
    np.testing.assert_allclose(stored[:, 1], 0.25 * (POINTS @ TILTED - floor), atol=1e-6)
    assert stored[:, 1].min() == pytest.approx(0, abs=1e-6)
    lengths = np.linalg.norm(POINTS - POINTS[:1], axis=1)
    np.testing.assert_allclose(np.linalg.norm(stored - stored[:1], axis=1), 0.25 * lengths, rtol=1e-5)
    turned = (stored - stored[:1]) / 0.25
    assert np.linalg.det(turned[1:]) == pytest.approx(np.linalg.det(POINTS[1:]), rel=1e-5)  # not mirrored


def test_formats_without_an_up_axis_are_scaled_but_not_turned() -> None:
    held = fit_to_format(mesh(frame=Frame(TILTED, 0.5)), ".ply")
    np.testing.assert_allclose(held.vertices, POINTS / 2)
    upright = fit_to_format(mesh(frame=Frame(TILTED, 0.5)), ".ply", is_upright=True)
    np.testing.assert_allclose(upright.vertices[:, 1], POINTS @ TILTED / 2, atol=1e-6)


def test_files_without_a_frame_are_as_before(tmp_path: Path) -> None:
    for up, suffix in ((None, ".glb"), ("+y", ".glb"), ("-y", ".ply"), ("-y", ".obj")):
        write_whole(fit_to_format(mesh(up), suffix), tmp_path / f"a{suffix}")
        assert b"MeshSplatBench frame" not in (tmp_path / f"a{suffix}").read_bytes()
        assert np.array_equal(read_mesh(tmp_path / f"a{suffix}").vertices, POINTS)
    assert "extras" not in read_json(tmp_path / "a.glb")["asset"]


def test_a_triasset_keeps_the_coordinates_of_the_capture(tmp_path: Path) -> None:
    asset = asset_from_mesh(mesh(frame=Frame(TILTED, 0.25, "1.2m between a and b", 0.5)))
    msb.save(asset, tmp_path / "a.triasset")
    again = msb.open(tmp_path / "a.triasset")
    assert np.array_equal(again.buffers["positions"], POINTS)
    assert again.manifest.version == "1.2"
    assert again.manifest.unit == {"meters_per_unit": 0.25, "source": "1.2m between a and b"}
    assert mesh_from_asset(again).frame == Frame(TILTED, 0.25, "1.2m between a and b", 0.5)
    assert asset_from_mesh(mesh()).manifest.version == "1.0"


VALID: dict[str, Any] = {
    "matrix": np.eye(4).reshape(-1).tolist(), "up": "-y", "meters_per_unit": None, "source": "",
    "floor": None,
}  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        {"matrix": [1] * 15},
        {"matrix": [float("nan")] * 16},
        {"matrix": np.diag([1, 2, 1, 1]).reshape(-1).tolist()},
        {"matrix": np.diag([-1, 1, 1, 1]).reshape(-1).tolist()},
        {"matrix": np.diag([0, 0, 0, 1]).reshape(-1).tolist()},
        {"matrix": "all"},
        {"up": "sky"},
        {"up": [0, 0, 0]},
        {"up": [1, 2]},
        {"meters_per_unit": -1},
        {"meters_per_unit": "long"},
        {"floor": float("inf")},
    ],
)
def test_invalid_records_are_ignored(change: dict[str, Any]) -> None:
    plain = mesh(None)
    assert take_back(plain, VALID | change) is plain
    assert take_back(plain, json.loads("[]")) is plain
    assert take_back(plain, None) is plain


def test_a_valid_record_names_the_axis() -> None:
    assert take_back(replace(mesh(None), up="+y"), VALID).up == "-y"


def test_lengths_and_directions_are_parsed() -> None:
    assert [parse_length(text) for text in ("1.2m", "120 cm", "2km", "1in")] == pytest.approx(
        [1.2, 1.2, 2000, 0.0254]
    )
    assert parse_up("-z") == (0, 0, -1)
    assert parse_up("0,3,4") == pytest.approx((0, 0.6, 0.8))
    frame = make_frame(known_distance=("1,0,0", "1,0,4", "2m"))
    assert frame is not None
    assert frame.meters_per_unit == 0.5
    for bad in ("1", "m", "-1m", "1 parsec", "1e999m"):
        with pytest.raises(UsageError):
            parse_length(bad)
    for bad in ("y", "0,0,0", "1,2", "a,b,c", "nan,0,1"):
        with pytest.raises(UsageError):
            parse_up(bad)

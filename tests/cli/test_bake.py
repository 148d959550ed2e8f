"""`msb bake`: what it writes and says, and what it refuses in one line, with nothing written."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import msb
from msb.asset import build_asset
from msb.bake.lessons import Lessons
from msb.bake.start import Guide
from msb.cli.output import Output
from msb.errors import AssetError, DeviceError, UsageError
from msb.meshes import Mesh, read_mesh
from msb.meshes.assets import asset_from_mesh
from msb.scenes import write_cameras
from tests.bake.test_views import MODELS, SCENE, ring
from tests.cli.conftest import Here, Msb
from tests.conftest import ROOT, TETRAHEDRON

WALLED = ROOT / "data_stubs" / "scenes" / "mipnerf360" / "pebble"
COLORS = np.linspace(0.1, 0.9, 12, dtype=np.float32).reshape(4, 3)


def solid(colors: np.ndarray = COLORS, faces: int = 4, at: float = 0.0) -> msb.Asset:
    points, corners = TETRAHEDRON
    points = points + np.float32(at)
    return asset_from_mesh(Mesh(points, corners[:faces].astype(np.int64), vertex_colors=colors))


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    """Return a plain mesh in colours, and cameras round it."""
    solid().save(tmp_path / "solid.triasset")
    write_cameras(ring(9), tmp_path / "cameras.json")
    return tmp_path / "solid.triasset", tmp_path / "cameras.json"


def about(glb: Path) -> Any:
    """Return the JSON of a GLB."""
    data = glb.read_bytes()
    (size,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + size])


def test_all_outputs_are_written_and_measured(here: Here, files: tuple[Path, Path]) -> None:
    model, cameras = files
    outs = [model.parent / name for name in ("a.glb", "b.triasset", "c.ply")]
    line = ["bake", "--geometry", "kept", "--cameras", cameras, "--json", "-", model]
    result = here(*line, *(word for out in outs for word in ("-o", out)))
    assert result.status == 0, result
    data = result.json
    assert (data["schema"], data["path"], data["output"]) == ("msb.bake/1", str(model), str(outs[0]))
    assert data["bytes"] == outs[0].stat().st_size
    assert (data["geometry"], data["color"], data["texture"], data["faces"]) == ("kept", "vertex", None, 4)
    assert (data["views"]["taught"], data["views"]["held_back"]) == (7, 2)
    # The standard tier is what teaches a plain mesh: with as many samples nothing is lost but by rounding.
    assert data["psnr"]["own"]["after_16"] > 40
    assert data["psnr"]["own"]["before"] == pytest.approx(data["psnr"]["own"]["after"], abs=1)
    assert data["psnr"]["photographs"] is None
    assert data["verdict_before"]["level"] == data["verdict_after"]["level"] == "ok"
    extras = about(outs[0])["asset"]["extras"]["bake"]
    assert extras["psnr"] == data["psnr"]
    assert str(model.parent) not in json.dumps(extras)
    baked = msb.load(outs[1])
    assert baked.buffers["color"].dtype == np.uint8
    assert len(read_mesh(outs[2]).faces) == 4
    again = here(*line, "-o", outs[0])
    again.ends(2, f"OUTPUT_EXISTS: {outs[0]}")
    before = outs[0].read_bytes()
    assert here(*line, "-f", "-o", outs[0]).status == 0
    assert outs[0].read_bytes() == before, "one seed gives one result"


@pytest.mark.slow
def test_levels_and_a_collision_shape_stand_beside_each_output(here: Here, files: tuple[Path, Path]) -> None:
    model, cameras = files
    outs = [model.parent / name for name in ("a.glb", "b.ply")]
    line = ["bake", "--geometry", "kept", "--lods", "0.5", "--collision", "box", "--cameras", cameras, model]
    result = here(*line, "--json", "-", *(word for out in outs for word in ("-o", out)))
    assert result.status == 0, result
    (level,), shape = result.json["lods"], result.json["collision"]
    assert (level["output"], shape["output"]) == tuple(
        str(model.parent / name) for name in ("a_lod1.glb", "a_collision.glb")
    )
    assert (level["share"], shape["kind"], shape["faces"], shape["parts"]) == (0.5, "box", 12, 1)
    assert level["bytes"] == Path(level["output"]).stat().st_size
    assert msb.audit(model.parent / "b_collision.ply").verdict == "ok"
    assert len(read_mesh(model.parent / "b_lod1.ply").faces) == level["faces"]
    again = here(*line, "-o", model.parent / "b.glb", "-o", model.parent / "a_lod1.glb")
    again.ends(2, f"OUTPUT_EXISTS: {model.parent / 'a_lod1.glb'}")


def test_pictures_of_a_cache_make_the_same(here: Here, files: tuple[Path, Path]) -> None:
    model, cameras = files
    cache, outs = model.parent / "cache", [model.parent / name for name in ("a.glb", "b.glb")]
    line = ["bake", "--geometry", "kept", "--cameras", cameras, model, "--cache", cache]
    for out in outs:
        result = here(*line, "-o", out)
        assert result.status == 0, result
    assert "note: 42 of 42 pictures were drawn by a bake before" in result.err
    assert outs[0].read_bytes() == outs[1].read_bytes()
    refused = here(*line[:-1], cameras, "-o", model.parent / "c.glb")
    assert refused.status != 0
    assert f"{cameras} is no folder" in refused.err


@pytest.mark.slow
def test_what_is_printed_is_a_sentence(here: Here, files: tuple[Path, Path]) -> None:
    model, cameras = files
    out = model.parent / "a.stl"
    result = here("bake", "--geometry", "kept", "--cameras", cameras, model, "-o", out)
    assert result.status == 0
    first, second = result.out.splitlines()[:2]
    assert first.startswith(f"{out}: plain mesh before ")
    assert "with 16 samples) to its own look, on 2 views it never used; 4 triangles, 0.00 MB" in first
    assert first.endswith("OK as before")
    assert second == "taught by 7 views and 33 between them, dedicated: 9 cameras given"
    assert f"note: {out}: left out: colours, which .stl has no place for" in result.err
    quiet = here("bake", "-qf", "--geometry", "kept", "--cameras", cameras, model, "-o", out)
    assert (quiet.out.count("\n"), quiet.err) == (1, "")
    verbose = here("bake", "-f", "-v", "--geometry", "kept", "--cameras", cameras, model, "-o", out)
    assert re.search(r"^time went to: (views \d+\.\d s, ).*(, audit \d+\.\d s)$", verbose.err, re.M)


def test_two_views_are_needed_to_state_anything(here: Here, files: tuple[Path, Path]) -> None:
    model, cameras = files
    write_cameras(ring(1), cameras)
    result = here("bake", "--geometry", "kept", "--cameras", cameras, model, "-o", model.parent / "a.glb")
    assert result.status == 0
    assert ": no dB, as no view is held back: that takes two or more; 4 triangles" in result.out
    assert (model.parent / "a.glb").exists()


def test_one_face_is_enough(here: Here, files: tuple[Path, Path]) -> None:
    model, cameras = files
    solid(faces=1).save(model, overwrite=True)
    line = ["bake", "--cameras", cameras, "--geometry", "kept", "--json", "-", model]
    result = here(*line, "-o", model.parent / "a.glb")
    assert (result.status, result.json["faces"]) == (0, 1)


SOLID = {
    "closed": (4, "surface", "the surface is taken, which tools for solids need: "),
    "open": (1, "fitted", "the surface is not taken, as its verdict is BAD: "),
    "none": (0, "fitted", "there is no surface: it has no volume"),
}


@pytest.mark.parametrize(("faces", "chosen", "said"), SOLID.values(), ids=SOLID)
def test_a_surface_is_taken_for_solids_unless_it_is_bad(
    here: Here,
    files: tuple[Path, Path],
    monkeypatch: pytest.MonkeyPatch,
    faces: int,
    chosen: str,
    said: str,
) -> None:
    from msb.bake import making

    made: list[Mesh] = []

    def fitted(*_: object, **__: object) -> tuple[Mesh, list[str]]:
        made.append(Mesh(TETRAHEDRON[0], TETRAHEDRON[1][:3].astype(np.int64), vertex_colors=COLORS))
        return made[-1], []

    def surface(soup: Mesh, *_: object, **__: object) -> tuple[Mesh, list[str]]:
        assert soup is made[0], "it starts from the soup that is compared with it"
        if not faces:
            raise AssetError("TRIASSET_EMPTY", "it has no volume")
        corners = TETRAHEDRON[1][:faces] if faces > 1 else TETRAHEDRON[1][[0, 0, 0]]
        return Mesh(TETRAHEDRON[0], corners.astype(np.int64), vertex_colors=COLORS), ["of the surface"]

    monkeypatch.setattr(making, "fitted", fitted)
    monkeypatch.setattr(making, "surface", surface)
    model, cameras = files
    solid(faces=3).save(model, overwrite=True)
    result = here(
        *("bake", "--for-solid", "--color", "vertex", "--cameras", cameras, model),
        *("--json", "-", "-o", model.parent / "a.glb"),
    )
    assert result.status == 0, result
    data = result.json
    (note,) = (note for note in data["notes"] if note.startswith(said))
    assert (data["geometry"], len(made)) == (chosen, 1)
    assert ("of the surface" in data["notes"]) == (chosen == "surface")
    if faces:
        both = ", ".join(f"{name} {data['tried'][name]:.1f} dB" for name in ("surface", "fitted"))
        assert note.endswith(f": {both} by views kept aside")
        assert f"; {both} by views kept aside; " in data["sentence"]
    else:
        assert data["tried"] == {}


def test_what_is_a_solid_already_is_kept(here: Here, files: tuple[Path, Path]) -> None:
    model, cameras = files
    line = ["bake", "--for-solid", "--cameras", cameras, model, "--json", "-", "-o", model.parent / "a.glb"]
    data = here(*line).json
    assert (data["geometry"], data["faces"], data["verdict_after"]["level"]) == ("kept", 4, "ok")
    assert "its own triangles are kept, which are a solid already" in data["notes"]


REFUSED = {
    "no output": ([], "USAGE: OUT is missing; give -o"),
    "texture": (["-o", "a.glb", "--texture", "100000"], "USAGE: Invalid value for '--texture'"),
    "geometry": (
        ["-o", "a.glb", "--geometry", "solid"],
        'USAGE: geometry is "solid"; it must be one of auto,',
    ),
    "format": (["-o", "a.fbx"], 'USAGE: the output is "a.fbx"; it must end in one of .triasset, '),
    "photographs": (
        ["-o", "a.glb", "--teacher", "photographs"],
        "USAGE: {model}: photographs teach with a scene",
    ),
    "no scene": (["-o", "a.glb", "--scene", "nowhere"], "FILE_NOT_FOUND: nowhere"),
    "both": (["-o", "a.glb", "--scene", "x", "--cameras", "y"], "USAGE: --cameras does not go with --scene"),
    "beside": (["-o", "a.obj", "-o", "b/../a.obj"], "USAGE: "),
    "chosen already": (
        ["-o", "a.glb", "--for-solid", "--geometry", "kept"],
        "USAGE: --for-solid chooses among what --geometry auto makes; leave one out",
    ),
    "seconds": (["-o", "a.glb", "--seconds", "-1"], "USAGE: Invalid value for '--seconds'"),
}


@pytest.mark.parametrize(("words", "said"), REFUSED.values(), ids=REFUSED)
def test_what_is_none_is_one_line(
    here: Here, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    model, _ = files
    monkeypatch.chdir(model.parent)
    before = sorted(model.parent.rglob("*"))
    result = here("bake", model.name, *words)
    assert (result.status in (2, 3, 4), result.out, result.err.count("\n")) == (True, "", 1), result
    assert result.err.startswith(said.format(model=model.name))
    assert sorted(model.parent.rglob("*")) == before


@pytest.mark.parametrize("geometry", ["kept", "auto"])
def test_a_texture_of_a_surface_without_xatlas_is_refused_before_anything_is_drawn(
    here: Here, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, geometry: str
) -> None:
    model, cameras = files
    monkeypatch.setattr("msb.base.extras.is_installed", lambda module: module != "xatlas")
    monkeypatch.setattr("msb.bake.run.bake_views", lambda *_, **__: pytest.fail("it went on"))
    line = ["bake", "--geometry", geometry, "--color", "texture", "--cameras", cameras, model]
    result = here(*line, "-o", model.parent / "a.glb")
    assert result.status == 2
    assert "a texture on a surface needs" in result.err
    assert not (model.parent / "a.glb").exists()


@pytest.mark.parametrize(
    ("module", "words", "said"),
    [
        ("fast_simplification", ["--lods", "0.5"], "a level of detail of a connected mesh needs"),
        ("fast_simplification", ["--collision", "mesh:10"], "a collision mesh mesh:10 needs"),
        ("coacd", ["--collision", "hulls:4"], "a collision mesh hulls:4 needs"),
        ("skimage", ["--collision", "mesh:10"], "what encloses an open mesh needs"),
        ("skimage", ["--geometry", "kept", "--collision", "mesh:10"], ""),
        ("coacd", ["--collision", "box"], ""),
    ],
)
def test_what_more_needs_is_refused_before_anything_is_drawn(
    here: Here,
    files: tuple[Path, Path],
    monkeypatch: pytest.MonkeyPatch,
    module: str,
    words: list[str],
    said: str,
) -> None:
    def went_on(*_: object, **__: object) -> None:
        raise UsageError("USAGE", "it went on")

    model, cameras = files
    monkeypatch.setattr("msb.base.extras.is_installed", lambda name: name != module)
    monkeypatch.setattr("msb.bake.run.bake_views", went_on)
    result = here("bake", *words, "--cameras", cameras, model, "-o", model.parent / "a.glb")
    assert result.status == 2
    assert (said or "it went on") in result.err


def test_a_level_that_is_too_small_is_a_note_and_the_others_are_written(
    here: Here, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def lods(mesh: Mesh, *_: object, **__: object) -> Iterator[tuple[Mesh, list[str]]]:
        assert mesh.vertex_colors is not None
        yield mesh, []
        raise AssetError("TRIASSET_EMPTY", "nothing is left")

    monkeypatch.setattr("msb.bake.making.lods", lods)
    model, cameras = files
    line = ["bake", "--geometry", "kept", "--lods", "0.5,0.2,0.1", "--cameras", cameras, model]
    result = here(*line, "--json", "-", "-o", model.parent / "a.glb")
    assert result.status == 0, result
    assert [level["share"] for level in result.json["lods"]] == [0.5]
    assert "there is no level with 0.2 of the faces or fewer: nothing is left" in result.json["notes"]
    assert (model.parent / "a_lod1.glb").exists()
    assert not (model.parent / "a_lod2.glb").exists()


def test_levels_begin_with_colours_where_the_asset_has_a_texture(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[Mesh] = []

    def lods(mesh: Mesh, *_: object, **__: object) -> Iterator[tuple[Mesh, list[str]]]:
        begun.append(mesh)
        yield mesh, []

    monkeypatch.setattr("msb.bake.making.lods", lods)
    points, corners = (each[TETRAHEDRON[1]].reshape(-1, 3) for each in (TETRAHEDRON[0], COLORS))
    soup = asset_from_mesh(Mesh(points, np.arange(12).reshape(-1, 3), vertex_colors=corners))
    msb.bake(soup, cameras=ring(3), geometry="kept", color="texture", texture=16, lods=(0.5,))
    assert begun[0].vertex_colors is not None
    assert not begun[0].textures


@pytest.mark.slow
def test_two_geometries_are_judged_in_colours_that_what_is_aside_did_not_teach(
    here: Here, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    from msb.bake import making

    model, cameras = files
    poses: list[set[bytes]] = []

    def colored(mesh: Mesh, lessons: Lessons, device: str | None) -> Mesh:
        poses.append({camera.world_to_camera.tobytes() for camera in lessons.cameras})
        return fit(mesh, lessons, device)

    fit = making.colored
    monkeypatch.setattr(making, "colored", colored)
    out = model.parent / "a.glb"
    assert here("bake", "--color", "vertex", "--cameras", cameras, model, "-o", out).status == 0
    assert len(poses) == 3
    assert poses[0] == poses[1] < poses[2]


def test_cameras_of_another_scene_see_nothing(here: Here, files: tuple[Path, Path]) -> None:
    model, cameras = files
    solid(at=900.0).save(model, overwrite=True)
    out = model.parent / "a.glb"
    here("bake", "--cameras", cameras, model, "-o", out).ends(
        3, f"METRIC_NOTHING_SHOWN: {model}: no camera sees"
    )
    here("bake", "--scene", SCENE, model, "-o", out).ends(3, f"METRIC_NOTHING_SHOWN: {model}: no camera sees")
    assert not out.exists()


def test_the_folder_of_photographs_can_be_named(here: Here, files: tuple[Path, Path]) -> None:
    model, _ = files
    line = ("bake", "--image-folder", "images_3", model, "-o", model.parent / "a.glb")
    here(*line, "--scene", WALLED).ends(3, f"SCENE_IMAGE_MISSING: {WALLED}: the photographs are to be taken")
    here(*line).ends(2, "USAGE: --image-folder goes with --scene DIR")


@pytest.mark.slow
def test_a_scene_without_cameras_asks_for_them(here: Here, tmp_path: Path) -> None:
    msb.open(MODELS / "walled" / "diffsoup").save(tmp_path / "room.triasset")
    result = here("bake", tmp_path / "room.triasset", "-o", tmp_path / "a.glb")
    assert (result.status, result.err.count("\n")) == (2, 1), result
    assert result.err.startswith(f"USAGE: {tmp_path / 'room.triasset'}: 40 views from inside: ")
    assert result.err.rstrip().endswith("80 % are needed: give its scene (--scene) or cameras (--cameras)")
    assert not (tmp_path / "a.glb").exists()


def test_colours_that_are_no_numbers_are_refused(here: Here, files: tuple[Path, Path]) -> None:
    model, cameras = files
    parts = solid().buffers
    colors = COLORS.copy()
    colors[2] = np.nan
    buffers = {"positions": parts["positions"], "indices": parts["indices"], "color": colors}
    build_asset(buffers, {"color": "vertex"}).save(model, overwrite=True)
    here("bake", "--cameras", cameras, model, "-o", model.parent / "a.glb").ends(
        3, "TRIASSET_VALUE_NONFINITE: "
    )


def test_a_method_that_nothing_draws_is_refused(
    here: Here, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, cameras = files
    monkeypatch.setattr("msb.bake.teacher.why_not", lambda _, tier: f"there is no {tier}")
    result = here("bake", "--cameras", cameras, model, "-o", model.parent / "a.glb")
    result.ends(4, f"UNSUPPORTED_TIER: {model}: mesh on tier dedicated: ")


@pytest.mark.parametrize("error", [DeviceError("DEVICE_COMMAND", "the device is lost"), KeyboardInterrupt()])
def test_a_device_that_dies_and_an_interrupt_leave_nothing(
    here: Here, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    def die(*_: object, **__: object) -> None:
        raise error

    model, cameras = files
    monkeypatch.setattr("msb.bake.making.kept", die)
    before = sorted(model.parent.rglob("*"))
    result = here("bake", "--geometry", "kept", "--cameras", cameras, model, "-o", model.parent / "a.glb")
    assert result.status == (5 if isinstance(error, DeviceError) else 130)
    assert result.err.count("\n") == isinstance(error, DeviceError)
    assert sorted(model.parent.rglob("*")) == before


def test_an_interrupt_ends_with_the_best_so_far_if_asked(
    here: Here, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    from msb.bake import making

    made = []

    def interrupted(asset: msb.Asset, guide: Guide, shares: Any) -> Mesh:
        os.kill(os.getpid(), signal.SIGINT)
        made.append(guide.watch("choosing faces", 1, 9))
        return kept(asset, guide, shares)

    kept = making.kept
    monkeypatch.setattr(making, "kept", interrupted)
    monkeypatch.setattr(making, "fitted", lambda *_, **__: pytest.fail("there was no time for more"))
    model, cameras = files
    out = model.parent / "a.glb"
    handler = signal.getsignal(signal.SIGINT)
    result = here("bake", "--keep-best", "--cameras", cameras, model, "-o", out)
    assert (result.status, made) == (0, [True]), result
    assert "note: interrupted: this is the best so far" in result.err
    assert out.exists()
    assert signal.getsignal(signal.SIGINT) is handler
    made.clear()
    result = here("bake", "--cameras", cameras, model, "-o", model.parent / "b.glb")
    assert (result.status, made) == (130, [])
    assert not (model.parent / "b.glb").exists()


def test_an_output_that_cannot_be_written_leaves_none_of_them(
    here: Here, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    model, cameras = files
    monkeypatch.setattr("msb.bake.written.write_packed", full)
    old = model.parent / "a.glb"
    old.write_bytes(b"the old one")
    before = sorted(model.parent.rglob("*"))
    line = ["bake", "-f", "--geometry", "kept", "--cameras", cameras, model, "-o", old]
    result = here(*line, "-o", model.parent / "b.triasset")
    assert (result.status, result.err.count("\n")) == (3, 1), result
    assert "No space left on device" in result.err
    assert old.read_bytes() == b"the old one"
    assert sorted(model.parent.rglob("*")) == before


def test_the_files_of_a_texture_beside_an_output_are_not_overwritten(
    here: Here, files: tuple[Path, Path]
) -> None:
    model, cameras = files
    (model.parent / "a.mtl").write_bytes(b"mine")
    result = here("bake", "--cameras", cameras, model, "-o", model.parent / "a.obj")
    result.ends(2, f"OUTPUT_EXISTS: {model.parent / 'a.mtl'}")


def test_temporary_files_without_room_are_said_to_be_so(
    here: Here, files: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Full(io.BytesIO):
        def write(self, _: object) -> int:
            raise OSError(28, "No space left on device")

    model, cameras = files
    # Of that module alone: others make temporary files as well, the first time that OpenCL is used.
    monkeypatch.setattr("msb.bake.lessons.tempfile", SimpleNamespace(TemporaryFile=Full))
    result = here("bake", "--geometry", "kept", "--cameras", cameras, model, "-o", model.parent / "a.glb")
    said = "temporary files cannot be written: No space left on device; TMPDIR names another folder"
    result.ends(3, "OUTPUT_UNWRITABLE: ")
    assert said in result.err
    assert not (model.parent / "a.glb").exists()


def test_bars_count_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(Output, "shows_progress", True)
    from rich.progress import Progress

    monkeypatch.setattr(Progress, "update", lambda _, task, **values: seen.append((task, values)))
    with Output().bars("steps") as progress:
        assert progress is not None
        progress("texture", 1, 4)
        progress("texture", 2, 8)
    assert seen == [(0, {"completed": 1, "total": 4}), (0, {"completed": 2, "total": 8})]


@pytest.mark.slow
def test_a_trained_soup_loses_less_than_its_plain_mesh(msb: Msb, tmp_path: Path) -> None:
    model = MODELS / "walled" / "triangle_splatting"
    scene = ROOT / "data_stubs" / "scenes" / "mipnerf360" / "pebble"
    line = ["bake", "--seconds", "4", "--scene", scene, model, "--json", "-"]
    found = msb(*line, "-o", tmp_path / "a.glb", status=0).json
    numbers = found["psnr"]["photographs"]
    assert numbers["dedicated"] == pytest.approx(36.06, abs=0.1)
    assert numbers["before"] == pytest.approx(18.13, abs=0.1)
    assert numbers["after"] > numbers["before"] + 7
    assert found["geometry"] == max(found["tried"], key=found["tried"].get)

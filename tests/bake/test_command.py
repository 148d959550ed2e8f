"""`msb bake`: its options, files and JSON, and its errors."""

import json
import math
import os
import signal
import struct
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

import msb
from msb.asset import build_asset
from msb.asset.texture import MAX_SIDE
from msb.bake.context import SearchContext
from msb.bake.options import BakeKeywords, BakeOptions, parse_collision
from msb.errors import DeviceError, UsageError
from msb.meshes import Mesh, read_mesh
from msb.scenes import write_cameras
from tests.bake.conftest import COLORS, bake_words, solid
from tests.bake.soups import ring
from tests.cli.conftest import Here
from tests.conftest import ROOT

WALLED = ROOT / "data_stubs" / "scenes" / "mipnerf360" / "pebble"


def test_all_outputs_are_written(here: Here, model: Path) -> None:
    outs = [model.parent / name for name in ("a.glb", "b.triasset", "c.ply")]
    line = bake_words(model, "--json", "-")
    result = here(*line, "-o", outs[1], "-o", outs[2])
    assert result.status == 0, result
    data = result.json
    assert (data["schema"], data["path"], data["output"]) == ("msb.bake/1", str(model), str(outs[0]))
    assert data["bytes"] == outs[0].stat().st_size
    assert (data["geometry"], data["color"], data["texture"], data["faces"]) == ("kept", "vertex", None, 4)
    views = {"training": 6, "validation": 1, "test": 2, "interpolated": 33}
    assert data["views"] == {**views, "from": "9 cameras given"}
    # The target images of a mesh file are standard-tier images. With the same number of samples, only
    # rounding differs.
    native = data["psnr"]["native"]
    assert native["after_16"] > 40
    assert native["before"] == pytest.approx(native["after"], abs=1)
    assert data["psnr"]["photographs"] is None
    assert data["verdict_before"]["level"] == data["verdict_after"]["level"] == "ok"
    glb = outs[0].read_bytes()
    (size,) = struct.unpack_from("<I", glb, 12)
    extras = json.loads(glb[20 : 20 + size])["asset"]["extras"]["bake"]
    assert extras["psnr"] == data["psnr"]
    assert str(model.parent) not in json.dumps(extras)
    assert msb.load(outs[1]).buffers["color"].dtype == np.uint8
    assert len(read_mesh(outs[2]).faces) == 4
    here(*line).ends(2, "OUTPUT_EXISTS: ")
    assert here(*line, "-f").status == 0
    assert outs[0].read_bytes() == glb, "one seed gives one result"


@pytest.mark.slow
def test_levels_and_a_collision_shape_are_written_beside_each_output(here: Here, model: Path) -> None:
    line = bake_words(model, "--lods", "0.5", "--collision", "box")
    result = here(*line, "-o", model.parent / "b.ply", "--json", "-")
    assert result.status == 0, result
    (level,), shape = result.json["lods"], result.json["collision"]
    assert [Path(part["output"]).name for part in (level, shape)] == ["a_lod1.glb", "a_collision.glb"]
    assert level["native_after_16"] > 10
    assert (level["share"], shape["kind"], shape["faces"], shape["parts"]) == (0.5, "box", 12, 1)
    assert level["bytes"] == Path(level["output"]).stat().st_size
    assert msb.audit(model.parent / "b_collision.ply").verdict == "ok"
    assert len(read_mesh(model.parent / "b_lod1.ply").faces) == level["faces"]
    here(*bake_words(model, "-o", model.parent / "a_lod1.glb", out="c.glb")).ends(2, "OUTPUT_EXISTS: ")


@pytest.mark.slow
def test_a_cache_of_renderings_gives_the_same_bytes(here: Here, model: Path) -> None:
    cache, outs = model.parent / "cache", [model.parent / name for name in ("a.glb", "b.glb")]
    for out in outs:
        assert here(*bake_words(model, "--cache", cache, out=out.name)).status == 0
    assert outs[0].read_bytes() == outs[1].read_bytes()
    a_file = here(*bake_words(model, "--cache", model, out="c.glb"))
    assert (a_file.status, (model.parent / "c.glb").exists()) == (3, False)


def test_one_view_and_one_face_are_enough(here: Here, model: Path) -> None:
    solid(faces=1).save(model, overwrite=True)
    write_cameras(ring(1), model.parent / "cameras.json")
    data = here(*bake_words(model, "--json", "-")).json
    assert data["psnr"] == {"native": None, "photographs": None}
    assert (data["faces"], data["views"]["test"]) == (1, 0)


USAGE = {
    "no output": [],
    "format": ["-o", "a.fbx"],
    "photographs": ["-o", "a.glb", "--supervision", "photographs"],
    "both": ["-o", "a.glb", "--scene", "x", "--cameras", "y"],
    "image folder without scene": ["-o", "a.glb", "--image-folder", "images_3"],
    "resolution without scene": ["-o", "a.glb", "--resolution", "2"],
    "views with cameras": ["-o", "a.glb", "--views", "both", "--cameras", "cameras.json"],
    "size without cameras": ["-o", "a.glb", "--size", "9x9"],
    "same file twice": ["-o", "a.obj", "-o", "b/../a.obj"],
    "shape": ["-o", "a.glb", "--collision", "ball"],
}


@pytest.mark.parametrize("words", USAGE.values(), ids=USAGE)
def test_invalid_arguments_are_rejected_and_nothing_is_written(
    here: Here, model: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.chdir(model.parent)
    before = sorted(model.parent.rglob("*"))
    here("bake", model.name, *words).ends(2, "USAGE: ")
    assert sorted(model.parent.rglob("*")) == before


@pytest.mark.parametrize(
    ("module", "words", "code"),
    [
        ("xatlas", ["--color", "texture"], "EXTRA_MISSING"),
        ("xatlas", ["--geometry", "auto", "--color", "texture"], "EXTRA_MISSING"),
        ("xatlas", ["--geometry", "surface"], "EXTRA_MISSING"),
        ("skimage", ["--geometry", "auto", "--for-solid"], "EXTRA_MISSING"),
        ("fast_simplification", ["--lods", "0.5"], "EXTRA_MISSING"),
        ("fast_simplification", ["--collision", "mesh:10"], "EXTRA_MISSING"),
        ("coacd", ["--collision", "hulls:4"], "EXTRA_MISSING"),
        ("skimage", ["--geometry", "auto", "--collision", "mesh:10"], "EXTRA_MISSING"),
        ("skimage", ["--collision", "mesh:10"], "USAGE"),
        ("coacd", ["--collision", "box"], "USAGE"),
    ],
)
def test_a_missing_library_is_reported_before_anything_is_drawn(
    here: Here, model: Path, monkeypatch: pytest.MonkeyPatch, module: str, words: list[str], code: str
) -> None:
    def go_on(*_: object, **__: object) -> None:
        raise UsageError("USAGE", "nothing is missing")

    monkeypatch.setattr("msb.base.extras.is_installed", lambda name: name != module)
    monkeypatch.setattr("msb.bake.supervision.choose_bake_views", go_on)
    here(*bake_words(model, *words)).ends(2, f"{code}: ")


def test_errors_of_inputs(here: Here, model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = ["-o", model.parent / "a.glb"]
    here("bake", model, "--scene", "nowhere", *out).ends(3, "FILE_NOT_FOUND: ")
    here("bake", "--scene", WALLED, "--image-folder", "images_3", model, *out).ends(
        3, "SCENE_IMAGE_MISSING: "
    )
    with monkeypatch.context() as patch:
        patch.setattr("msb.bake.image_source.why_not", lambda _, tier: f"there is no {tier}")
        here(*bake_words(model)).ends(4, "UNSUPPORTED_TIER: ")
    parts, colors = solid().buffers, COLORS.copy()
    colors[2] = np.nan
    buffers = {"positions": parts["positions"], "indices": parts["indices"], "color": colors}
    build_asset(buffers, {"color": "vertex"}).save(model, overwrite=True)
    here(*bake_words(model)).ends(3, "TRIASSET_VALUE_NONFINITE: ")


FAILURES = {
    "device": ("msb.bake.pipeline.make_kept", DeviceError("DEVICE_COMMAND", "the device is lost"), 5),
    "interrupt": ("msb.bake.pipeline.make_kept", KeyboardInterrupt(), 130),
    "full disk": ("msb.bake.output_files.write_packed", OSError(28, "No space left on device"), 3),
}


@pytest.mark.parametrize(("place", "error", "status"), FAILURES.values(), ids=FAILURES)
def test_a_failure_leaves_all_files_as_they_were(
    here: Here,
    model: Path,
    monkeypatch: pytest.MonkeyPatch,
    place: str,
    error: BaseException,
    status: int,
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(place, fail)
    (model.parent / "a.glb").write_bytes(b"the old one")
    before = sorted(model.parent.rglob("*"))
    assert here(*bake_words(model, "-f", "-o", model.parent / "b.triasset")).status == status
    assert (model.parent / "a.glb").read_bytes() == b"the old one"
    assert sorted(model.parent.rglob("*")) == before


@pytest.mark.slow
def test_keep_best_writes_the_best_result_after_an_interrupt(
    here: Here, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from msb.bake import pipeline

    stops = []

    def interrupt(asset: msb.Asset, context: SearchContext, weights: Any) -> Mesh:
        os.kill(os.getpid(), signal.SIGINT)
        stops.append(context.progress("choosing faces", 1, 9))
        return make_kept(asset, context, weights)

    make_kept = pipeline.make_kept
    monkeypatch.setattr(pipeline, "make_kept", interrupt)
    monkeypatch.setattr(pipeline, "make_fitted", lambda *_, **__: pytest.fail("the bake was interrupted"))
    handler = signal.getsignal(signal.SIGINT)
    assert here(*bake_words(model, "--geometry", "auto", "--keep-best")).status == 0
    assert (stops, (model.parent / "a.glb").exists()) == ([True], True)
    assert signal.getsignal(signal.SIGINT) is handler
    assert here(*bake_words(model, out="b.glb")).status == 130
    assert not (model.parent / "b.glb").exists()


def test_files_beside_an_output_are_not_overwritten(here: Here, model: Path) -> None:
    (model.parent / "a.mtl").write_bytes(b"mine")
    here(*bake_words(model, out="a.obj")).ends(2, f"OUTPUT_EXISTS: {model.parent / 'a.mtl'}")


INVALID: list[dict[str, Any]] = [
    {"geometry": "solid"},
    {"color": "face"},
    {"supervision": "me"},
    {"texture": 8},
    {"texture": MAX_SIDE + 1},
    {"faces": 0},
    {"seconds": -1},
    {"seconds": math.nan},
    {"seconds": math.inf},
    {"seed": -1},
    {"up": "z"},
    {"views": "around"},
    {"for_solid": True, "geometry": "kept"},
    {"faces": 9, "geometry": "kept"},
    {"texture": 64, "color": "vertex"},
    *({"lods": text} for text in ("", "half", "0.5,", "1,0.5", "0", "-0.5", "nan", "0.25,0.5", "0.5,0.5")),
    *({"lods": shares} for shares in ((0.5, 0.5), (math.nan,))),
    *({"collision": text} for text in ("", "mesh", "mesh:", "mesh:3", "mesh:1e3", "hulls:0", "box:2")),
]


@pytest.mark.parametrize("options", INVALID, ids=str)
def test_invalid_values_and_contradictions_are_rejected(options: dict[str, Any]) -> None:
    with pytest.raises(UsageError) as caught:
        BakeOptions(**options)
    assert caught.value.code == "USAGE"
    assert f"--{next(iter(options)).replace('_', '-')} " in caught.value.message


def test_levels_and_shapes_are_parsed() -> None:
    assert BakeOptions(lods="0.5, 0.25,0.1").lod_shares == BakeOptions(lods=(0.5, 0.25, 0.1)).lod_shares
    assert BakeOptions(lods=(0.5, 0.25)).lod_shares == (0.5, 0.25)
    assert BakeOptions().lod_shares == BakeOptions(lods=()).lod_shares == ()
    shapes = [parse_collision(text) for text in ("mesh:1000", "hulls:16", "box")]
    assert shapes == [("mesh", 1000), ("hulls", 16), ("box", 1)]


def test_keywords_of_msb_bake_are_the_fields_of_its_options() -> None:
    fields, keywords = get_type_hints(BakeOptions), get_type_hints(BakeKeywords)
    assert list(fields) == list(keywords)
    for name, kind in fields.items():
        assert set(get_args(keywords[name])) <= set(get_args(kind)), name
        assert get_args(kind) or kind is keywords[name]
    texture = get_type_hints(BakeOptions, include_extras=True)["texture"].__metadata__[0]
    assert texture.most == MAX_SIDE

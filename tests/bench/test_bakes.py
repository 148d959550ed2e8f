"""Bakes of a protocol are computed once per model and scene.

They split the loss to the standard tier into parts.
"""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from msb.bench.bakes import hash_bake_inputs
from msb.bench.models import ModelAsset
from msb.bench.photographs import describe_views
from msb.bench.protocol import ProtocolFile, parse_protocol
from msb.bench.records import File, Result
from msb.bench.run import run_protocol
from msb.bench.split import loss_split
from msb.errors import InputError
from msb.scenes.datasets import read_scene
from tests.bench.protocols import PEBBLE, STUBS, get_plan, make_protocol, read_cell
from tests.report.factory import bake, quality, result

pytest.importorskip("msb.bake", reason="bakes need msb.bake")
CEILING = '[[bakes]]\nlabel = "ceiling"\ngeometry = "kept"\n'
TRIAL = '[trial]\ntasks = ["self_intersections"]\n'


def test_bake_tables_have_the_defaults_of_the_command(tmp_path: Path) -> None:
    first, second = make_protocol(
        tmp_path, tail=f'{CEILING}[[bakes]]\nlabel = "b"\nfaces = 9\n'
    ).protocol.bakes
    assert first.options == {"geometry": "kept", "effort": "normal", "seed": 0}
    assert second.options == {"geometry": "auto", "faces": 9, "effort": "normal", "seed": 0}


@pytest.mark.parametrize(
    ("tail", "pointer"),
    [
        (f"{CEILING}second = 3", "/bakes/0/second"),
        (f"{CEILING}faces = 9", "/bakes/0"),
        ('[[bakes]]\nlabel = "b"\ngeometry = "solid"', "/bakes/0/geometry"),
        ('[[bakes]]\nlabel = "b"\ntexture = 8', "/bakes/0"),
        (f'{CEILING}datasets = ["dtu"]', "/bakes/0/datasets"),
        (f"{CEILING}{CEILING}", "/bakes/1/label"),
        ('[[bakes]]\nlabel = "Standard"', "/bakes/0/label"),
        ('[[variants]]\nlabel = "x"\norder = "none"\n[[bakes]]\nlabel = "x"', "/bakes/0/label"),
    ],
)
def test_invalid_bake_tables_are_rejected(tmp_path: Path, tail: str, pointer: str) -> None:
    with pytest.raises(InputError) as caught:
        make_protocol(tmp_path, tail=tail)
    assert caught.value.message.startswith(f"{pointer}: ")


def test_the_key_of_a_bake_does_not_depend_on_its_path() -> None:
    scene = read_scene(STUBS / "scenes" / "nerf_synthetic" / "pebble", dataset="nerf_synthetic")
    views, asset = describe_views(scene), File(path="a.triasset", bytes=1, sha256="0" * 64)
    facts: dict[str, Any] = {"method": "two_dts", "checkpoint": None, "background": None}
    model = ModelAsset(**facts, asset=asset, training={}, stamps=(), key="")
    options = {"supervision": "native", "seconds": 60.0}

    def moved(**changes: str) -> ModelAsset:
        return model.model_copy(update={"asset": asset.model_copy(update=changes)})

    keys = [
        hash_bake_inputs(model, options, {}, scene, views),
        hash_bake_inputs(model, {**options, "seconds": 61.0}, {}, scene, views),
        hash_bake_inputs(model, {**options, "supervision": "photographs"}, {}, scene, views),
        hash_bake_inputs(model, options, {"gamma": 2.0}, scene, views),
        hash_bake_inputs(model, options, {}, replace(scene, train=scene.train[1:]), views),
        hash_bake_inputs(model, options, {}, scene, replace(views, photographs="others")),
        hash_bake_inputs(moved(sha256="1" * 64), options, {}, scene, views),
    ]
    assert len(set(keys)) == len(keys)
    assert hash_bake_inputs(moved(path="elsewhere.triasset"), options, {}, scene, views) == keys[0]


def test_masks_are_inputs_of_a_bake_from_photographs(tmp_path: Path) -> None:
    root = Path(shutil.copytree(STUBS / "scenes" / "dtu" / "scan1", tmp_path / "scan1"))
    scene = read_scene(root, dataset="dtu")
    masks = dict.fromkeys((str(camera.name) for camera in scene.train), next((root / "mask").iterdir()))
    scene = replace(scene, mask_source="mask_folder", masks=masks)
    model: Any = SimpleNamespace(asset=File(path="a.triasset", bytes=1, sha256="0" * 64))
    views: Any = SimpleNamespace(cameras="", photographs="")
    before, after = [], []
    for keys in (before, after):
        keys += [
            hash_bake_inputs(model, {"supervision": name}, {}, scene, views)
            for name in ("native", "photographs")
        ]
        next((root / "mask").iterdir()).write_bytes(b"another")
    assert [old == new for old, new in zip(before, after, strict=True)] == [True, False]


def test_a_bake_applies_to_the_datasets_it_names(tmp_path: Path) -> None:
    other = f'[[datasets]]\nname = "other"\npath = {json.dumps(str(STUBS / "scenes" / "nerf_synthetic"))}\n'
    file = make_protocol(tmp_path, ("two_dts",), tail=f'{other}{CEILING}datasets = ["other"]')
    cells = [row.planned.cell for row in run_protocol(file, dry=True).rows]
    names = {(cell.dataset, cell.bake) for cell in cells}
    assert names == {("nerf_synthetic", None), ("other", None), ("other", "ceiling")}


def scenes(*rows: dict[str, float]) -> dict[str, dict[str, Result]]:
    """Return records by scene and condition from rows of PSNR; the bake "baked/kept" keeps all triangles."""

    def record(name: str, value: float) -> Result:
        label = name.partition("/")[2]
        parts: dict[str, Any] = bake(label, "kept" if label == "kept" else "fitted") if label else {}
        return result("standard" if label else name, quality=quality(value), **parts)

    return {
        f"s{number}": {name: record(name, value) for name, value in row.items()}
        for number, row in enumerate(rows)
    }


def test_the_parts_add_up_to_the_loss() -> None:
    rows = {"dedicated": 30.0, "baked/kept": 21.5, "baked/b": 27.0, "baked/worse": 26.0, "standard": 18.0}
    split = loss_split("psnr", scenes(rows, {name: value + 1 for name, value in rows.items()}), ["s0", "s1"])
    assert (split.ceiling, split.baked) == ("baked/kept", "baked/b")
    assert {name: gap.signed for name, gap in split.steps.items()} == pytest.approx(
        {"colors": 3.5, "faces": 5.5, "blending": 3.0}
    )
    assert sum(gap.signed for gap in split.steps.values()) == pytest.approx(split.total.signed)
    assert split.total.scenes == 2


def test_the_parts_are_averaged_over_scenes_with_all_conditions() -> None:
    whole = {"dedicated": 30.0, "baked/kept": 21.0, "baked/b": 27.0, "standard": 18.0}
    without = {"dedicated": 40.0, "baked/b": 20.0, "standard": 10.0}
    split = loss_split("psnr", scenes(whole, without), ["s0", "s1"])
    assert split.total.signed == 12
    assert [(gap.scenes, gap.expected) for gap in split.steps.values()] == [(1, 2)] * 3
    assert sum(gap.signed for gap in split.steps.values()) == pytest.approx(12)


def test_a_part_without_a_bake_is_included_in_the_next() -> None:
    split = loss_split("psnr", scenes({"dedicated": 30.0, "baked/kept": 21.0, "standard": 18.0}), ["s0"])
    assert {name: gap.signed for name, gap in split.steps.items()} == {"colors": 3, "blending": 9}
    assert split.within == {"faces": "blending"}
    plain = loss_split("psnr", scenes({"baked/kept": 21.0, "standard": 18.0}), ["s0"])
    assert plain.total is None
    assert {name: gap.signed for name, gap in plain.steps.items()} == {"colors": 3}
    assert loss_split("psnr", scenes({"dedicated": 30.0, "standard": 18.0}), ["s0"]) is None


def test_a_bake_of_another_asset_is_not_compared() -> None:
    records = scenes({"dedicated": 30.0, "baked/kept": 21.0, "standard": 18.0})
    other = File(path="y.triasset", bytes=9, sha256="f" * 64)
    records["s0"]["baked/kept"] = records["s0"]["baked/kept"].model_copy(update={"source": other})
    split = loss_split("psnr", records, ["s0"])
    assert {gap.reason for gap in split.steps.values()} == {"asset_mismatch"}


@pytest.fixture(scope="module")
def baked(tmp_path_factory: pytest.TempPathFactory) -> ProtocolFile:
    """A run of a method without static colours, with two bakes: triangles kept, and triangles fitted."""
    fitted = '[[bakes]]\nlabel = "fitted"\ngeometry = "fitted"\nseconds = 1\n'
    file = make_protocol(tmp_path_factory.mktemp("baked"), ("diffsoup",), tail=f"{TRIAL}{CEILING}{fitted}")
    assert run_protocol(file, jobs=2).exit_status == 0
    return file


@pytest.mark.slow
def test_the_record_of_a_bake_is_complete(baked: ProtocolFile) -> None:
    record, model = read_cell(baked, "diffsoup/ceiling"), read_cell(baked, "diffsoup/dedicated")
    where = record.cell
    assert (where.condition, where.bake, where.condition_key) == ("standard", "ceiling", "baked/ceiling")
    assert record.bake.geometry == "kept"
    assert record.source == model.asset
    assert record.asset.sha256 != model.asset.sha256
    assert record.quality.values["psnr"] == pytest.approx(record.bake.psnr.photographs.after, abs=0.01)
    assert record.quality.views == model.quality.views
    assert [trial.task for trial in record.trial.trials] == ["self_intersections"]
    assert (record.audit.counts.faces, record.timing is None) == (record.bake.faces, False)
    assert read_cell(baked, "diffsoup/fitted").bake.geometry == "fitted"
    assert read_cell(baked, "diffsoup/standard").status == "unsupported"


@pytest.mark.slow
def test_a_bake_is_repeated_only_if_an_input_changed(baked: ProtocolFile) -> None:
    assert set(get_plan(run_protocol(baked, dry=True)).values()) == {"done", "unsupported"}
    place = baked.results / "assets" / "nerf_synthetic" / "pebble" / "diffsoup" / "ceiling.triasset"
    os.utime(place, ns=(0, 0))  # as after copying the results
    record = baked.results / "cells" / "nerf_synthetic" / "pebble" / "diffsoup" / "ceiling" / "result.json"
    record.unlink()  # as after a run that was killed between the bake and its cell
    assert get_plan(run_protocol(baked, only=["ceiling"]))["diffsoup/ceiling"]["quality"] == "new"
    assert place.stat().st_mtime_ns == 0
    text = baked.text.replace(b"seconds = 1\n", b"seconds = 2\n")
    changed = replace(parse_protocol(text, baked.path), results_instead=baked.results)
    why = get_plan(run_protocol(changed, dry=True))
    pending = {name: reasons for name, reasons in why.items() if isinstance(reasons, dict)}
    assert pending == {"diffsoup/fitted": {"bake": "changed"}}
    place.write_bytes(b"no asset")
    assert get_plan(run_protocol(baked, dry=True))["diffsoup/ceiling"] == {"bake": "changed"}


@pytest.mark.slow
def test_a_mesh_without_native_rendering_is_baked_from_photographs(tmp_path: Path) -> None:
    import msb

    mesh = tmp_path / "plain.glb"
    msb.open(PEBBLE / "two_dts").save(mesh)
    text = f'{CEILING}[[methods]]\nname = "mesh"\nlabel = "MILo"\nmodel = {json.dumps(str(mesh))}\n'
    file = make_protocol(tmp_path, (), tail=text)
    assert run_protocol(file).exit_status == 0
    shipped, ceiling = read_cell(file, "MILo/standard"), read_cell(file, "MILo/ceiling")
    assert ceiling.bake.supervision == "photographs"
    assert ceiling.quality.values["psnr"] > shipped.quality.values["psnr"]

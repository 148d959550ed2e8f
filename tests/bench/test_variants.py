"""Variants of the dedicated tier and labels of models: separate cells, from the protocol to the report."""

import json
from dataclasses import replace

import numpy as np
import pytest

import msb
from msb import metrics
from msb.bench.protocol import ProtocolFile, parse_protocol
from msb.bench.run import run_protocol
from msb.render.images import to_bytes
from msb.report.collect import REFERENCE, collect
from msb.report.numbers import MEAN, GapKey, Key, RatioKey
from msb.report.results import read_results
from msb.report.tables.gaps import gaps_table, slowdown_table
from msb.scenes.datasets import read_scene
from tests.bench.protocols import PEBBLE, STUBS, get_plan, make_protocol, read_cell

pytestmark = pytest.mark.slow

SCENE = STUBS / "scenes" / "nerf_synthetic" / "pebble"
TAIL = f"""
[[methods]]
name = "two_dts"
label = "ours"
settings = {{ sh_degree = 0 }}
model = {json.dumps(str(PEBBLE / "two_dts"))}
conditions = ["dedicated", "standard"]

[[variants]]
label = "engine"
order = "global"
sampling = "engine"

[[variants]]
label = "soft"
settings = {{ gamma = 2.0 }}
"""


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> ProtocolFile:
    """A run of two methods with two variants; one method has two models."""
    file = make_protocol(tmp_path_factory.mktemp("varied"), keys='non_engine = "reference"', tail=TAIL)
    assert run_protocol(file, jobs=2).exit_status == 0
    return file


def test_a_variant_is_a_cell_with_its_settings(varied: ProtocolFile) -> None:
    record = read_cell(varied, "two_dts/engine")
    where = record.cell
    assert (where.condition, where.variant, where.renderer) == ("dedicated", "engine", None)
    assert where.condition_key == "dedicated/engine"
    assert record.renderer.settings["order"] == "global"
    assert record.renderer.settings["sampling"] == "engine"
    assert record.timing is not None
    camera = read_scene(SCENE, dataset="nerf_synthetic").test[0]
    asset = msb.open(PEBBLE / "two_dts")
    with msb.Renderer(asset, "dedicated", "pocl", order="global", sampling="engine") as renderer:
        frame = renderer.render(camera, background=(1.0, 1.0, 1.0))
    place = varied.results / "cells" / "nerf_synthetic" / "pebble" / "two_dts" / "engine"
    image = metrics.read_image(place / str(record.quality.images[0].file))
    np.testing.assert_array_equal(image, to_bytes(frame.image))


def test_a_variant_of_a_setting_that_a_method_lacks_is_unsupported(varied: ProtocolFile) -> None:
    record = read_cell(varied, "diffsoup/soft")
    assert (record.status, record.reason.code) == ("unsupported", "UNSUPPORTED_OPTION")


def test_a_changed_variant_is_rendered_again_and_nothing_else(varied: ProtocolFile) -> None:
    assert set(get_plan(run_protocol(varied, dry=True)).values()) == {"done", "unsupported"}
    text = varied.text.replace(b"gamma = 2.0", b"gamma = 3.0")
    changed = replace(parse_protocol(text, varied.path), results_instead=varied.results)
    again = get_plan(run_protocol(changed, dry=True))
    assert {name: set(why.values()) for name, why in again.items() if isinstance(why, dict)} == {
        "two_dts/soft": {"settings changed"},
        "ours/soft": {"settings changed"},
    }
    selected = run_protocol(varied, dry=True, only=["ours/engine"])
    assert [row.planned.cell.names[2:] for row in selected.rows] == [("ours", "engine")]


def test_labels_distinguish_two_models_of_one_method(varied: ProtocolFile) -> None:
    first, second = (read_cell(varied, f"{name}/dedicated") for name in ("two_dts", "ours"))
    assert second.cell.method == "two_dts"
    assert first.quality.values["psnr"] != second.quality.values["psnr"]
    numbers = collect(read_results(varied.results))
    assert numbers.methods("nerf_synthetic") == ["two_dts", "diffsoup", "ours"]


def test_the_adaptation_gap_of_a_variant_is_measured(varied: ProtocolFile) -> None:
    numbers = collect(read_results(varied.results))
    official, variant = (
        numbers.gaps[GapKey("nerf_synthetic", MEAN, "two_dts", "psnr", dedicated=name)]
        for name in ("dedicated", "dedicated/engine")
    )
    assert REFERENCE in numbers.number(Key("nerf_synthetic", MEAN, "two_dts", "non_engine", "psnr")).notes
    assert official.adapt.value == pytest.approx(0, abs=1e-3)
    assert variant.adapt.value > 0.1
    assert variant.deploy.value == official.deploy.value
    keys = [
        Key("nerf_synthetic", MEAN, "two_dts", name, "psnr") for name in ("non_engine", "dedicated/engine")
    ]
    before, after = (numbers.value(key) for key in keys)
    assert variant.adapt.signed == pytest.approx(before - after)
    assert RatioKey("nerf_synthetic", "two_dts", "standard", "dedicated/engine") in numbers.ratios
    rows = {row.labels for row in gaps_table(numbers, "nerf_synthetic").rows}
    assert ("PSNR ↑", "2DTS, engine") in rows
    assert ("PSNR ↑", "ours, soft") in rows
    assert "2DTS, engine" in {row.labels[1] for row in slowdown_table(numbers).rows}

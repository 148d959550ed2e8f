"""Means over scenes: the paper's own, percentiles, groups, and what is missing."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path

import pytest

from msb.bench.aggregate import (
    METRICS,
    SCENES,
    expected_scenes,
    mean_over,
    scene_groups,
)
from msb.bench.documents import AuditDocument, ChamferDocument
from msb.bench.records import Memory, Training
from tests.bench.records import asset, quality, result, timing
from tests.report.documents import AUDIT, chamfer

COUNTS = {
    # table -> means it prints for whose scenes it has rows (spec, section 2)
    "tnt_renderer_comparison": 28,
    "tnt_unity_runtime_resources": 28,
    "mip360_unity_memory": 21,
    "mip360_unity_gpu_latency": 42,
    "mesh_connectivity": 8,
}


@pytest.mark.parametrize("table", COUNTS)
def test_the_papers_means_follow_from_its_scenes(shared: Path, table: str) -> None:
    data = json.loads((shared / "golden" / "paper_tables" / f"{table}.json").read_text())
    rows: dict[tuple[str, ...], dict[str, float | None]] = defaultdict(dict)
    means: dict[tuple[str, ...], tuple[float, int]] = {}
    for cell in data["cells"]:
        column = (cell["dataset"], cell["method"], cell["condition"], cell["metric"])
        if cell["scene"].endswith("mean"):
            if cell["value"] is not None:
                means[(*column, cell["scene"])] = (cell["value"], cell["decimals"])
        else:
            rows[column][cell["scene"]] = cell["value"]
    assert len(means) == COUNTS[table]
    for (*column, name), (printed, decimals) in means.items():
        dataset = column[0]
        scenes = {**scene_groups(dataset), "mean": SCENES[dataset]}[name]
        found = mean_over(rows[tuple(column)], scenes)
        assert not found.partial
        # Half a unit for the mean's own rounding, half for that of the rows.
        assert found.value == pytest.approx(printed, abs=1.0001 * 10**-decimals)


def test_nine_scenes_are_not_two_groups() -> None:
    values = dict.fromkeys(scene_groups("mipnerf360")["indoor_mean"], 0.0)
    values |= dict.fromkeys(scene_groups("mipnerf360")["outdoor_mean"], 9.0)
    assert mean_over(values, SCENES["mipnerf360"]).value == 5
    assert {len(names) for names in SCENES.values()} == {9, 2, 8, 15}


def test_missing_values_make_a_mean_partial_and_never_zero() -> None:
    records = {"a": result(quality=quality(20, None)), "b": result(quality=quality(30, 0.5))}
    mean = mean_over({name: METRICS["lpips"].get(one) for name, one in records.items()}, ["a", "b", "c"])
    assert (mean.value, mean.present, mean.expected, mean.partial) == (0.5, 1, 3, True)
    assert METRICS["chamfer"].get(records["a"]) is None
    assert mean_over({"a": 1.0, "other": 5.0}, ["a"]).value == 1


def test_expected_scenes_are_the_published_ones() -> None:
    assert expected_scenes("tanksandtemples", ["train"]) == ("train", "truck")
    assert expected_scenes("tanksandtemples", ["train", "shed"]) == ("train", "truck")
    assert expected_scenes("tanksandtemples", ["shed"]) == ("shed",)
    assert expected_scenes("my capture", ["b", "a", "b"]) == ("b", "a")
    assert expected_scenes("mipnerf360", ["pebble"]) == ("pebble",)
    assert len(expected_scenes("mipnerf360", ["garden", "pebble"])) == 9
    assert expected_scenes("my capture", []) == ()
    assert SCENES["dtu"][0] == "scan24"


def test_every_metric_is_found_in_a_record() -> None:
    full = result(
        timing=timing(50),
        asset=asset(size=7),
        memory=Memory(geometry=1, appearance=2, scratch=3, targets=4, uses={}, driver_bytes=9),
        training=Training(seconds=60.0, peak_memory_bytes=5, source="x"),
        chamfer=ChamferDocument.of(chamfer(0.8)),
        audit=AuditDocument.of(AUDIT),
    )
    found = {name: metric.get(full) for name, metric in METRICS.items()}
    assert None not in found.values()
    assert (found["memory"], found["asset_size"], found["chamfer"], found["fps"]) == (10, 7, 0.8, 50)
    bare = {name: metric.get(result(quality=None)) for name, metric in METRICS.items()}
    assert set(bare.values()) == {None}

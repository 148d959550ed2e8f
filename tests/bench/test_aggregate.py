"""Means over scenes: the paper's own, percentiles, groups, and what is missing."""

from msb.bench.aggregate import METRICS, SCENES, expected_scenes, mean_over, scene_groups
from msb.bench.documents import AuditDocument, ChamferDocument, TrialDocument
from msb.bench.records import File, Memory, Result, Training, WalkDocument
from tests.report.documents import AUDIT, TASK, WALK, chamfer, trial
from tests.report.factory import bake, quality, result, timing


def test_nine_scenes_are_not_two_groups() -> None:
    values = dict.fromkeys(scene_groups("mipnerf360")["indoor_mean"], 0.0)
    values |= dict.fromkeys(scene_groups("mipnerf360")["outdoor_mean"], 9.0)
    assert mean_over(values, SCENES["mipnerf360"]).value == 5
    assert {len(names) for names in SCENES.values()} == {9, 2, 8, 15}


def test_missing_values_make_a_mean_partial_and_never_zero() -> None:
    records = {"a": result(quality=quality(lpips=None)), "b": result(quality=quality(lpips=0.5))}
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
        quality=quality(lpips=0.2),
        timing=timing(50),
        asset=File(path="x", bytes=7),
        memory=Memory(geometry=1, appearance=2, scratch=3, targets=4, uses={}, driver_bytes=9),
        training=Training(seconds=60.0, peak_memory_bytes=5, source="x"),
        chamfer=ChamferDocument.of(chamfer(0.8)),
        audit=AuditDocument.of(AUDIT),
        walk=WalkDocument.of(WALK),
        trial=TrialDocument.of(trial(TASK)),
        bake=bake("ceiling")["bake"],
    )
    found = {name: metric.get(full) for name, metric in METRICS.items()}
    assert None not in found.values()
    assert (found["memory"], found["asset_size"], found["chamfer"], found["fps"]) == (10, 7, 0.8, 50)
    bare = Result(cell=full.cell, status="done", seconds=1.0)
    assert {metric.get(bare) for metric in METRICS.values()} == {None}

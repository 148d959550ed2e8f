"""Means over scenes, gaps, slowdowns and t intervals: what is missing, not compared or not tested."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from msb.bench.aggregate import METRICS, SCENES, expected_scenes, mean_over, scene_groups
from msb.bench.documents import AuditDocument, ChamferDocument, TrialDocument
from msb.bench.gaps import PAIRS, dataset_gaps, incomparable, scene_gaps, slowdown, value_gaps
from msb.bench.intervals import excludes_zero, interval
from msb.bench.records import File, Memory, Result, Training, WalkDocument
from tests.report.factory import AUDIT, SETUP, TASK, WALK, bake, chamfer, quality, result, timing, trial
from tests.report.factory import METRICS as MEASURES

CONDITIONS = ("non_engine", "dedicated", "standard")
VIEWS = quality().images
OTHER = VIEWS[0].model_copy(update={"name": "c.png"})


@pytest.mark.parametrize(
    ("metric", "values", "wanted", "excess"),
    [
        ("psnr", (20, 22, 15), (2, 7, 5), 4),
        ("psnr", (20, 15, 18), (5, 3, 2), 6),
        ("lpips", (0.2, 0.3, 0.25), (0.1, 0.05, 0.05), 0.1),
        ("psnr", (20, 18, 15), (2, 3, 5), 0),
        ("psnr", (20, 20, 15), (0, 5, 5), 0),
    ],
)
def test_where_the_identity_fails_it_says_by_how_much(
    metric: str, values: tuple[float, ...], wanted: tuple[float, ...], excess: float
) -> None:
    gaps = value_gaps(metric, *values)
    assert [gaps[name].value for name in PAIRS] == pytest.approx(list(wanted))
    assert gaps.triangle_excess == pytest.approx(excess)
    assert gaps.monotone is (excess == 0)
    signed = [gaps[name].signed for name in PAIRS]
    assert signed[0] + signed[1] == pytest.approx(signed[2])


def test_signs_say_which_way_it_goes() -> None:
    assert value_gaps("psnr", 20, 22, 15).adapt.signed == -2
    assert value_gaps("lpips", 0.25, 0.5, 0.75).adapt.signed == 0.25
    assert value_gaps("fps", 10, 40, 400).port.signed == -360
    with pytest.raises(ValueError, match="mean_valence"):
        value_gaps("mean_valence", 1, 2, 3)


def records(*triples: tuple[float | None, ...]) -> dict[str, dict[str, Any]]:
    return {
        f"s{number}": {
            condition: result(condition, quality=quality(value))
            for condition, value in zip(CONDITIONS, triple, strict=True)
            if value is not None
        }
        for number, triple in enumerate(triples)
    }


def test_a_datasets_gap_is_that_of_the_means() -> None:
    found = dataset_gaps("psnr", records((20, 22, 15), (30, 26, 25)), ["s0", "s1"])
    assert (found.adapt.value, found.adapt.signed) == (1, 1)
    assert found.adapt.mean_abs_scene_gap == 3
    assert (found.deploy.value, found.deploy.mean_abs_scene_gap) == (5, 5)
    assert found.monotone
    assert (found.adapt.scenes, found.adapt.partial) == (2, False)


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        (None, "missing"),
        ({"status": "unsupported"}, "unsupported"),
        ({"status": "failed"}, "failed"),
        ({"quality": None}, "not_measured"),
        ({"quality": quality().model_copy(update={"images": VIEWS[1:]})}, "camera_mismatch"),
        ({"quality": quality().model_copy(update={"images": (OTHER, *VIEWS[1:])})}, "camera_mismatch"),
        ({"setup": SETUP.model_copy(update={"camera_convention": "full_K"})}, "camera_mismatch"),
        ({"setup": SETUP.model_copy(update={"background": (1.0, 1.0, 1.0)})}, "setup_mismatch"),
        ({"asset": File(path="x.triasset", bytes=10, sha256="b" * 64)}, "asset_mismatch"),
    ],
)
def test_what_is_not_alike_is_not_compared(other: dict[str, Any] | None, reason: str) -> None:
    first = result("dedicated")
    second = None if other is None else result("standard", **other)
    assert incomparable("psnr", first, second) == reason
    pair = {"dedicated": first} if second is None else {"dedicated": first, "standard": second}
    found = scene_gaps("psnr", pair)
    assert (found.port.value, found.port.reason, found.port.scenes) == (None, reason, 0)
    assert found.adapt.reason == "missing"


def test_metric_identity_counts_but_not_the_versions_of_libraries() -> None:
    changed = [{**one, "libraries": {"numpy": "1"}} for one in MEASURES]
    same = quality().model_copy(update={"metrics": tuple(changed)})
    assert incomparable("psnr", result(), result("standard", quality=same)) is None
    changed[0] = {**changed[0], "data_range": 255.0}
    other = quality().model_copy(update={"metrics": tuple(changed)})
    assert incomparable("psnr", result(), result("standard", quality=other)) == "metric_mismatch"
    assert incomparable("ssim", result(), result("standard", quality=other)) is None


def test_speeds_of_two_devices_are_not_compared() -> None:
    here, there = ({"device": {"device": {"name": name}}} for name in ("a", "b"))
    assert incomparable("fps", result(**here), result("standard", **there)) == "device_mismatch"
    assert incomparable("psnr", result(**here), result("standard", **there)) is None
    for key, reason in (("global_memory", None), ("compute_units", "device_mismatch")):
        less, more = ({"device": {"device": {"name": "a", key: value}}} for value in (8, 9))
        assert incomparable("fps", result(**less), result("standard", **more)) == reason
    ratio = slowdown({"s": {"dedicated": result(**here), "standard": result("standard", **there)}}, ["s"])
    assert (ratio.value, ratio.reason, ratio.partial) == (None, "device_mismatch", True)


def test_the_slowdown_of_a_dataset_is_the_ratio_of_means() -> None:
    rates = {"s0": {"dedicated": 100.0, "standard": 1000.0}, "s1": {"dedicated": 300.0, "standard": 600.0}}
    records = {
        scene: {name: result(name, timing=timing(fps)) for name, fps in own.items()}
        for scene, own in rates.items()
    }
    found = slowdown(records, rates)
    assert found.value == 4
    assert found.per_scene == pytest.approx({"s0": 10, "s1": 2})


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


MIPNERF360 = [25, 24, 30, 35, 37, 39, 16, 22, 18]


@pytest.mark.parametrize(
    ("views", "effect", "noise"),
    [
        *(([count], 0, 1) for count in (2, 3, 5, 20, 200)),
        *(([10] * count, 1, 0.3) for count in (2, 3, 5, 9)),
        ([10, 10], 0, 1),
        ([100, 200], 0.1, 1),
        (MIPNERF360, 0, 1),
        (MIPNERF360, 0.3, 1),
    ],
)
def test_pure_noise_is_called_significant_in_four_to_six_and_a_half_percent(
    views: list[int], effect: float, noise: float
) -> None:
    random = np.random.default_rng(len(views))
    said = [
        excludes_zero(interval([random.normal(effect * random.normal(), noise, count) for count in views]))
        for _ in range(3000)
    ]
    assert 0.04 <= np.mean(np.array(said, float)) <= 0.065


@pytest.mark.parametrize("shape", [(25,), (2,), (9, 25, 7), (3, 3), (1, 1, 1, 1), (600,), (600, 300)])
def test_is_that_of_scipys_test(shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(7)
    scenes = [list(random.normal(0.4 + random.normal(), 2, count)) for count in shape]
    found = interval(scenes)
    wanted = ttest_1samp(scenes[0] if len(shape) == 1 else [np.mean(views) for views in scenes], 0)
    ends = wanted.confidence_interval(0.95)
    assert found.ends == pytest.approx((ends.low, ends.high), rel=1e-12)
    if found.reason is None:
        assert found.p == pytest.approx(wanted.pvalue, rel=1e-12)
        assert excludes_zero(found) is bool(wanted.pvalue < 0.05) is not (ends.low <= 0 <= ends.high)


def test_it_says_what_was_drawn_at_random() -> None:
    assert interval([[1.0, 2.0, 4.0]]).over == "3 views of one scene"
    assert interval([[1.0, 2.0], [4.0, 5.0]]).over == "2 scenes"


@pytest.mark.parametrize(
    ("scenes", "ends", "reason"),
    [
        ([], None, "no values of single views"),
        ([[], [1.0, 2.0]], None, "no values of single views"),
        ([[3.0]], None, "one view has no spread"),
        ([[1.0, float("nan")]], None, "a value is not finite"),
        ([[1.0, float("inf")], [1.0, 2.0]], None, "a value is not finite"),
        ([[0.1] * 9], (0.1, 0.1), "9 views of one scene give one and the same value, which has no spread"),
        ([[0.0] * 3], (0.0, 0.0), "3 views of one scene give one and the same value, which has no spread"),
        ([[20.3 - 20.0, 30.3 - 30.0]], (0.3, 0.3), "2 views of one scene give one and the same value"),
        ([[0.0, 100.0], [50.0]], (50.0, 50.0), "2 scenes give one and the same value, which has no spread"),
        ([[1.0, 2.0], [5.0] * 7], (-18.986, 25.486), "the scenes have 2 to 7 views, too unequal for a test"),
    ],
)
def test_where_nothing_may_be_said_it_says_why(
    scenes: list[list[float]], ends: tuple[float, float] | None, reason: str
) -> None:
    found = interval(scenes)
    assert found.ends == (None if ends is None else pytest.approx(ends, abs=1e-3))
    assert str(found.reason).startswith(reason)
    assert found.p is None
    assert excludes_zero(found) is None
    assert excludes_zero(None) is None

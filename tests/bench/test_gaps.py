"""Averages over scenes, gaps, slowdowns and t intervals, and the reasons for missing ones."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from msb.bench.aggregate import METRICS, SCENES, expected_scenes, mean_over, scene_groups, why_unsteady
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
    ("metric", "values", "expected", "excess"),
    [
        ("psnr", (20, 22, 15), (2, 7, 5), 4),
        ("psnr", (20, 15, 18), (5, 3, 2), 6),
        ("lpips", (0.2, 0.3, 0.25), (0.1, 0.05, 0.05), 0.1),
        ("psnr", (20, 18, 15), (2, 3, 5), 0),
        ("psnr", (20, 20, 15), (0, 5, 5), 0),
    ],
)
def test_triangle_excess_if_dedicated_is_not_between(
    metric: str, values: tuple[float, ...], expected: tuple[float, ...], excess: float
) -> None:
    gaps = value_gaps(metric, *values)
    assert [gaps[name].value for name in PAIRS] == pytest.approx(list(expected))
    assert gaps.triangle_excess == pytest.approx(excess)
    assert gaps.monotone is (excess == 0)
    signed = [gaps[name].signed for name in PAIRS]
    assert signed[0] + signed[1] == pytest.approx(signed[2])


def test_losses_are_positive_and_gains_negative() -> None:
    assert value_gaps("psnr", 20, 22, 15).adapt.signed == -2
    assert value_gaps("lpips", 0.25, 0.5, 0.75).adapt.signed == 0.25
    assert value_gaps("fps", 10, 40, 400).port.signed == -360
    with pytest.raises(ValueError, match="mean_valence"):
        value_gaps("mean_valence", 1, 2, 3)


def make_records(*triples: tuple[float | None, ...]) -> dict[str, dict[str, Any]]:
    return {
        f"s{number}": {
            condition: result(condition, quality=quality(value))
            for condition, value in zip(CONDITIONS, triple, strict=True)
            if value is not None
        }
        for number, triple in enumerate(triples)
    }


def test_the_gap_of_a_dataset_is_between_the_averages() -> None:
    gaps = dataset_gaps("psnr", make_records((20, 22, 15), (30, 26, 25)), ["s0", "s1"])
    assert (gaps.adapt.value, gaps.adapt.signed, gaps.adapt.mean_abs_scene_gap) == (1, 1, 3)
    assert (gaps.deploy.value, gaps.deploy.mean_abs_scene_gap) == (5, 5)
    assert gaps.monotone
    assert (gaps.adapt.scenes, gaps.adapt.partial) == (2, False)


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
def test_incomparable_records_give_a_reason_and_no_gap(other: dict[str, Any] | None, reason: str) -> None:
    first = result("dedicated")
    second = None if other is None else result("standard", **other)
    assert incomparable("psnr", first, second) == reason
    pair = {"dedicated": first} if second is None else {"dedicated": first, "standard": second}
    gaps = scene_gaps("psnr", pair)
    assert (gaps.port.value, gaps.port.reason, gaps.port.scenes) == (None, reason, 0)
    assert gaps.adapt.reason == "missing"


def test_metric_definitions_must_be_equal_but_not_library_versions() -> None:
    changed = [{**identity, "libraries": {"numpy": "1"}} for identity in MEASURES]
    same = quality().model_copy(update={"metrics": tuple(changed)})
    assert incomparable("psnr", result(), result("standard", quality=same)) is None
    changed[0] = {**changed[0], "data_range": 255.0}
    other = quality().model_copy(update={"metrics": tuple(changed)})
    assert incomparable("psnr", result(), result("standard", quality=other)) == "metric_mismatch"
    assert incomparable("ssim", result(), result("standard", quality=other)) is None


def test_frame_rates_of_two_devices_are_not_compared() -> None:
    here, there = ({"device": {"device": {"name": name}}} for name in ("a", "b"))
    assert incomparable("fps", result(**here), result("standard", **there)) == "device_mismatch"
    assert incomparable("psnr", result(**here), result("standard", **there)) is None
    for key, reason in (("global_memory", None), ("compute_units", "device_mismatch")):
        less, more = ({"device": {"device": {"name": "a", key: value}}} for value in (8, 9))
        assert incomparable("fps", result(**less), result("standard", **more)) == reason
    ratio = slowdown({"s": {"dedicated": result(**here), "standard": result("standard", **there)}}, ["s"])
    assert (ratio.value, ratio.reason, ratio.partial) == (None, "device_mismatch", True)


def test_missing_scenes_do_not_hide_the_reason_of_the_others() -> None:
    here, there = ({"device": {"device": {"name": name}}} for name in ("a", "b"))
    records = {"s0": {"dedicated": result(**here), "standard": result("standard", **there)}}
    assert slowdown(records, ["s0", "s1", "s2"]).reason == "device_mismatch"
    assert slowdown(records, ["s1"]).reason == "missing"


def test_the_slowdown_of_a_dataset_is_the_ratio_of_averages() -> None:
    rates = {"s0": {"dedicated": 100.0, "standard": 1000.0}, "s1": {"dedicated": 300.0, "standard": 600.0}}
    records = {
        scene: {name: result(name, timing=timing(fps)) for name, fps in conditions.items()}
        for scene, conditions in rates.items()
    }
    ratio = slowdown(records, rates)
    assert ratio.value == 4
    assert ratio.per_scene == pytest.approx({"s0": 10, "s1": 2})


@pytest.mark.parametrize(("slowest", "value"), [(0.8, 10), (0.7, None)])
def test_a_rate_whose_rounds_differ_by_more_than_a_quarter_has_no_ratio(
    slowest: float, value: float | None
) -> None:
    rounds = timing(100.0, round_fps=(100.0 * slowest, 100.0))
    records = {"dedicated": result(timing=rounds), "standard": result("standard", timing=timing(1000.0))}
    ratio = slowdown({"s": records}, ["s"])
    assert (ratio.value, ratio.reason) == (value, None if value else "unsteady")
    assert (why_unsteady(records["dedicated"]) is None) is (value is not None)
    assert incomparable("p50_ms", *records.values()) is None  # device times do not depend on other programs


def test_an_average_weighs_scenes_and_not_groups() -> None:
    values = dict.fromkeys(scene_groups("mipnerf360")["indoor_mean"], 0.0)
    values |= dict.fromkeys(scene_groups("mipnerf360")["outdoor_mean"], 9.0)
    assert mean_over(values, SCENES["mipnerf360"]).value == 5
    assert {len(names) for names in SCENES.values()} == {9, 2, 8, 15}


def test_missing_values_make_an_average_partial() -> None:
    records = {"a": result(quality=quality(lpips=None)), "b": result(quality=quality(lpips=0.5))}
    values = {name: METRICS["lpips"].get(record) for name, record in records.items()}
    mean = mean_over(values, ["a", "b", "c"])
    assert (mean.value, mean.present, mean.expected, mean.partial) == (0.5, 1, 3, True)
    assert METRICS["chamfer"].get(records["a"]) is None
    assert mean_over({"a": 1.0, "other": 5.0}, ["a"]).value == 1


def test_expected_scenes_are_the_published_ones() -> None:
    published = ("train", "truck")
    for dataset, present, expected in (
        ("tanksandtemples", ["train"], published),
        ("tanksandtemples", ["train", "shed"], published),
        ("tanksandtemples", ["shed"], ("shed",)),
        ("my capture", ["b", "a", "b"], ("b", "a")),
        ("my capture", [], ()),
        ("mipnerf360", ["garden", "pebble"], SCENES["mipnerf360"]),
    ):
        assert expected_scenes(dataset, present) == expected


def test_every_metric_is_read_from_a_record() -> None:
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
    values = {name: metric.get(full) for name, metric in METRICS.items()}
    assert None not in values.values()
    assert (values["memory"], values["asset_size"], values["chamfer"], values["fps"]) == (10, 7, 0.8, 50)
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
def test_about_five_percent_of_noise_is_significant(views: list[int], effect: float, noise: float) -> None:
    random = np.random.default_rng(len(views))
    significant = [
        excludes_zero(interval([random.normal(effect * random.normal(), noise, count) for count in views]))
        for _ in range(3000)
    ]
    assert 0.04 <= np.mean(np.array(significant, float)) <= 0.065


@pytest.mark.parametrize("shape", [(25,), (2,), (9, 25, 7), (3, 3), (1, 1, 1, 1), (600,), (600, 300)])
def test_intervals_equal_those_of_scipy(shape: tuple[int, ...]) -> None:
    random = np.random.default_rng(7)
    scenes = [list(random.normal(0.4 + random.normal(), 2, count)) for count in shape]
    ours = interval(scenes)
    scipys = ttest_1samp(scenes[0] if len(shape) == 1 else [np.mean(views) for views in scenes], 0)
    ends = scipys.confidence_interval(0.95)
    assert ours.ends == pytest.approx((ends.low, ends.high), rel=1e-12)
    if ours.reason is None:
        assert ours.p == pytest.approx(scipys.pvalue, rel=1e-12)
        assert excludes_zero(ours) is bool(scipys.pvalue < 0.05) is not (ends.low <= 0 <= ends.high)


def test_an_interval_names_its_sample() -> None:
    assert interval([[1.0, 2.0, 4.0]]).over == "3 views of one scene"
    assert interval([[1.0, 2.0], [4.0, 5.0]]).over == "2 scenes"


@pytest.mark.parametrize(
    ("scenes", "ends", "reason"),
    [
        ([], None, "no values"),
        ([[], [1.0, 2.0]], None, "no values"),
        ([[3.0]], None, "a single view"),
        ([[1.0, float("nan")]], None, "a value is not finite"),
        ([[1.0, float("inf")], [1.0, 2.0]], None, "a value is not finite"),
        ([[0.1] * 9], (0.1, 0.1), "9 views"),
        ([[0.0] * 3], (0.0, 0.0), "3 views"),
        ([[20.3 - 20.0, 30.3 - 30.0]], (0.3, 0.3), "2 views"),
        ([[0.0, 100.0], [50.0]], (50.0, 50.0), "2 scenes"),
        ([[1.0, 2.0], [5.0] * 7], (-18.986, 25.486), "the scenes have 2 to 7 views"),
    ],
)
def test_a_missing_test_gives_a_reason(
    scenes: list[list[float]], ends: tuple[float, float] | None, reason: str
) -> None:
    estimate = interval(scenes)
    assert estimate.ends == (None if ends is None else pytest.approx(ends, abs=1e-3))
    assert str(estimate.reason).startswith(reason)
    assert estimate.p is None
    assert excludes_zero(estimate) is None
    assert excludes_zero(None) is None

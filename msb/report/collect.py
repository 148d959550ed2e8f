"""From records to numbers: every metric of every cell, means over scenes, gaps; and why one is missing."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from msb.bench.aggregate import AUDITED, METRICS, SCENES, expected_scenes, mean_over, scene_groups
from msb.bench.gaps import Gaps, Ratio, dataset_gaps, scene_gaps, slowdown
from msb.bench.intervals import interval, view_values
from msb.bench.records import BAKED, Result
from msb.bench.split import Split, loss_split
from msb.metrics.registry import IMAGE_METRICS
from msb.metrics.vgg import weights_source
from msb.registry import METHODS
from msb.report.numbers import (
    FLOOR,
    MEAN,
    OF_ASSET,
    ON_CPU,
    QUALITY,
    GapKey,
    Key,
    Number,
    Numbers,
    RatioKey,
    SplitKey,
    condition_order,
    gap_tiers,
    ratio_tiers,
    scene_title,
)
from msb.report.results import Place, ResultSet
from msb.report.table import NOT_SUPPORTED, NOT_THERE

_RATES = ("fps", "p50_ms", "p95_ms", "spread_ms", "busy_p50_ms", "host_ms", "unsteady")
# Metrics of a walk off the path.
WALK = ("flicker", "flicker_worst", "holes")
# Metrics of a condition with images, besides those of `QUALITY`.
_IMAGES = (*_RATES, *WALK, "memory", "driver_memory", "asset_size")
# Metrics of exported meshes and of bakes, and of bakes alone.
_OF_MESH, _OF_BAKE = ("faces", "tasks"), ("psnr_16", "bake_seconds")
# Metric -> the part of `Result.reasons` that says why it is not there.
_PARTS = {
    **dict.fromkeys((*_RATES, "memory", "driver_memory"), "timing"),
    **dict.fromkeys(WALK, "walk"),
    **dict.fromkeys(("train_memory", "train_seconds"), "training"),
    "chamfer": "chamfer",
    "tasks": "trial",
}

# Metric -> its key in `Result.floor`.
_FLOORS = {"memory": "memory_bytes", "p50_ms": "p50_ms", "p95_ms": "p95_ms"}

NOT_RUN = "not run"
REFERENCE = "rendered by our reference renderer, not by the method's own code"
SOUP = "a soup: no two faces share a vertex, so nothing of its connectivity can be good or bad"
LPIPS = "LPIPS of VGG16's features, version 0.1, of images scaled to [-1, 1]"
RESIZED = "against photographs resized here, not shipped in this size"
STE = "ste_threshold is on: faces of less opacity are left out, where Standard knows of no opacity otherwise"
WHITE = "photographs and renderings over white, as in the dataset's protocol"
_OVER_WHITE = ("dtu", "nerf_synthetic")
_COLORS = {(0.0, 0.0, 0.0): "black", (1.0, 1.0, 1.0): "white"}
_DRAWERS = {"upstream": "their own code", "msb_reference": "NumPy"}
_CAMERAS = {
    "gs_fov": "gs_fov (the principal point in the middle)",
    "full_K": "full_K (the principal point where it is)",
}


def collect(results: ResultSet) -> Numbers:
    """Return the numbers of `results`: datasets, methods and scenes in the paper's order, then others."""
    records: dict[Place, dict[str, Result]] = {
        place: {condition: loaded.result for condition, loaded in conditions.items()}
        for place, conditions in results.places.items()
    }
    values: dict[Key, Number] = {}
    views = _views(records)
    gaps: dict[GapKey, Gaps] = {}
    splits: dict[SplitKey, Split] = {}
    ratios: dict[RatioKey, Ratio] = {}
    drawn_by: dict[str, dict[str, str]] = {}
    by_dataset: dict[str, dict[Place, Mapping[str, Result]]] = {}
    for place, own in records.items():
        by_dataset.setdefault(place.dataset, {})[place] = own
    for dataset in _ordered(by_dataset, SCENES):
        there = by_dataset[dataset]
        scenes = _ordered({place.scene for place in there}, SCENES.get(dataset, ()))
        drawers = drawn_by[dataset] = _drawers(there)
        conditions_of = _conditions(there)
        for method in _ordered(conditions_of, METHODS):
            of_scenes = {scene: there.get(Place(dataset, scene, method), {}) for scene in scenes}
            conditions = conditions_of[method]
            for condition in conditions:
                metrics = _metrics_of(condition)
                _add_condition(values, views, dataset, method, condition, metrics, of_scenes)
            _add_condition(values, views, dataset, method, "non_engine", OF_ASSET, of_scenes)
            _add_gaps(gaps, dataset, method, gap_tiers(conditions, drawers), of_scenes)
            expected = expected_scenes(dataset, scenes)
            for scene, over in {**{scene: (scene,) for scene in scenes}, MEAN: expected}.items():
                for metric in QUALITY:
                    split = loss_split(metric, of_scenes, over)
                    if split is not None:
                        splits[SplitKey(dataset, scene, method, metric)] = split
            for standard, dedicated in ratio_tiers(conditions, drawers):
                for pair in ((standard, dedicated), (dedicated, "non_engine")):
                    ratios[RatioKey(dataset, method, *pair)] = slowdown(of_scenes, expected, *pair)
    verdicts = {
        Key(*place, condition, ""): result.audit.verdict.level
        for place, conditions in records.items()
        for condition, result in conditions.items()
        if result.audit is not None
    }
    return Numbers(_with_setups(values, records), gaps, ratios, views, drawn_by, splits, verdicts)


def _drawers(there: Mapping[Place, Mapping[str, Result]]) -> dict[str, str]:
    """Return condition -> what drew it in a dataset: an engine, OpenCL, NumPy, or the methods' own code."""
    names: dict[str, dict[str, None]] = {}
    for conditions in there.values():
        for condition, result in conditions.items():
            if condition != "exported_mesh":
                kind = "" if result.renderer is None else result.renderer.kind
                own = "OpenCL" if result.cell.condition != "non_engine" else _DRAWERS.get(kind)
                if name := result.cell.renderer or own:
                    names.setdefault(condition, {})[name] = None
    return {condition: ", ".join(own) for condition, own in names.items()}


def _views(records: Mapping[Place, Mapping[str, Result]]) -> dict[Key, dict[str, float]]:
    """Return the values of every view, of image metrics that all views of a record have."""
    return {
        Key(*place, condition, metric): values
        for place, conditions in records.items()
        for condition, result in conditions.items()
        for metric in QUALITY
        if (values := view_values(result, metric))
    }


def _ordered(names: Iterable[str], first: Iterable[str]) -> list[str]:
    """Return `names`: first those in `first`, in its order, then the others, scan2 before scan10."""
    order = list(first)

    def rank(name: str) -> tuple[int, list[Any]]:
        parts = [(int(p), "") if p.isdecimal() else (-1, p) for p in re.split(r"(\d+)", name)]
        return (order.index(name) if name in order else len(order), parts)

    return sorted(names, key=rank)


def _conditions(there: Mapping[Place, Mapping[str, Result]]) -> dict[str, list[str]]:
    """Return method -> conditions with records of it in a dataset, and others that it does not support."""
    shown: dict[str, set[str]] = {}
    for place, own in there.items():
        shown.setdefault(place.method, set()).update(own)
    names = dict.fromkeys(name for own in there.values() for name in own)
    order = {name: number for number, name in enumerate(sorted(names, key=condition_order))}
    for method in shown.keys() & METHODS.keys():
        shown[method].update(name for name in names if _unsupported(method, name))
    return {method: sorted(own, key=order.__getitem__) for method, own in shown.items()}


def _unsupported(method: str, condition: str) -> str | None:
    known = METHODS.get(method)
    tier = condition.partition("/")[0]
    if known is None or tier not in ("dedicated", "standard"):
        return None
    return known.unsupported.get(tier)  # type: ignore[call-overload,no-any-return]


def _metrics_of(condition: str) -> tuple[str, ...]:
    """Return the metrics of a condition, without those of the model itself."""
    metrics = (*AUDITED, *_OF_MESH) if condition == "exported_mesh" else (*QUALITY, *_IMAGES)
    return (*metrics, *_OF_MESH, *_OF_BAKE) if condition.startswith(f"{BAKED}/") else metrics


def _add_condition(
    values: dict[Key, Number],
    views: Mapping[Key, Mapping[str, float]],
    dataset: str,
    method: str,
    condition: str,
    metrics: Iterable[str],
    of_scenes: Mapping[str, Mapping[str, Result]],
) -> None:
    for metric in metrics:
        numbers = {}
        for scene, conditions in of_scenes.items():
            result = _holder(conditions, metric) if metric in OF_ASSET else conditions.get(condition)
            numbers[scene] = _number(metric, method, condition, result)
            key = Key(dataset, scene, method, condition, metric)
            values[key] = numbers[scene] = _with_interval(numbers[scene], [key], views)
        if metric in _FLOORS:
            members = expected_scenes(dataset, of_scenes)
            floors = {
                scene: _floor(metric, of_scenes[scene].get(condition), number)
                for scene, number in numbers.items()
                if scene in members
            }
            values[Key(dataset, FLOOR, method, condition, metric)] = _mean(floors, members)
        groups = {**scene_groups(dataset), MEAN: expected_scenes(dataset, of_scenes)}
        for name, members in groups.items():
            own = {scene: number for scene, number in numbers.items() if scene in members}
            if own:
                keys = [Key(dataset, scene, method, condition, metric) for scene in own]
                mean = _with_interval(_mean(own, members), keys, views)
                values[Key(dataset, name, method, condition, metric)] = mean


def _floor(metric: str, result: Result | None, whole: Number) -> Number:
    """Return what a renderer takes for one triangle, or why there is no number of the `whole` mesh either."""
    if whole.value is None:
        return whole
    if result is None or result.floor is None:
        return Number(None, reason="no single triangle was timed")
    return Number(float(getattr(result.floor, _FLOORS[metric])), notes=tuple(_notes(metric, result)))


def _with_interval(number: Number, keys: Sequence[Key], views: Mapping[Key, Mapping[str, float]]) -> Number:
    """Return a number with the interval of the mean over the views at `keys`; it is not held against 0."""
    if number.value is None or keys[0].metric not in QUALITY:
        return number
    own = interval([list(views[key].values()) for key in keys if key in views])
    return replace(number, interval=replace(own, p=None, reason=None if own.ends else own.reason))


def _holder(conditions: Mapping[str, Result], metric: str) -> Result | None:
    """Return the record that has a number of the whole asset, else the one that says why there is none."""
    for result in conditions.values():
        if METRICS[metric].get(result) is not None:
            return result
    own = [result for result in conditions.values() if _PARTS[metric] in result.reasons]
    return next(iter([*own, *conditions.values()]), None)


def _number(metric: str, method: str, condition: str, result: Result | None) -> Number:
    if result is None:
        why = _unsupported(method, condition)
        return Number(None, NOT_THERE, NOT_RUN) if why is None else Number(None, NOT_SUPPORTED, why)
    value = METRICS[metric].get(result)
    if value is not None:
        return Number(float(value), notes=tuple(_notes(metric, result)))
    if result.status != "done":
        mark = NOT_SUPPORTED if result.status == "unsupported" else NOT_THERE
        reason = result.reason
        text = None if reason is None else reason.message
        failed = f"failed: {reason.code}: {text}" if reason else "failed"
        return Number(None, mark, text if result.status == "unsupported" else failed)
    return Number(None, NOT_THERE, _why_missing(metric, result))


def _why_missing(metric: str, result: Result) -> str:
    part = "quality" if metric in QUALITY else _PARTS.get(metric)
    own = "renderer_timing" if metric in ("fps", "memory") else part
    for name in (part, own):
        if name in result.reasons:
            return result.reasons[name].message
    if result.quality is not None and metric in result.quality.missing:
        return result.quality.missing[metric]
    weights = metric in IMAGE_METRICS and IMAGE_METRICS[metric].load is not None
    if weights and result.quality is not None and result.quality.lpips_reason:
        return f"{IMAGE_METRICS[metric].title}: {result.quality.lpips_reason}; {weights_source(None)}"
    if metric == "driver_memory" and result.memory is not None and result.memory.driver_reason:
        return f"by the driver: {result.memory.driver_reason}"
    if metric == "chamfer" and result.cell.dataset != "dtu":
        return "the Chamfer distance needs a reference scan, which only DTU has"
    return {
        "timing": "not timed",
        "walk": "not walked through",
        "training": "no record of the training was given",
        "chamfer": "the Chamfer distance was not measured",
        "trial": "no task was tried",
    }.get(part or "", "not measured")


def _notes(metric: str, result: Result) -> Iterable[str]:
    part = "quality" if metric in QUALITY else _PARTS.get(metric)
    if part == "quality":
        if result.renderer is not None and result.renderer.kind == "msb_reference":
            yield REFERENCE
        if result.setup is not None and result.setup.gt_resized:
            yield RESIZED
        settings = {} if result.renderer is None else result.renderer.settings
        if result.cell.condition == "standard" and settings.get("ste_threshold") is not None:
            yield STE
        if metric == "lpips":
            yield LPIPS
            for one in () if result.quality is None else result.quality.metrics:
                if one.get("name") == "lpips_vgg" and one.get("weights"):
                    yield weights_source(one["weights"])
        if metric == "psnr" and result.quality is not None and result.quality.psnr_inf_count:
            yield "images equal to the ground truth count 100 dB"
    elif metric in AUDITED and result.audit is not None and result.audit.counts.all_apart:
        yield SOUP
    elif metric in ("fps", "memory") and result.renderer_timing is not None:
        yield f"measured elsewhere, on {result.renderer_timing.device}: {result.renderer_timing.timed}"
    elif metric in WALK and result.walk is not None:
        yield f"on a walk of {result.walk.frames} frames of {result.walk.width} x {result.walk.height} pixels"
    elif metric in _RATES and result.timing is not None and result.timing.device_kind != "gpu":
        kind = ON_CPU if result.timing.device_kind == "cpu" else "measured on a device that is no GPU"
        name = result.drawn_on.get("name")
        yield kind if name is None else f"{kind}: {name}"


def _mean(numbers: Mapping[str, Number], members: Iterable[str]) -> Number:
    mean = mean_over({scene: number.value for scene, number in numbers.items()}, members)
    if mean.value is not None:
        notes = dict.fromkeys(note for number in numbers.values() for note in number.notes)
        if mean.partial:
            over = sorted(scene for scene, number in numbers.items() if number.value is not None)
            named = ", ".join(map(scene_title, over))
            notes[f"({mean.present}/{mean.expected}) is the mean over {named} alone"] = None
        return Number(mean.value, present=mean.present, expected=mean.expected, notes=tuple(notes))
    absent = NOT_SUPPORTED if all(n.absent == NOT_SUPPORTED for n in numbers.values()) else NOT_THERE
    reasons = Counter(number.reason for number in numbers.values() if number.absent == absent)
    reason = reasons.most_common(1)[0][0] if reasons else None
    return Number(None, absent, reason, present=0, expected=mean.expected)


def _add_gaps(
    gaps: dict[GapKey, Gaps],
    dataset: str,
    method: str,
    tiers: Sequence[tuple[str, str]],
    of_scenes: Mapping[str, Mapping[str, Result]],
) -> None:
    expected = expected_scenes(dataset, of_scenes)
    for pair in tiers:
        named = dict(zip(("non_engine", "standard", "dedicated"), ("non_engine", *pair), strict=True))
        compared = {
            scene: {name: own[condition] for name, condition in named.items() if condition in own}
            for scene, own in of_scenes.items()
        }
        for metric in QUALITY:
            gaps[GapKey(dataset, MEAN, method, metric, *pair)] = dataset_gaps(metric, compared, expected)
            for scene, own in compared.items():
                gaps[GapKey(dataset, scene, method, metric, *pair)] = scene_gaps(metric, own)


def _with_setups(
    values: Mapping[Key, Number], records: Mapping[Place, Mapping[str, Result]]
) -> dict[Key, Number]:
    """Return `values`, with a note on image metrics wherever a setup is not that of most on its scene."""
    setups: dict[Place, dict[str, str]] = {}
    counts: dict[tuple[str, ...], Counter[str]] = defaultdict(Counter)
    # Dataset and method, or dataset, scene and method -> notes, each once and in order.
    notes: dict[tuple[str, ...], dict[str, None]] = defaultdict(dict)
    for place, conditions in records.items():
        if described := next(filter(None, map(_described, conditions.values())), None):
            setups[place] = described
            for what, value in described.items():
                counts[place.dataset, place.scene, what][value] += 1
        for text in (text for result in conditions.values() for text in result.trained):
            for row in (place.scene, MEAN):  # in the same words, so that a table has them once
                notes[place.dataset, row, place.method][f"{place.scene}: {text}"] = None
    for place, described in setups.items():
        of_method = notes[place.dataset, place.method]
        for what, value in described.items():
            ((usual, _),) = counts[place.dataset, place.scene, what].most_common(1)
            if value != usual:
                of_method[f"{what} {value}, where the other methods have {usual}"] = None
        if place.dataset in _OVER_WHITE and described["background"] == "white":
            of_method[WHITE] = None
    noted = dict(values)
    for key, number in values.items():
        if key.metric in QUALITY and number.value is not None:
            more = notes[key.dataset, key.method], notes[key.dataset, key.scene, key.method]
            noted[key] = replace(number, notes=(*number.notes, *more[0], *more[1]))
    return noted


def _described(result: Result) -> dict[str, str] | None:
    """Return what of a record's setup must be the same for two methods to be compared like for like."""
    if result.setup is None:
        return None
    images = () if result.quality is None else result.quality.images
    sizes = Counter((image.width, image.height) for image in images).most_common(1)
    background = result.setup.background
    return {
        "images of": result.setup.image_folder,
        "image size": f"{sizes[0][0][0]} x {sizes[0][0][1]}" if sizes else "unknown",
        "camera convention": _CAMERAS[result.setup.camera_convention],
        "background": _COLORS.get(background, ", ".join(f"{value:g}" for value in background)),
    }

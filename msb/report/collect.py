"""Collect numbers from result records: metrics, averages, gaps, and reasons for missing values."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from msb.bench.aggregate import (
    AUDITED,
    METRICS,
    SCENES,
    expected_scenes,
    mean_over,
    scene_groups,
    why_unsteady,
)
from msb.bench.gaps import Gaps, Ratio, dataset_gaps, scene_gaps, slowdown
from msb.bench.intervals import interval, view_values
from msb.bench.records import BAKED, Result
from msb.bench.split import Split, loss_split
from msb.metrics.registry import IMAGE_METRICS
from msb.metrics.vgg import weights_source
from msb.registry import METHODS
from msb.report.numbers import (
    ASSET_METRICS,
    FLOOR,
    MEAN,
    ON_CPU,
    QUALITY,
    GapKey,
    Key,
    Number,
    Numbers,
    RatioKey,
    SplitKey,
    condition_order,
    list_gap_pairs,
    list_ratio_pairs,
    scene_title,
)
from msb.report.results import Place, ResultSet
from msb.report.table import NOT_AVAILABLE, NOT_SUPPORTED, UNSTEADY

# Metrics of conditions with images: timing, the camera path beyond the captured views, and other metrics.
_TIMING = ("fps", "p50_ms", "p95_ms", "spread_ms", "busy_p50_ms", "host_ms", "unsteady")
WALK = ("flicker", "flicker_worst", "holes")
_DRAWN = (*_TIMING, *WALK, "memory", "driver_memory", "asset_size")
# Metrics of exported and baked meshes, and additional metrics of baked meshes.
_OF_MESH, _OF_BAKE = ("faces", "tasks"), ("psnr_16", "bake_seconds")
# Metrics that are computed from the frame rate.
_RATES = ("fps", "host_ms")
# For each metric, the key in `Result.reasons` that explains a missing value.
_REASON_KEYS = {
    **dict.fromkeys((*_TIMING, "memory", "driver_memory"), "timing"),
    **dict.fromkeys(WALK, "walk"),
    **dict.fromkeys(("train_memory", "train_seconds"), "training"),
    "chamfer": "chamfer",
    "tasks": "trial",
}
# For each metric, the attribute of `Result.floor` that stores the cost of a single triangle.
_FLOOR_ATTRIBUTES = {"memory": "memory_bytes", "p50_ms": "p50_ms", "p95_ms": "p95_ms"}

NOT_RUN = "this condition was not run"
REFERENCE = "rendered by our reference renderer, not by the method's own code"
SOUP = "a triangle soup, whose triangles share no vertices, so that its connectivity cannot be judged"
LPIPS = "LPIPS version 0.1 with VGG16 features, on images scaled to [-1, 1]"
RESIZED = "against photographs that msb resized; the dataset does not provide them at this size"
OUR_TRAINER = "trained by our own trainer on a CPU, not by the method's official code"
STE = "ste_threshold is set: Standard, which otherwise ignores opacity, omits faces below this opacity"
WHITE = "photographs and renderings are composited over white, as in the dataset's protocol"
# Datasets whose evaluation composites photographs and renderings over white.
_WHITE_DATASETS = ("dtu", "nerf_synthetic")
_COLORS = {(0.0, 0.0, 0.0): "black", (1.0, 1.0, 1.0): "white"}
# The renderer of Non-Engine images for each value of `RendererInfo.kind`.
_NATIVE_RENDERERS = {"upstream": "their own code", "msb_reference": "NumPy"}
_CAMERAS = {
    "gs_fov": "gs_fov (principal point at the image centre)",
    "full_K": "full_K (principal point as calibrated)",
}


def collect(results: ResultSet) -> Numbers:
    """Return the numbers of `results` for tables and charts.

    Datasets, methods and scenes of the paper come first, in the order of the paper.
    """
    records: dict[Place, dict[str, Result]] = {
        place: {condition: loaded.result for condition, loaded in conditions.items()}
        for place, conditions in results.places.items()
    }
    values: dict[Key, Number] = {}
    views = _collect_views(records)
    gaps: dict[GapKey, Gaps] = {}
    splits: dict[SplitKey, Split] = {}
    ratios: dict[RatioKey, Ratio] = {}
    drawn_by: dict[str, dict[str, str]] = {}
    by_dataset: dict[str, dict[Place, Mapping[str, Result]]] = {}
    for place, of_conditions in records.items():
        by_dataset.setdefault(place.dataset, {})[place] = of_conditions
    for dataset in _sort_names(by_dataset, SCENES):
        of_places = by_dataset[dataset]
        scenes = _sort_names({place.scene for place in of_places}, SCENES.get(dataset, ()))
        renderers = drawn_by[dataset] = _find_renderers(of_places)
        conditions_of = _list_conditions(of_places)
        for method in _sort_names(conditions_of, METHODS):
            # For each scene and condition, collect the record of this method. For a scene without records,
            # the dictionary is empty.
            of_scenes = {scene: of_places.get(Place(dataset, scene, method), {}) for scene in scenes}
            conditions = conditions_of[method]
            # Add values of single scenes and averages. First add values of the conditions, then values of the
            # trained model.
            for condition in conditions:
                metrics = _metrics_of(condition)
                _add_condition(values, views, dataset, method, condition, metrics, of_scenes)
            _add_condition(values, views, dataset, method, "non_engine", ASSET_METRICS, of_scenes)
            # Add differences between conditions, and add parts of the loss. Differences and parts are
            # computed for each scene and on average.
            _add_gaps(gaps, dataset, method, list_gap_pairs(conditions, renderers), of_scenes)
            expected = expected_scenes(dataset, scenes)
            for scene, averaged in {**{scene: (scene,) for scene in scenes}, MEAN: expected}.items():
                for metric in QUALITY:
                    split = loss_split(metric, of_scenes, averaged)
                    if split is not None:
                        splits[SplitKey(dataset, scene, method, metric)] = split
            # Add the ratios of frame rates.
            for standard, dedicated in list_ratio_pairs(conditions, renderers):
                for pair in ((standard, dedicated), (dedicated, "non_engine")):
                    ratios[RatioKey(dataset, method, *pair)] = slowdown(of_scenes, expected, *pair)
    verdicts = {
        Key(*place, condition, ""): result.audit.verdict.level
        for place, conditions in records.items()
        for condition, result in conditions.items()
        if result.audit is not None
    }
    return Numbers(_add_setup_notes(values, records), gaps, ratios, views, drawn_by, splits, verdicts)


def _find_renderers(of_places: Mapping[Place, Mapping[str, Result]]) -> dict[str, str]:
    """Return the renderer's name for each condition: an engine, OpenCL, NumPy, or native code."""
    names: dict[str, dict[str, None]] = {}
    for conditions in of_places.values():
        for condition, result in conditions.items():
            if condition != "exported_mesh":
                kind = "" if result.renderer is None else result.renderer.kind
                native = result.cell.condition == "non_engine"
                default = _NATIVE_RENDERERS.get(kind) if native else "OpenCL"
                if name := result.cell.renderer or default:
                    names.setdefault(condition, {})[name] = None
    return {condition: ", ".join(renderers) for condition, renderers in names.items()}


def _collect_views(records: Mapping[Place, Mapping[str, Result]]) -> dict[Key, dict[str, float]]:
    """Return the values of all views for each image metric.

    Metrics without a value for every view are omitted.
    """
    return {
        Key(*place, condition, metric): values
        for place, conditions in records.items()
        for condition, result in conditions.items()
        for metric in QUALITY
        if (values := view_values(result, metric))
    }


def _sort_names(names: Iterable[str], first: Iterable[str]) -> list[str]:
    """Return `names` sorted like `first`. Names that `first` does not contain follow in natural order."""
    order = list(first)

    def rank(name: str) -> tuple[int, list[Any]]:
        parts = [(int(p), "") if p.isdecimal() else (-1, p) for p in re.split(r"(\d+)", name)]
        return (order.index(name) if name in order else len(order), parts)

    return sorted(names, key=rank)


def _list_conditions(of_places: Mapping[Place, Mapping[str, Result]]) -> dict[str, list[str]]:
    """For each method on a dataset, return the recorded conditions and the unsupported conditions."""
    recorded: dict[str, set[str]] = {}
    for place, conditions in of_places.items():
        recorded.setdefault(place.method, set()).update(conditions)
    names = dict.fromkeys(name for conditions in of_places.values() for name in conditions)
    order = {name: number for number, name in enumerate(sorted(names, key=condition_order))}
    for method in recorded.keys() & METHODS.keys():
        recorded[method].update(name for name in names if _why_unsupported(method, name))
    return {method: sorted(conditions, key=order.__getitem__) for method, conditions in recorded.items()}


def _why_unsupported(method: str, condition: str) -> str | None:
    """Return the reason if a method does not support the tier of a condition, else None."""
    definition = METHODS.get(method)
    tier = condition.partition("/")[0]
    if definition is None or tier not in ("dedicated", "standard"):
        return None
    return definition.unsupported.get(tier)  # type: ignore[call-overload,no-any-return]


def _metrics_of(condition: str) -> tuple[str, ...]:
    """Return the names of all metrics of a condition, except metrics of the trained model."""
    metrics = (*AUDITED, *_OF_MESH) if condition == "exported_mesh" else (*QUALITY, *_DRAWN)
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
    """Add the numbers of a condition to `values`: values of single scenes, and averages."""
    for metric in metrics:
        # Add the values of single scenes, with the confidence interval over their views.
        numbers = {}
        for scene, conditions in of_scenes.items():
            of_asset = metric in ASSET_METRICS
            result = _find_asset_record(conditions, metric) if of_asset else conditions.get(condition)
            key = Key(dataset, scene, method, condition, metric)
            number = _make_number(metric, method, condition, result)
            values[key] = numbers[scene] = _with_interval(number, [key], views)
        # The average cost of a single triangle.
        expected = expected_scenes(dataset, of_scenes)
        if metric in _FLOOR_ATTRIBUTES:
            floors = {
                scene: _floor_number(metric, of_scenes[scene].get(condition), number)
                for scene, number in numbers.items()
                if scene in expected
            }
            values[Key(dataset, FLOOR, method, condition, metric)] = _average(floors, expected)
        # Add averages over groups of scenes and over all scenes.
        for name, members in {**scene_groups(dataset), MEAN: expected}.items():
            of_group = {scene: number for scene, number in numbers.items() if scene in members}
            if of_group:
                keys = [Key(dataset, scene, method, condition, metric) for scene in of_group]
                mean = _with_interval(_average(of_group, members), keys, views)
                values[Key(dataset, name, method, condition, metric)] = mean


def _floor_number(metric: str, result: Result | None, number: Number) -> Number:
    """Return the renderer's cost of a single triangle.

    If the value of `number` (the cost of the mesh) is missing, `number` is returned.
    """
    if number.value is None:
        return number
    if result is None or result.floor is None:
        return Number(None, reason="no single triangle was timed")
    value = float(getattr(result.floor, _FLOOR_ATTRIBUTES[metric]))
    return Number(value, notes=tuple(_notes_on(metric, result)))


def _with_interval(number: Number, keys: Sequence[Key], views: Mapping[Key, Mapping[str, float]]) -> Number:
    """Add the confidence interval of a mean, without a p value.

    The interval describes the mean over the views at `keys`.
    """
    if number.value is None or keys[0].metric not in QUALITY:
        return number
    mean = interval([list(views[key].values()) for key in keys if key in views])
    return replace(number, interval=replace(mean, p=None, reason=None if mean.ends else mean.reason))


def _find_asset_record(conditions: Mapping[str, Result], metric: str) -> Result | None:
    """Return a record with a value of a metric of the trained model.

    If no record contains a value, return a record that explains the missing value.
    """
    for result in conditions.values():
        if METRICS[metric].get(result) is not None:
            return result
    with_reason = [result for result in conditions.values() if _REASON_KEYS[metric] in result.reasons]
    return next(iter([*with_reason, *conditions.values()]), None)


def _make_number(metric: str, method: str, condition: str, result: Result | None) -> Number:
    """Return the value of a metric in a record. If the value is missing, the result gives the reason."""
    if result is None:
        why = _why_unsupported(method, condition)
        return Number(None, NOT_AVAILABLE, NOT_RUN) if why is None else Number(None, NOT_SUPPORTED, why)
    value = METRICS[metric].get(result)
    if metric in _RATES and (unsteady := why_unsteady(result)) is not None:
        return Number(None, UNSTEADY, f"unsteady: {unsteady}")
    if value is not None:
        return Number(float(value), notes=tuple(_notes_on(metric, result)))
    if result.status == "unsupported":
        return Number(None, NOT_SUPPORTED, None if result.reason is None else result.reason.message)
    if result.status != "done":
        reason = result.reason
        return Number(None, NOT_AVAILABLE, f"failed: {reason.code}: {reason.message}" if reason else "failed")
    return Number(None, NOT_AVAILABLE, _why_missing(metric, result))


def _why_missing(metric: str, result: Result) -> str:
    """Return the reason that a finished record has no value of a metric."""
    part = "quality" if metric in QUALITY else _REASON_KEYS.get(metric)
    measured_elsewhere = "renderer_timing" if metric in ("fps", "memory") else part
    for name in (part, measured_elsewhere):
        if name in result.reasons:
            return result.reasons[name].message
    if result.quality is not None and metric in result.quality.missing:
        return result.quality.missing[metric]
    needs_weights = metric in IMAGE_METRICS and IMAGE_METRICS[metric].load is not None
    if needs_weights and result.quality is not None and result.quality.lpips_reason:
        return f"{IMAGE_METRICS[metric].title}: {result.quality.lpips_reason}; {weights_source(None)}"
    if metric == "train_memory" and result.training is not None:
        reason = result.training.memory_reason
        return "the record of the training has no peak GPU memory" + (f": {reason}" if reason else "")
    if metric == "driver_memory" and result.memory is not None and result.memory.driver_reason:
        return f"by the driver: {result.memory.driver_reason}"
    if metric == "chamfer" and result.cell.dataset != "dtu":
        return "the Chamfer distance needs a reference scan, which only DTU has"
    return {
        "timing": "not timed",
        "walk": "no walk beyond the captured views was rendered",
        "training": "no training record was given",
        "chamfer": "the Chamfer distance was not measured",
        "trial": "no trial task was run",
    }.get(part or "", "not measured")


def _notes_on(metric: str, result: Result) -> Iterable[str]:
    """Yield the footnotes on the value of a metric in a record."""
    part = "quality" if metric in QUALITY else _REASON_KEYS.get(metric)
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
            for identity in () if result.quality is None else result.quality.metrics:
                if identity.get("name") == "lpips_vgg" and identity.get("weights"):
                    yield weights_source(identity["weights"])
        if metric == "psnr" and result.quality is not None and result.quality.psnr_inf_count:
            yield "images equal to the ground truth count as 100 dB"
    elif metric in AUDITED and result.audit is not None and result.audit.counts.all_apart:
        yield SOUP
    elif metric in ("fps", "memory") and result.renderer_timing is not None:
        timing = result.renderer_timing
        yield f"measured separately, on {timing.device}: {timing.timed}"
    elif metric == "train_seconds" and result.training is not None and result.training.trainer == "ours":
        yield OUR_TRAINER
    elif metric in WALK and result.walk is not None:
        walk = result.walk
        yield f"on a walk of {walk.frames} frames of {walk.width} x {walk.height} pixels"
    elif metric in _TIMING and result.timing is not None and result.timing.device_kind != "gpu":
        kind = ON_CPU if result.timing.device_kind == "cpu" else "measured on a device that is not a GPU"
        name = result.drawn_on.get("name")
        yield kind if name is None else f"{kind}: {name}"


def _average(numbers: Mapping[str, Number], members: Iterable[str]) -> Number:
    """Return the mean of `numbers` over the scenes `members`, with all notes of the numbers."""
    mean = mean_over({scene: number.value for scene, number in numbers.items()}, members)
    if mean.value is not None:
        notes = dict.fromkeys(note for number in numbers.values() for note in number.notes)
        if mean.partial:
            scenes = sorted(scene for scene, number in numbers.items() if number.value is not None)
            named = ", ".join(map(scene_title, scenes))
            notes[f"({mean.present}/{mean.expected}): mean over {named} only"] = None
        return Number(mean.value, present=mean.present, expected=mean.expected, notes=tuple(notes))
    # If no scene has a value, the result has the most frequent reason.
    kinds = [number.absent for number in numbers.values()]
    if all(kind == NOT_SUPPORTED for kind in kinds):
        absent = NOT_SUPPORTED
    else:
        absent = UNSTEADY if UNSTEADY in kinds else NOT_AVAILABLE
    reasons = Counter(number.reason for number in numbers.values() if number.absent == absent)
    reason = reasons.most_common(1)[0][0] if reasons else None
    return Number(None, absent, reason, present=0, expected=mean.expected)


def _add_gaps(
    gaps: dict[GapKey, Gaps],
    dataset: str,
    method: str,
    pairs: Sequence[tuple[str, str]],
    of_scenes: Mapping[str, Mapping[str, Result]],
) -> None:
    """For each pair of conditions, compute the quality gaps of a method, and add them to `gaps`."""
    expected = expected_scenes(dataset, of_scenes)
    for pair in pairs:
        # For each tier, collect the records of the condition that `pair` names for the tier.
        named = dict(zip(("non_engine", "standard", "dedicated"), ("non_engine", *pair), strict=True))
        compared = {
            scene: {
                tier: conditions[condition] for tier, condition in named.items() if condition in conditions
            }
            for scene, conditions in of_scenes.items()
        }
        for metric in QUALITY:
            gaps[GapKey(dataset, MEAN, method, metric, *pair)] = dataset_gaps(metric, compared, expected)
            for scene, tiers in compared.items():
                gaps[GapKey(dataset, scene, method, metric, *pair)] = scene_gaps(metric, tiers)


def _add_setup_notes(
    values: Mapping[Key, Number], records: Mapping[Place, Mapping[str, Result]]
) -> dict[Key, Number]:
    """If the setups of the methods differ, add notes to image metrics. Return the new values."""
    setups: dict[Place, dict[str, str]] = {}
    counts: dict[tuple[str, ...], Counter[str]] = defaultdict(Counter)
    # For each method on a dataset or on a single scene, collect the notes. Dictionaries keep the notes unique
    # and in order.
    notes: dict[tuple[str, ...], dict[str, None]] = defaultdict(dict)
    for place, conditions in records.items():
        if setup := next(filter(None, map(_describe_setup, conditions.values())), None):
            setups[place] = setup
            for what, value in setup.items():
                counts[place.dataset, place.scene, what][value] += 1
        for text in (text for result in conditions.values() for text in result.trained):
            # Use the same text for a scene and for the average, so that a table prints it as one note.
            for row in (place.scene, MEAN):
                notes[place.dataset, row, place.method][f"{place.scene}: {text}"] = None
    for place, setup in setups.items():
        of_method = notes[place.dataset, place.method]
        for what, value in setup.items():
            ((usual, _),) = counts[place.dataset, place.scene, what].most_common(1)
            if value != usual:
                of_method[f"{what}: {value}; other methods have {usual}"] = None
        if place.dataset in _WHITE_DATASETS and setup["background"] == "white":
            of_method[WHITE] = None
    noted = dict(values)
    for key, number in values.items():
        if key.metric in QUALITY and number.value is not None:
            more = notes[key.dataset, key.method], notes[key.dataset, key.scene, key.method]
            noted[key] = replace(number, notes=(*number.notes, *more[0], *more[1]))
    return noted


def _describe_setup(result: Result) -> dict[str, str] | None:
    """Return the setup of a comparison as text.

    A fair comparison of two methods requires equal setups.
    """
    if result.setup is None:
        return None
    images = () if result.quality is None else result.quality.images
    sizes = Counter((image.width, image.height) for image in images).most_common(1)
    background = result.setup.background
    return {
        "photographs": result.setup.image_folder,
        "image size": f"{sizes[0][0][0]} x {sizes[0][0][1]}" if sizes else "unknown",
        "camera convention": _CAMERAS[result.setup.camera_convention],
        "background": _COLORS.get(background, ", ".join(f"{value:g}" for value in background)),
    }

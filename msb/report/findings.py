"""The findings: what the numbers say in sentences, each with its numbers and the table they stand in."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import combinations
from typing import TYPE_CHECKING

from msb.bench.aggregate import METRICS
from msb.bench.intervals import interval
from msb.report.collect import SOUP
from msb.report.finding import Case, Finding, sure
from msb.report.gap_findings import gap_findings, monotone_findings
from msb.report.metric_format import SHOWN, text
from msb.report.numbers import MEAN, QUALITY, Key, condition_title, dataset_title, method_title
from msb.report.safe_names import slug
from msb.report.table import NOT_SUPPORTED

if TYPE_CHECKING:
    from msb.bench.intervals import Interval
    from msb.report.numbers import Numbers

_MOST = 10
"""Findings; more are not read."""
_MINOR = ("monotone", "same_ranking", "training", "unsupported")
"""Kinds of what is as one expects, or is no finding on deployment."""


def find(numbers: Numbers, first: Iterable[Finding] = ()) -> list[Finding]:
    """Return at most ten findings, those in `first` and then the most important. No numbers, no findings."""
    found = [
        *first,
        *gap_findings(numbers),
        *monotone_findings(numbers),
        *_ranking_findings(numbers),
        *_leader_findings(numbers),
        *_training_findings(numbers),
        *_speed_findings(numbers),
        *_structure_findings(numbers),
        *_unsupported_findings(numbers),
    ]
    # What did not change, and what there is not, comes last; else the order is that above.
    return sorted(found, key=lambda one: one.kind in _MINOR)[:_MOST]


def _ranking_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield where the order of the methods by PSNR changes from one condition to another, and where not."""
    same: list[str] = []
    label = ""
    for dataset in numbers.datasets():
        conditions = [name for name in numbers.conditions(dataset) if not name.startswith("standard/")]
        changes: dict[str, list[str]] = {}
        compared = 0
        for first, second in combinations(conditions, 2):
            if "/" in first or first.partition("/")[0] == second.partition("/")[0]:
                continue  # a variant is held against Non-Engine alone
            before, after = (
                _ranking(numbers, dataset, first, second),
                _ranking(numbers, dataset, second, first),
            )
            if len(before) < 2:
                continue
            compared += 1
            if swapped := _swapped(before, after):
                certain = min((_swap(numbers, dataset, pair, (first, second)) for pair in swapped), key=_p)
                names = f"{condition_title(first)} and {condition_title(second)}{sure(certain)}"
                changes.setdefault(f"{_order(before)} becomes {_order(after)}", []).append(names)
        if changes:
            every = "; ".join(f"{', '.join(names)} ({order})" for order, names in changes.items())
            sentence = f"On {dataset_title(dataset)} the ranking by PSNR changes between {every}."
            yield Finding("ranking", sentence, f"renderer_comparison-{slug(dataset)}")
        elif compared:
            same.append(dataset_title(dataset))
            label = label or f"renderer_comparison-{slug(dataset)}"
    if same:
        sentence = f"On {', '.join(same)} the ranking by PSNR is the same under every condition."
        yield Finding("same_ranking", sentence, label)


def _leader_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield on which datasets another method leads by another metric: images against the surface, say."""
    found: list[str] = []
    table = ""
    for dataset in numbers.datasets():
        for condition in ("non_engine", "dedicated"):
            leaders = _leaders(numbers, dataset, condition)
            if len(leaders) < 2:
                continue
            each = ", ".join(
                f"{method_title(method)} by {' and '.join(by)}" for method, by in leaders.items()
            )
            found.append(f"on {dataset_title(dataset)} ({condition_title(condition)}) {each}")
            own = condition == "non_engine"
            table = table or ("native_summary" if own else f"renderer_comparison-{slug(dataset)}")
            break
    if found:
        yield Finding("leaders", f"No method leads by every metric: {'; '.join(found)}.", table)


def _leaders(numbers: Numbers, dataset: str, condition: str) -> dict[str, list[str]]:
    """Return method -> by what it leads; the Chamfer distance stands with the Non-Engine results."""
    leaders: dict[str, list[str]] = {}
    for metric in (*QUALITY, "chamfer"):
        best = _leader(numbers, dataset, "non_engine" if metric == "chamfer" else condition, metric)
        if best is not None:
            unit = f" {SHOWN[metric].unit}" if SHOWN[metric].unit in ("dB", "mm") else ""
            leaders.setdefault(best[0], []).append(f"{SHOWN[metric].title} {text(metric, best[1])}{unit}")
    return leaders


def _leader(numbers: Numbers, dataset: str, condition: str, metric: str) -> tuple[str, float] | None:
    """Return the best of at least two methods with whole means, and its value; None where two are equal."""
    found = {
        method: number.value
        for method in numbers.methods(dataset, condition)
        if (number := numbers.number(Key(dataset, MEAN, method, condition, metric))).value is not None
        and number.present == number.expected
    }
    ranked = sorted(found.items(), key=lambda one: one[1], reverse=METRICS[metric].better == "higher")
    if len(ranked) < 2 or abs(ranked[0][1] - ranked[1][1]) < SHOWN[metric].last_digit:
        return None
    return ranked[0]


def _training_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield how long the trainings took, the quickest and the longest of all means."""
    cases = [
        Case(number.value, key.dataset, key.method, f"{text('train_seconds', number.value)} min")
        for key, number in numbers.values.items()
        if (key.scene, key.metric, key.source) == (MEAN, "train_seconds", "") and number.value is not None
    ]
    if not cases:
        return
    first, last = min(cases), max(cases)
    if last.value - first.value >= SHOWN["train_seconds"].last_digit:
        sentence = f"A training takes from {first.detail} ({first.name}) to {last.detail} ({last.name})."
        yield Finding("training", sentence, "native_summary")


def _ranking(numbers: Numbers, dataset: str, condition: str, other: str) -> list[tuple[str, float]]:
    """Return the methods that have whole means in both conditions, best in `condition` first."""
    found = []
    for method in numbers.methods(dataset, condition):
        both = [numbers.number(Key(dataset, MEAN, method, c, "psnr")) for c in (condition, other)]
        if both[0].value is not None and all(n.value is not None and n.present == n.expected for n in both):
            found.append((method, both[0].value))
    return sorted(found, key=lambda pair: -pair[1])


def _swapped(before: list[tuple[str, float]], after: list[tuple[str, float]]) -> list[tuple[str, str]]:
    """Return the pairs of methods of which the second overtakes the first, by what a table shows."""
    digit, values = SHOWN["psnr"].last_digit, dict(after)
    return [
        (better, worse)
        for (better, first), (worse, second) in combinations(before, 2)
        if first - second >= digit and values[worse] - values[better] >= digit
    ]


def _swap(numbers: Numbers, dataset: str, pair: tuple[str, str], conditions: tuple[str, str]) -> Interval:
    """Return the less certain of two methods' differences under two conditions: both must be there."""
    found = []
    for condition in conditions:
        scenes = []
        for scene in numbers.scenes(dataset):
            values, others = (
                numbers.views.get(Key(dataset, scene, method, condition, "psnr"), {}) for method in pair
            )
            if common := [values[view] - others[view] for view in values if view in others]:
                scenes.append(common)
        found.append(interval(scenes))
    return max(found, key=_p)


def _p(found: Interval) -> float:
    return 2.0 if found.p is None else found.p


def _order(ranking: list[tuple[str, float]]) -> str:
    return ", ".join(f"{method_title(method)} {value:.2f}" for method, value in ranking)


def _speed_findings(numbers: Numbers) -> Iterator[Finding]:
    for above, below, kind, what in (
        ("standard", "dedicated", "slowdown", "Standard is {low} to {high} times as fast as Dedicated"),
        (
            "dedicated",
            "non_engine",
            "against_native",
            "Dedicated runs at {low} to {high} times the frame rate of Non-Engine",
        ),
    ):
        cases = [
            Case(ratio.value, key.dataset, key.method, f"{ratio.value:.1f}")
            for key, ratio in numbers.ratios.items()
            if (key.numerator, key.denominator) == (above, below) and ratio.value is not None
        ]
        if not cases:
            continue
        low, high = min(cases), max(cases)
        if len(cases) == 1:
            one = what.replace("{low} to {high}", low.detail)
            yield Finding(kind, f"{one} ({low.name}, by frame rate).", "slowdown")
        else:
            range_ = what.format(low=low.detail, high=high.detail)
            yield Finding(
                kind, f"{range_} (least {low.name}, most {high.name}; by mean frame rates).", "slowdown"
            )


def _structure_findings(numbers: Numbers) -> Iterator[Finding]:
    cases = [
        Case(number.value, key.dataset, key.method, f"{100 * number.value:.0f} %")
        for key, number in numbers.values.items()
        if (key.scene, key.metric) == (MEAN, "nonmanifold_vertex_ratio")
        and number.value is not None
        and SOUP not in number.notes
    ]
    if not cases:
        return
    low, high = min(cases), max(cases)
    label = f"mesh_connectivity-{slug(high.dataset)}"
    if high.value == 0:
        yield Finding(
            "structure", f"None of the indexed meshes ({len(cases)} means) has a non-manifold vertex.", label
        )
        return
    pieces = numbers.value(Key(high.dataset, MEAN, high.method, "exported_mesh", "components"))
    sentence = f"{high.detail} of the vertices of {high.name} are non-manifold"
    if pieces is not None:
        count = text("components", pieces)
        sentence += f", in {count} {'piece' if count == '1' else 'pieces'}"
    if len(cases) > 1:
        sentence += f", the most of {len(cases)} indexed meshes; the least are {low.detail}, of {low.name}"
    yield Finding("structure", f"{sentence}.", label)


def _unsupported_findings(numbers: Numbers) -> Iterator[Finding]:
    names: dict[str, dict[str, None]] = {}
    first = ""
    for key, number in numbers.values.items():
        if (
            (key.scene, key.metric) == (MEAN, "psnr")
            and number.value is None
            and number.absent == NOT_SUPPORTED
        ):
            names.setdefault(method_title(key.method), {})[condition_title(key.condition)] = None
            first = first or key.dataset
    if names:
        each = "; ".join(f"{name} under {' and '.join(conditions)}" for name, conditions in names.items())
        yield Finding("unsupported", f"Not supported: {each}.", f"renderer_comparison-{slug(first)}")

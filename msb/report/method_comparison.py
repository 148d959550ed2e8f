"""Compare every method with a chosen method in each view, with confidence intervals and t tests."""

from collections.abc import Iterator
from typing import NamedTuple

from msb.bench.aggregate import METRICS, expected_scenes
from msb.bench.gaps import Gap, gap_between
from msb.bench.intervals import LEVEL
from msb.errors import UsageError, shorten
from msb.report.findings import Finding, join_words
from msb.report.layout import difference_cell
from msb.report.metric_format import format_digits, metric_title
from msb.report.numbers import (
    DRAWN_CONDITIONS,
    MEAN,
    QUALITY,
    Key,
    Numbers,
    condition_title,
    dataset_title,
    method_title,
)
from msb.report.results import Place, ResultSet
from msb.report.table import NOT_AVAILABLE, Table, TableCell, TableColumn, TableRow
from msb.report.tables.gaps import REASONS, gap_cell

# Label of the table, and name of the section.
LABEL = "against"
_COLUMNS = (
    TableColumn("Better by"),
    TableColumn("from", ("95 % interval",)),
    TableColumn("to", ("95 % interval",)),
    TableColumn("p"),
    TableColumn("p, Holm"),
    TableColumn("Over"),
)
_NOTES = (
    "better by: the difference between the two methods, averaged over the common views of each scene and "
    "then over the scenes. The difference is positive if the row's method is better",
    "95 % interval: a t interval over the means of the scenes, or over the views of a single scene. An "
    "interval over views applies to that scene only. It is too narrow if neighbouring views are similar",
)
# If a gap is missing for one of these reasons, the table has no row for the comparison. If a gap is missing
# for another reason, the table has a row without a value.
_NO_COMPARISON = ("missing", "failed", "not_measured", "unsupported")


class Comparison(NamedTuple):
    """A comparison of two methods.

    `gap.signed` is positive if the method at `key` is better than the chosen method.
    """

    key: Key
    gap: Gap


def compare_methods(results: ResultSet, numbers: Numbers, other: str) -> list[Comparison]:
    """For each dataset, condition and metric, compare all other methods with the method `other`."""
    methods = sorted({place.method for place in results.places})
    if other not in methods:
        text = f'--against: the results hold no method "{shorten(other, 60)}"; name one of '
        raise UsageError("USAGE", text + ", ".join(methods))
    return [
        Comparison(key, gap)
        for dataset in numbers.datasets()
        for condition in numbers.conditions(dataset)
        for metric in QUALITY
        for method in numbers.methods(dataset, condition)
        if method != other
        for key in [Key(dataset, MEAN, method, condition, metric)]
        if (gap := _compute_gap(results, numbers, key, other)).reason not in _NO_COMPARISON
    ]


def _compute_gap(results: ResultSet, numbers: Numbers, key: Key, other: str) -> Gap:
    """Return the gap between the method `other` and the method at `key`."""
    # For each scene and method, collect the record for the condition of `key`.
    scenes = numbers.scenes(key.dataset)
    records = {
        scene: {
            method: conditions[key.condition].result
            for method in (key.method, other)
            if key.condition in (conditions := results.places.get(Place(key.dataset, scene, method), {}))
        }
        for scene in scenes
    }
    expected = expected_scenes(key.dataset, scenes)
    return gap_between(key.metric, records, expected, key.method, other, one_asset=False)[0]


def comparison_table(comparisons: list[Comparison], numbers: Numbers, other: str) -> Table:
    """Return the table with a row per comparison."""
    # Collect the p values of all comparisons that have a test. If a comparison has no test, its p value is
    # not adjusted.
    p = {
        n: interval.p
        for n, comparison in enumerate(comparisons)
        if (interval := comparison.gap.interval) is not None and interval.p is not None
    }
    adjusted = dict(zip(p, adjust_by_holm(list(p.values())), strict=True))
    rows = []
    for n, comparison in enumerate(comparisons):
        key = comparison.key
        labels = condition_title(key.condition), metric_title(key.metric), method_title(key.method)
        cells = _make_cells(comparison, adjusted.get(n), numbers, other)
        rows.append(TableRow(labels, cells, dataset_title(key.dataset)))
    tests = f"the {len(p)} tests" if len(p) != 1 else "the single test"
    return Table(
        LABEL,
        f"Every method compared with {method_title(other)}, view by view, under the same condition.",
        ("Condition", "Metric", "Method"),
        _COLUMNS,
        tuple(rows),
        (
            *_NOTES,
            "p: two-sided paired t test of the null hypothesis of no difference; p, Holm: adjusted for "
            f"{tests} of this table, because among many tests some p values fall below 0.05 by chance "
            "(Holm, 1979)",
        ),
    ).with_common_notes()


def comparison_findings(comparisons: list[Comparison], other: str) -> Iterator[Finding]:
    """Yield a finding on PSNR for each dataset.

    If both tiers exist, they are compared, otherwise all conditions are compared.

    If several conditions have the same result, one sentence names all of them.
    """
    cases = [case for case in comparisons if case.key.metric == "psnr" and case.gap.interval is not None]
    for dataset in dict.fromkeys(case.key.dataset for case in cases):
        of_dataset = [case for case in cases if case.key.dataset == dataset]
        tiers = [case for case in of_dataset if case.key.condition in DRAWN_CONDITIONS]
        # For each result text, collect the conditions with this result. Results over scenes and results over
        # views are collected separately.
        conditions: dict[tuple[str, str], list[str]] = {}
        for case in tiers or of_dataset:
            assert case.gap.interval is not None
            result = _describe(case, method_title(other)), case.gap.interval.over
            conditions.setdefault(result, []).append(condition_title(case.key.condition))
        parts = "; ".join(
            f"{text} under {join_words(titles)} ({over})" for (text, over), titles in conditions.items()
        )
        yield Finding("against", f"On {dataset_title(dataset)}, {parts}.", LABEL)


def format_p(p: float) -> str:
    """Return a p value with three decimals, or "< 0.001"."""
    return f"{p:.3f}" if p >= 0.001 else "< 0.001"


def _describe(comparison: Comparison, other: str) -> str:
    """Return a text such as "2DTS leads MeshSplatting by 0.70 dB (95 % CI 0.45 to 0.95, p = 0.007)"."""
    gap, interval = comparison.gap, comparison.gap.interval
    assert gap.signed is not None
    assert interval is not None
    better = gap.signed >= 0
    amount = format_digits(abs(gap.signed), METRICS["psnr"].decimals)
    method = method_title(comparison.key.method)
    if not float(amount):
        lead = f"{method} and {other} are equal at the printed precision"
    else:
        lead = f"{method} {'leads' if better else 'trails'} {other} by {amount} dB"
    parts = []
    if interval.ends is not None:
        # The printed difference is the absolute value. If the other method is better, reverse the sign of the
        # interval.
        low, high = interval.ends if better else (-interval.ends[1], -interval.ends[0])
        parts.append(f"95 % CI {format_digits(low, 2)} to {format_digits(high, 2)}")
    if interval.p is None:
        parts.append(f"not tested: {interval.reason}")
    else:
        parts.append(f"p {'' if interval.p < 0.001 else '= '}{format_p(interval.p)}")
        parts += [] if interval.p < LEVEL else ["not significant"]
    return f"{lead} ({', '.join(parts)})"


def _make_cells(
    comparison: Comparison, adjusted: float | None, numbers: Numbers, other: str
) -> tuple[TableCell, ...]:
    """Return the table cells of a comparison. `adjusted` is the p value adjusted by Holm's method."""
    key, gap, interval = comparison.key, comparison.gap, comparison.gap.interval
    if gap.signed is None or interval is None:
        reason = REASONS.get(gap.reason or "", gap.reason)
        return (TableCell(NOT_AVAILABLE, reason=reason),) + (TableCell(NOT_AVAILABLE),) * 5
    both = [numbers.number(key._replace(method=method)) for method in (key.method, other)]
    absent = TableCell(NOT_AVAILABLE, reason=interval.reason)
    return (
        gap_cell(key.metric, gap.signed, gap, both),
        *(
            absent if end is None else difference_cell(key.metric, end)
            for end in interval.ends or (None, None)
        ),
        *(absent if p is None else TableCell(format_p(p), p) for p in (interval.p, adjusted)),
        TableCell(interval.over, interval.over),
    )


def adjust_by_holm(p: list[float]) -> list[float]:
    """Return p values adjusted for multiple tests by Holm's method.

    The smallest of n values is multiplied by n, the next by n - 1, and so on. The adjusted values never
    decrease, so each value is at least as large as its predecessor.
    """
    # Visit the p values in ascending order. `least` is the previous adjusted value.
    adjusted, least = dict.fromkeys(range(len(p)), 0.0), 0.0
    for rank, place in enumerate(sorted(adjusted, key=p.__getitem__)):
        least = adjusted[place] = max(least, min(1.0, p[place] * (len(p) - rank)))
    return list(adjusted.values())

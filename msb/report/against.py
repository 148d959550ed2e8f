"""Methods against one of them: differences view by view with their intervals, as a table and as findings."""

from collections.abc import Iterator
from itertools import groupby
from typing import NamedTuple

from msb.bench.aggregate import METRICS, expected_scenes
from msb.bench.gaps import Gap, gap_between
from msb.errors import UsageError, shorten
from msb.report.findings import Finding
from msb.report.layout import difference_cell
from msb.report.metric_format import digits, title
from msb.report.numbers import MEAN, QUALITY, Key, Numbers, condition_title, dataset_title, method_title
from msb.report.results import Place, ResultSet
from msb.report.table import NOT_THERE, Cell, Column, Row, Table
from msb.report.tables.gaps import REASONS, gap_cell

LABEL = "against"
_COLUMNS = (
    Column("Better by"),
    Column("from", ("95 % interval",)),
    Column("to", ("95 % interval",)),
    Column("p"),
    Column("p, Holm"),
    Column("Over"),
)
_NOTES = (
    "better by: the difference in each view that both methods have, averaged over the views of a scene, then "
    "over scenes; positive where the method is better, whichever way the metric goes",
    "t intervals over the scenes' means, or over views where there is one scene; the latter are about that "
    "scene alone, and are too narrow as far as neighbouring views are alike",
)
_NOT_THERE = ("missing", "failed", "not_measured", "unsupported")


class Comparison(NamedTuple):
    """A method against the other: `gap` is signed, positive where the method at `key` is better."""

    key: Key
    gap: Gap


def comparisons(results: ResultSet, numbers: Numbers, other: str) -> list[Comparison]:
    """Return all comparisons with the method `other` under the same condition, by dataset and condition."""
    methods = sorted({place.method for place in results.places})
    if other not in methods:
        text = f'--against: there is no method "{shorten(other, 60)}" in the results; there are '
        raise UsageError("USAGE", text + ", ".join(methods))
    return [
        Comparison(key, gap)
        for dataset in numbers.datasets()
        for condition in numbers.conditions(dataset)
        for metric in QUALITY
        for method in numbers.methods(dataset, condition)
        if method != other
        for key in [Key(dataset, MEAN, method, condition, metric)]
        if (gap := _gap(results, numbers, key, other)).reason not in _NOT_THERE
    ]


def _gap(results: ResultSet, numbers: Numbers, key: Key, other: str) -> Gap:
    scenes = numbers.scenes(key.dataset)
    records = {
        scene: {
            method: held[key.condition].result
            for method in (key.method, other)
            if key.condition in (held := results.places.get(Place(key.dataset, scene, method), {}))
        }
        for scene in scenes
    }
    wanted = expected_scenes(key.dataset, scenes)
    return gap_between(key.metric, records, wanted, key.method, other, one_asset=False)[0]


def against_table(compared: list[Comparison], numbers: Numbers, other: str) -> Table:
    """Return a row per comparison."""
    p = {
        n: interval.p
        for n, one in enumerate(compared)
        if (interval := one.gap.interval) is not None and interval.p is not None
    }
    adjusted = dict(zip(p, holm(list(p.values())), strict=True))
    return Table(
        LABEL,
        f"Every method against {method_title(other)}, view by view, under the same condition.",
        ("Condition", "Metric", "Method"),
        _COLUMNS,
        tuple(
            Row(
                (condition_title(one.key.condition), title(one.key.metric), method_title(one.key.method)),
                _cells(one, adjusted.get(n), numbers, other),
                dataset_title(one.key.dataset),
            )
            for n, one in enumerate(compared)
        ),
        (
            *_NOTES,
            "p: of the two-sided t test that there is no difference; p, Holm: adjusted for the "
            f"{len(p)} tests of this table, of which some fall below 0.05 by chance (Holm, 1979)",
        ),
    ).with_common_notes()


def against_findings(compared: list[Comparison], other: str) -> Iterator[Finding]:
    """Yield what the comparisons by PSNR say, a sentence per dataset, condition and what they are over."""
    cases = (one for one in compared if one.key.metric == "psnr" and one.gap.interval is not None)
    for (dataset, condition, over), own in groupby(cases, key=_where):
        where = (
            f"{method_title(other)} on {dataset_title(dataset)}, {condition_title(condition)}, over {over}"
        )
        yield Finding("against", f"Against {where}: {'; '.join(map(_said, own))}.", LABEL)


def _where(one: Comparison) -> tuple[str, str, str]:
    assert one.gap.interval is not None
    return one.key.dataset, one.key.condition, one.gap.interval.over


def p_text(p: float) -> str:
    """Return a p as it is printed."""
    return f"{p:.3f}" if p >= 0.001 else "< 0.001"


def _said(one: Comparison) -> str:
    gap, interval = one.gap, one.gap.interval
    assert gap.signed is not None
    assert interval is not None
    better = gap.signed >= 0
    far = digits(abs(gap.signed), METRICS["psnr"].decimals)
    way = "apart" if not float(far) else "better" if better else "worse"
    said = f"{method_title(one.key.method)} is {far} dB {way}"
    parts = []
    if interval.ends is not None:
        low, high = interval.ends if better else (-interval.ends[1], -interval.ends[0])
        parts.append(f"95 % interval {digits(low, 2)} to {digits(high, 2)}")
    if interval.p is None:
        parts.append(f"not tested: {interval.reason}")
    else:
        parts.append(f"p {'' if interval.p < 0.001 else '= '}{p_text(interval.p)}")
    return f"{said} ({', '.join(parts)})"


def _cells(one: Comparison, adjusted: float | None, numbers: Numbers, other: str) -> tuple[Cell, ...]:
    key, gap, interval = one.key, one.gap, one.gap.interval
    if gap.signed is None or interval is None:
        return (Cell(NOT_THERE, reason=REASONS.get(gap.reason or "", gap.reason)),) + (Cell(NOT_THERE),) * 5
    both = [numbers.number(key._replace(method=method)) for method in (key.method, other)]
    absent = Cell(NOT_THERE, reason=interval.reason)
    return (
        gap_cell(key.metric, gap.signed, gap, both),
        *(
            absent if end is None else difference_cell(key.metric, end)
            for end in interval.ends or (None, None)
        ),
        *(absent if p is None else Cell(p_text(p), p) for p in (interval.p, adjusted)),
        Cell(interval.over, interval.over),
    )


def holm(p: list[float]) -> list[float]:
    """Return p adjusted for their number n: the least times n, the next times n - 1, and never falling."""
    adjusted, least = dict.fromkeys(range(len(p)), 0.0), 0.0
    for rank, place in enumerate(sorted(adjusted, key=p.__getitem__)):
        least = adjusted[place] = max(least, min(1.0, p[place] * (len(p) - rank)))
    return list(adjusted.values())

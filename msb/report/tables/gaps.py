"""Tables of what deployment costs: the three gaps, and frame rates against each other."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from msb.bench.gaps import PAIRS
from msb.report.layout import PAPER_ROW
from msb.report.metric_format import SHOWN, digits, title
from msb.report.numbers import (
    MEAN,
    QUALITY,
    GapKey,
    Key,
    RatioKey,
    condition_title,
    dataset_title,
    gap_tiers,
    method_title,
)
from msb.report.safe_names import plain_text, slug
from msb.report.table import NOT_SUPPORTED, NOT_THERE, Cell, Column, Row, Table

if TYPE_CHECKING:
    from msb.bench.gaps import Gap, GapName, Gaps
    from msb.report.numbers import Number, Numbers
    from msb.report.results import Place

REASONS = {
    "failed": "a run failed",
    "missing": "one of the two conditions was not run",
    "not_measured": "one of the two conditions has no such number",
    "camera_mismatch": "the two were not rendered from the same cameras at the same sizes",
    "setup_mismatch": "the two have another background or ground truth",
    "metric_mismatch": "the two were measured with different definitions of the metric",
    "asset_mismatch": "the two drew different assets",
    "device_mismatch": "the two ran on different devices",
    "whole_command": "the own renderer's time is of a whole command, loading and writing included",
}
"""`Gap.reason` in words; "unsupported" prints N/A."""
_GAPS: dict[GapName, str] = {"adapt": "Adapt", "port": "Port", "deploy": "Deploy"}
NOTES = (
    "adapt: Non-Engine to Dedicated; port: Dedicated to Standard; deploy: Non-Engine to Standard; each from "
    "its own definition, deploy is never a sum",
    "loss: the same with its sign, positive where something is lost",
    "monotone: Dedicated lies between the other two",
    "excess: adapt + port - deploy, 0 where monotone",
)
_COLUMNS = (
    *(Column(name, ("Gap",)) for name in _GAPS.values()),
    *(Column(name, ("Loss, signed",)) for name in _GAPS.values()),
    Column("Monotone"),
    Column("Excess"),
)
_RATIOS = (("standard", "dedicated"), ("dedicated", "non_engine"))


def gaps_table(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return the gaps of every method and metric of a dataset.

    Engines take the place of Standard, variants that of Dedicated.
    """
    rows: list[Row] = []
    for metric in QUALITY:
        for standard, dedicated in gap_tiers(numbers.conditions(dataset)):
            for method in numbers.methods(dataset, dedicated, standard):
                key = GapKey(dataset, MEAN, method, metric, standard, dedicated)
                if not key.own_tiers and key not in numbers.gaps:
                    continue
                labels = (title(metric), gap_title(key))
                rows.append(Row(labels, _cells(numbers, key)))
                if paper is not None and key in paper.gaps:
                    rows.append(Row((labels[0], PAPER_ROW), _cells(paper, key), paper=True))
    caption = f"{dataset_title(dataset)}: deployment gaps between the means over scenes."
    columns = (*_COLUMNS, Column("Mean scene gap"))
    note = (
        "mean scene gap: the mean of the scenes' absolute deploy gaps, never less than the gap of the means"
    )
    table = Table(
        f"gaps-{slug(dataset)}", caption, ("Metric", "Method"), columns, tuple(rows), (*NOTES, note)
    )
    return table.with_common_notes()


def gap_title(key: GapKey) -> str:
    """Return the method of a gap, and the variant or engine that it goes through."""
    names = [condition.partition("/")[2] for condition in (key.dedicated, key.standard)]
    return ", ".join((method_title(key.method), *map(plain_text, filter(None, names))))


def scene_gaps_table(numbers: Numbers, place: Place) -> Table:
    """Return the gaps of one method on one scene, through Dedicated and through each of its variants."""
    shown = (0, 1, 2, 6)
    through = [
        name
        for name in ("dedicated", *numbers.in_place_of(place.dataset, "dedicated"))
        if name == "dedicated" or Key(*place, name, "psnr") in numbers.values
    ]
    rows = []
    for metric in QUALITY:
        for dedicated in through:
            cells = _cells(numbers, GapKey(*place, metric, dedicated=dedicated))
            labels = (title(metric), *([condition_title(dedicated)] if len(through) > 1 else []))
            rows.append(Row(labels, tuple(cells[number] for number in shown)))
    columns = tuple(_COLUMNS[number] for number in shown)
    notes = (NOTES[0], NOTES[2])
    heads = ("Metric", "Through") if len(through) > 1 else ("Metric",)
    table = Table("gaps", "What is lost from condition to condition.", heads, columns, tuple(rows), notes)
    return table.with_common_notes()


def slowdown_table(numbers: Numbers, paper: Numbers | None = None) -> Table:
    """Return how many times faster Standard is than Dedicated, and Dedicated than Non-Engine."""
    rows: list[Row] = []
    for dataset in numbers.datasets():
        for dedicated in ("dedicated", *numbers.in_place_of(dataset, "dedicated")):
            for method in numbers.methods(dataset, dedicated):
                both = dedicated, "standard"
                if all(numbers.value(Key(dataset, MEAN, method, c, "fps")) is None for c in both):
                    continue
                key = GapKey(dataset, MEAN, method, "fps", dedicated=dedicated)
                labels = dataset_title(dataset), gap_title(key)
                rows.append(Row(labels, _ratio_cells(numbers, key)))
                if paper is not None and any(one == (*key[:1], method, *both[::-1]) for one in paper.ratios):
                    rows.append(Row((labels[0], PAPER_ROW), _ratio_cells(paper, key), paper=True))
    columns = tuple(
        Column(of, (f"{condition_title(above)} / {condition_title(below)}",))
        for above, below in _RATIOS
        for of in ("Means", "Scenes")
    )
    notes = (
        "ratios of frame rates, of the means over scenes and from the lowest to the highest scene",
        "the rates are end to end, so a ratio attributes nothing to sorting, blending or any other step",
    )
    table = Table(
        "slowdown", "Frame rates against each other.", ("Dataset", "Method"), columns, tuple(rows), notes
    )
    return table.with_common_notes()


def _cells(numbers: Numbers, key: GapKey) -> tuple[Cell, ...]:
    gaps = numbers.gaps.get(key)
    found = {name: None if gaps is None else gaps[name] for name in _GAPS}
    absent = {name: _why_absent(numbers, key, name, gap) for name, gap in found.items()}

    def cell(name: GapName, value: str) -> Cell:
        gap = found[name]
        number = None if gap is None else getattr(gap, value)
        if gap is None or number is None:
            return absent[name]
        count = f" ({gap.scenes}/{gap.expected})" if gap.partial else ""
        text = digits(number, SHOWN[key.metric].decimals, sign=value == "signed") + count
        notes = tuple(dict.fromkeys(note for end in _ends(numbers, key, name) for note in end.notes))
        unit = SHOWN[key.metric].unit
        made = Cell(text, number, key.metric, unit, notes=notes, present=gap.scenes, expected=gap.expected)
        return replace(made, interval=gap.interval) if value == "signed" else made

    return (
        *(cell(name, "value") for name in _GAPS),
        *(cell(name, "signed") for name in _GAPS),
        *_shape(
            gaps,
            key.metric,
            [absent[name] for name, gap in found.items() if gap is None or gap.value is None],
        ),
        Cell(NOT_THERE) if numbers.of_paper else cell("deploy", "mean_abs_scene_gap"),
    )


def _shape(gaps: Gaps | None, metric: str, absent: list[Cell]) -> tuple[Cell, Cell]:
    """Return whether the gaps add up, and if they do not, their excess."""
    if gaps is None or gaps.monotone is None or gaps.triangle_excess is None:
        other = Cell(NOT_THERE, reason="the gaps are not over the same scenes")
        cell = min(absent, key=lambda cell: cell.text != NOT_SUPPORTED, default=other)
        return cell, cell
    text = digits(gaps.triangle_excess, SHOWN[metric].decimals)
    return (
        Cell("yes" if gaps.monotone else "no", gaps.monotone),
        Cell(text, gaps.triangle_excess, metric, SHOWN[metric].unit),
    )


def _ends(numbers: Numbers, key: GapKey, name: GapName) -> list[Number]:
    """Return the two numbers whose difference a gap is."""
    conditions = [{"standard": key.standard, "dedicated": key.dedicated}.get(end, end) for end in PAIRS[name]]
    return [numbers.number(Key(key.dataset, key.scene, key.method, c, key.metric)) for c in conditions]


def _why_absent(numbers: Numbers, key: GapKey, name: GapName, gap: Gap | None) -> Cell:
    """Return the cell of a missing gap: N/A if one of its two numbers is N/A."""
    return _absent(_ends(numbers, key, name), "missing" if gap is None else gap.reason, key.metric)


def _ratio_cells(numbers: Numbers, key: GapKey) -> tuple[Cell, ...]:
    cells: list[Cell] = []
    for pair in _RATIOS:
        own = [key.dedicated if condition == "dedicated" else condition for condition in pair]
        ratio = numbers.ratios.get(RatioKey(key.dataset, key.method, *own))
        if ratio is None or ratio.value is None:
            ends = [numbers.number(Key(*key[:3], condition, "fps")) for condition in own]
            cells += [_absent(ends, "missing" if ratio is None else ratio.reason, "fps")] * 2
            continue
        rates = ratio.per_scene.values()
        count = f" ({len(rates)}/{ratio.expected})" if ratio.partial else ""
        cells.append(Cell(f"{ratio.value:.2f}{count}", ratio.value, "fps", "1"))
        if rates:
            low, high = min(rates), max(rates)
            cells.append(Cell(f"{low:.2f} to {high:.2f}", f"{low!r} to {high!r}"))
        else:
            cells.append(Cell(NOT_THERE))
    return tuple(cells)


def _absent(ends: list[Number], reason: str | None, metric: str) -> Cell:
    """Return the cell of a missing value: N/A if a number that it is made of is N/A."""
    unit = SHOWN[metric].unit
    for end in ends:
        if end.value is None and end.absent == NOT_SUPPORTED:
            return Cell(NOT_SUPPORTED, None, metric, unit, reason=end.reason)
    return Cell(NOT_THERE, None, metric, unit, reason=REASONS.get(reason or "", reason))

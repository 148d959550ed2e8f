"""Tables of the cost of deployment: the three quality gaps, and ratios of frame rates."""

from collections.abc import Iterable

from msb.bench.aggregate import METRICS
from msb.bench.gaps import PAIRS, Gap, GapName
from msb.bench.records import BAKED
from msb.report.layout import PAPER_ROW, difference_cell
from msb.report.metric_format import metric_title
from msb.report.numbers import (
    MEAN,
    ON_CPU,
    QUALITY,
    GapKey,
    Key,
    Number,
    Numbers,
    RatioKey,
    condition_title,
    dataset_title,
    method_title,
)
from msb.report.results import Place
from msb.report.safe_names import plain_text, slug
from msb.report.table import NOT_AVAILABLE, NOT_SUPPORTED, UNSTEADY, Table, TableCell, TableColumn, TableRow

# `Gap.reason` in words.
REASONS = {
    "failed": "a run failed",
    "missing": "one of the two conditions was not run",
    "not_measured": "one of the two conditions lacks this value",
    "camera_mismatch": "the compared results have different cameras or image sizes",
    "setup_mismatch": "the compared results have different backgrounds or ground truth",
    "metric_mismatch": "the compared results have different definitions of the metric",
    "asset_mismatch": "the compared results are of different assets",
    "device_mismatch": "the compared results were measured on different devices",
    "unsteady": "the frame rates of timing rounds differ by more than 25 %",
    "whole_command": "the time of the native renderer includes loading and writing",
}
PAPER_NOTE = (
    "in the paper, an engine's Dedicated loses 2.2 to 4.9 dB PSNR (DiffSoup 0.4 dB). We could not reproduce "
    "this loss. Our Dedicated draws the official image. With an engine's order and sampling, our models lose "
    "at most 0.4 dB at their training size. Only a port without sorting loses as much (docs/trained.md)"
)
_NAMES: dict[GapName, str] = {"adapt": "Adapt", "port": "Port", "deploy": "Deploy"}
NOTES = {
    "adapt": "adapt: from Non-Engine to Dedicated. port: from Dedicated to Standard. deploy: from "
    "Non-Engine to Standard. Each gap is computed from its two conditions, so deploy is not the "
    "sum of adapt and port",
    "loss": "loss: the gap with its sign, positive for a loss of quality",
    "monotone": "monotone: whether the value of Dedicated is between the values of Non-Engine and Standard",
    "excess": "excess: adapt + port - deploy, 0 if monotone",
    "mean": "mean scene gap: the mean of the absolute deploy gaps of all scenes. It is never less than the "
    "gap between the means",
}
_COLUMNS = {
    **{name: TableColumn(title, ("Gap",)) for name, title in _NAMES.items()},
    **{f"{name}_signed": TableColumn(title, ("Loss, signed",)) for name, title in _NAMES.items()},
    "monotone": TableColumn("Monotone"),
    "excess": TableColumn("Excess"),
    "mean": TableColumn("Mean scene gap"),
}
# Numerator and denominator of the ratios of frame rates.
_RATIOS = (("standard", "dedicated"), ("dedicated", "non_engine"))


def gaps_table(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return the gaps of every method and metric on a dataset.

    Further rows show gaps of other conditions. An engine or a bake can replace Standard, and a variant can
    replace Dedicated. If one engine draws both tiers, its conditions can replace Standard and Dedicated.
    """
    # Each metric has a block of rows: first the two tiers, then engines, bakes and variants.
    rows: list[TableRow] = []
    for metric in QUALITY:
        for standard, dedicated in numbers.gap_pairs(dataset):
            for method in numbers.methods(dataset, dedicated, standard):
                key = GapKey(dataset, MEAN, method, metric, standard, dedicated)
                gaps = numbers.gaps.get(key)
                if not key.is_between_tiers and gaps is None:
                    continue
                # Omit rows of bakes that have no value, because each bake adds several rows.
                if (
                    standard.startswith(f"{BAKED}/")
                    and gaps
                    and all(gaps[name].value is None for name in _NAMES)
                ):
                    continue
                labels = (metric_title(metric), gap_title(key))
                rows.append(TableRow(labels, tuple(_gap_cells(numbers, key).values())))
                if paper is not None and key in paper.gaps:
                    cells = tuple(_gap_cells(paper, key).values())
                    rows.append(TableRow((labels[0], PAPER_ROW), cells, paper=True))
    return Table(
        f"gaps-{slug(dataset)}",
        f"{dataset_title(dataset)}: deployment gaps between the means over scenes.",
        ("Metric", "Method"),
        tuple(_COLUMNS.values()),
        tuple(rows),
        (*NOTES.values(), *([PAPER_NOTE] if any(row.paper for row in rows) else [])),
    ).with_common_notes()


def gap_title(key: GapKey) -> str:
    """Return the title of a gap: the method, and the variant, engine or bake if any."""
    names = [condition.partition("/")[2] for condition in (key.dedicated, key.standard)]
    return ", ".join((method_title(key.method), *map(plain_text, filter(None, names))))


def scene_gaps_table(numbers: Numbers, place: Place) -> Table:
    """Return the gaps of one asset, for Dedicated and for each variant of Dedicated."""
    columns = (*_NAMES, "monotone")
    variants = [
        name
        for name in numbers.variants(place.dataset, "dedicated")
        if Key(*place, name, "psnr") in numbers.values
    ]
    rows = []
    for metric in QUALITY:
        for dedicated in ("dedicated", *variants):
            cells = _gap_cells(numbers, GapKey(*place, metric, dedicated=dedicated))
            labels = (metric_title(metric), *([condition_title(dedicated)] if variants else []))
            rows.append(TableRow(labels, tuple(cells[name] for name in columns)))
    return Table(
        "gaps",
        "Loss of quality between conditions.",
        ("Metric", "Through") if variants else ("Metric",),
        tuple(_COLUMNS[name] for name in columns),
        tuple(rows),
        (NOTES["adapt"], NOTES["monotone"]),
    ).with_common_notes()


def slowdown_table(numbers: Numbers, paper: Numbers | None = None) -> Table:
    """Return the table with two ratios of frame rates: Standard to Dedicated, and Dedicated to Non-Engine."""
    rows: list[TableRow] = []
    for dataset in numbers.datasets():
        for standard, dedicated in numbers.ratio_pairs(dataset):
            for method in numbers.methods(dataset, dedicated):
                both = standard, dedicated
                rates = [numbers.number(Key(dataset, MEAN, method, c, "fps")) for c in both]
                if all(rate.value is None and rate.absent != UNSTEADY for rate in rates):
                    continue
                key = GapKey(dataset, MEAN, method, "fps", standard, dedicated)
                labels = dataset_title(dataset), gap_title(key)
                rows.append(TableRow(labels, _ratio_cells(numbers, key)))
                if paper is not None and RatioKey(dataset, method, *both) in paper.ratios:
                    rows.append(TableRow((labels[0], PAPER_ROW), _ratio_cells(paper, key), paper=True))
    return Table(
        "slowdown",
        "Ratios of frame rates.",
        ("Dataset", "Method"),
        tuple(
            TableColumn(of, (f"{condition_title(above)} / {condition_title(below)}",))
            for above, below in _RATIOS
            for of in ("Means", "Scenes")
        ),
        tuple(rows),
        (
            "means: ratio of the means over scenes. scenes: smallest to largest ratio of single scenes",
            "the frame rates are end to end. A ratio does not measure the cost of sorting, blending or any "
            "other single step",
        ),
    ).with_common_notes()


def _gap_cells(numbers: Numbers, key: GapKey) -> dict[str, TableCell]:
    """For each key of `_COLUMNS`, return the table cell of the gaps at `key`."""
    gaps = numbers.gaps.get(key)
    # For each missing gap, create a table cell that gives the reason.
    absent = {}
    for name in _NAMES:
        reason = "missing" if gaps is None else gaps[name].reason
        absent[name] = absent_cell(_end_numbers(numbers, key, name), reason, key.metric)

    def cell(name: GapName, attribute: str) -> TableCell:
        value = None if gaps is None else getattr(gaps[name], attribute)
        if gaps is None or value is None:
            return absent[name]
        gap, signed = gaps[name], attribute == "signed"
        ends = _end_numbers(numbers, key, name)
        return gap_cell(key.metric, value, gap, ends, sign=signed, interval=signed)

    if gaps is None or gaps.monotone is None or gaps.triangle_excess is None:
        # If one of the gaps is missing, give the reason. A reason of the kind "not supported" (N/A) takes
        # precedence.
        missing = [absent[name] for name in _NAMES if gaps is None or gaps[name].value is None]
        other = TableCell(NOT_AVAILABLE, reason="the two gaps cover different scenes")
        monotone = excess = min(missing, key=lambda cell: cell.text != NOT_SUPPORTED, default=other)
    else:
        monotone = TableCell("yes" if gaps.monotone else "no", gaps.monotone)
        excess = difference_cell(key.metric, gaps.triangle_excess, sign=False)
    return {
        **{name: cell(name, "value") for name in _NAMES},
        **{f"{name}_signed": cell(name, "signed") for name in _NAMES},
        "monotone": monotone,
        "excess": excess,
        "mean": TableCell(NOT_AVAILABLE) if numbers.of_paper else cell("deploy", "mean_abs_scene_gap"),
    }


def gap_cell(
    metric: str, value: float, gap: Gap, ends: Iterable[Number], *, sign: bool = True, interval: bool = True
) -> TableCell:
    """Return a table cell for a value of `gap`.

    `ends` are the two compared numbers, whose notes are added to the cell.
    """
    return difference_cell(
        metric,
        value,
        sign=sign,
        notes=tuple(dict.fromkeys(note for end in ends for note in end.notes)),
        present=gap.scenes,
        expected=gap.expected,
        interval=gap.interval if interval else None,
    )


def _end_numbers(numbers: Numbers, key: GapKey, name: GapName) -> list[Number]:
    """Return the two numbers that a gap compares."""
    conditions = _replace_tiers(key, PAIRS[name])
    return [numbers.number(Key(key.dataset, key.scene, key.method, c, key.metric)) for c in conditions]


def _replace_tiers(key: GapKey, tiers: Iterable[str]) -> list[str]:
    """Replace the names "standard" and "dedicated" in `tiers` by the condition names of `key`."""
    return [{"standard": key.standard, "dedicated": key.dedicated}.get(tier, tier) for tier in tiers]


def _ratio_cells(numbers: Numbers, key: GapKey) -> tuple[TableCell, ...]:
    """For each pair of conditions, return two table cells: ratio of mean frame rates, and range."""
    cells: list[TableCell] = []
    for pair in _RATIOS:
        conditions = _replace_tiers(key, pair)
        ratio = numbers.ratios.get(RatioKey(key.dataset, key.method, *conditions))
        ends = [numbers.number(Key(*key[:3], condition, "fps")) for condition in conditions]
        if ratio is None or ratio.value is None:
            cells += [absent_cell(ends, "missing" if ratio is None else ratio.reason, "fps")] * 2
            continue
        of_scenes = ratio.per_scene.values()
        count = f" ({len(of_scenes)}/{ratio.expected})" if ratio.partial else ""
        devices = tuple(dict.fromkeys(note for end in ends for note in end.notes if note.startswith(ON_CPU)))
        cells.append(TableCell(f"{ratio.value:.2f}{count}", ratio.value, "fps", "1", notes=devices))
        low, high = min(of_scenes, default=0.0), max(of_scenes, default=0.0)
        printed = " to ".join(dict.fromkeys((f"{low:.2f}", f"{high:.2f}")))
        range_cell = TableCell(printed, f"{low!r} to {high!r}")
        cells.append(range_cell if of_scenes else TableCell(NOT_AVAILABLE))
    return tuple(cells)


def absent_cell(ends: Iterable[Number], reason: str | None, metric: str) -> TableCell:
    """Return the table cell of a missing difference.

    The text is "N/A" or "unsteady" if a compared number has this text, else "--".
    """
    unit = METRICS[metric].unit
    missing = [end for end in ends if end.value is None]
    for absent in (NOT_SUPPORTED, UNSTEADY):
        for end in missing:
            if end.absent == absent:
                return TableCell(absent, None, metric, unit, reason=end.reason)
    if reason == "unsteady":  # both numbers exist, so this is the only reason for the missing gap
        return TableCell(UNSTEADY, None, metric, unit, reason=REASONS[reason])
    return TableCell(NOT_AVAILABLE, None, metric, unit, reason=REASONS.get(reason or "", reason))

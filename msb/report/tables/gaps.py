"""Tables of what deployment costs: the three gaps, and frame rates against each other."""

from collections.abc import Iterable

from msb.bench.aggregate import METRICS
from msb.bench.gaps import PAIRS, Gap, GapName
from msb.bench.records import BAKED
from msb.report.layout import PAPER_ROW, difference_cell
from msb.report.metric_format import title
from msb.report.numbers import (
    MEAN,
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
from msb.report.table import NOT_SUPPORTED, NOT_THERE, Cell, Column, Row, Table

# `Gap.reason` in words; "unsupported" prints N/A.
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
_NAMES: dict[GapName, str] = {"adapt": "Adapt", "port": "Port", "deploy": "Deploy"}
NOTES = {
    "adapt": "adapt: Non-Engine to Dedicated; port: Dedicated to Standard; deploy: Non-Engine to Standard; "
    "each from its own definition, deploy is never a sum",
    "loss": "loss: the same with its sign, positive where something is lost",
    "monotone": "monotone: Dedicated lies between the other two",
    "excess": "excess: adapt + port - deploy, 0 where monotone",
    "mean": "mean scene gap: the mean of the scenes' absolute deploy gaps, never less than the gap of the "
    "means",
}
_COLUMNS = {
    **{name: Column(title, ("Gap",)) for name, title in _NAMES.items()},
    **{f"{name}_signed": Column(title, ("Loss, signed",)) for name, title in _NAMES.items()},
    "monotone": Column("Monotone"),
    "excess": Column("Excess"),
    "mean": Column("Mean scene gap"),
}
_RATIOS = (("standard", "dedicated"), ("dedicated", "non_engine"))


def gaps_table(numbers: Numbers, dataset: str, paper: Numbers | None = None) -> Table:
    """Return the gaps of every method and metric of a dataset.

    Engines and bakes take the place of Standard, variants that of Dedicated, and an engine that draws both of
    both.
    """
    rows: list[Row] = []
    for metric in QUALITY:
        for standard, dedicated in numbers.gap_tiers(dataset):
            for method in numbers.methods(dataset, dedicated, standard):
                key = GapKey(dataset, MEAN, method, metric, standard, dedicated)
                gaps = numbers.gaps.get(key)
                if not key.own_tiers and gaps is None:
                    continue
                if (
                    standard.startswith(f"{BAKED}/")
                    and gaps
                    and all(gaps[one].value is None for one in _NAMES)
                ):
                    continue  # of the many rows of bakes those that say nothing
                labels = (title(metric), gap_title(key))
                rows.append(Row(labels, tuple(_cells(numbers, key).values())))
                if paper is not None and key in paper.gaps:
                    cells = tuple(_cells(paper, key).values())
                    rows.append(Row((labels[0], PAPER_ROW), cells, paper=True))
    return Table(
        f"gaps-{slug(dataset)}",
        f"{dataset_title(dataset)}: deployment gaps between the means over scenes.",
        ("Metric", "Method"),
        tuple(_COLUMNS.values()),
        tuple(rows),
        tuple(NOTES.values()),
    ).with_common_notes()


def gap_title(key: GapKey) -> str:
    """Return the method of a gap, and the variant, engine or bake that it goes through."""
    names = [condition.partition("/")[2] for condition in (key.dedicated, key.standard)]
    return ", ".join((method_title(key.method), *map(plain_text, filter(None, names))))


def scene_gaps_table(numbers: Numbers, place: Place) -> Table:
    """Return the gaps of one method on one scene, through Dedicated and through each of its variants."""
    shown = (*_NAMES, "monotone")
    variants = [
        name
        for name in numbers.in_place_of(place.dataset, "dedicated")
        if Key(*place, name, "psnr") in numbers.values
    ]
    rows = []
    for metric in QUALITY:
        for dedicated in ("dedicated", *variants):
            cells = _cells(numbers, GapKey(*place, metric, dedicated=dedicated))
            labels = (title(metric), *([condition_title(dedicated)] if variants else []))
            rows.append(Row(labels, tuple(cells[name] for name in shown)))
    return Table(
        "gaps",
        "What is lost from condition to condition.",
        ("Metric", "Through") if variants else ("Metric",),
        tuple(_COLUMNS[name] for name in shown),
        tuple(rows),
        (NOTES["adapt"], NOTES["monotone"]),
    ).with_common_notes()


def slowdown_table(numbers: Numbers, paper: Numbers | None = None) -> Table:
    """Return how many times faster Standard is than Dedicated, and Dedicated than Non-Engine."""
    rows: list[Row] = []
    for dataset in numbers.datasets():
        for standard, dedicated in numbers.ratio_tiers(dataset):
            for method in numbers.methods(dataset, dedicated):
                both = standard, dedicated
                if all(numbers.value(Key(dataset, MEAN, method, c, "fps")) is None for c in both):
                    continue
                key = GapKey(dataset, MEAN, method, "fps", standard, dedicated)
                labels = dataset_title(dataset), gap_title(key)
                rows.append(Row(labels, _ratio_cells(numbers, key)))
                if paper is not None and RatioKey(dataset, method, *both) in paper.ratios:
                    rows.append(Row((labels[0], PAPER_ROW), _ratio_cells(paper, key), paper=True))
    return Table(
        "slowdown",
        "Frame rates against each other.",
        ("Dataset", "Method"),
        tuple(
            Column(of, (f"{condition_title(above)} / {condition_title(below)}",))
            for above, below in _RATIOS
            for of in ("Means", "Scenes")
        ),
        tuple(rows),
        (
            "ratios of frame rates, of the means over scenes and from the lowest to the highest scene",
            "the rates are end to end, so a ratio attributes nothing to sorting, blending or any other step",
        ),
    ).with_common_notes()


def _cells(numbers: Numbers, key: GapKey) -> dict[str, Cell]:
    """Return the cells of one gap, by the keys of `_COLUMNS`."""
    gaps = numbers.gaps.get(key)
    absent = {}
    for name in _NAMES:
        reason = "missing" if gaps is None else gaps[name].reason
        absent[name] = absent_cell(_ends(numbers, key, name), reason, key.metric)

    def cell(name: GapName, value: str) -> Cell:
        number = None if gaps is None else getattr(gaps[name], value)
        if gaps is None or number is None:
            return absent[name]
        gap, signed = gaps[name], value == "signed"
        return gap_cell(key.metric, number, gap, _ends(numbers, key, name), sign=signed, interval=signed)

    if gaps is None or gaps.monotone is None or gaps.triangle_excess is None:
        # Why the gaps do not add up: N/A of one of them before another reason.
        missing = [absent[name] for name in _NAMES if gaps is None or gaps[name].value is None]
        other = Cell(NOT_THERE, reason="the gaps are not over the same scenes")
        monotone = excess = min(missing, key=lambda cell: cell.text != NOT_SUPPORTED, default=other)
    else:
        monotone = Cell("yes" if gaps.monotone else "no", gaps.monotone)
        excess = difference_cell(key.metric, gaps.triangle_excess, sign=False)
    return {
        **{name: cell(name, "value") for name in _NAMES},
        **{f"{name}_signed": cell(name, "signed") for name in _NAMES},
        "monotone": monotone,
        "excess": excess,
        "mean": Cell(NOT_THERE) if numbers.of_paper else cell("deploy", "mean_abs_scene_gap"),
    }


def gap_cell(
    metric: str, value: float, gap: Gap, ends: Iterable[Number], *, sign: bool = True, interval: bool = True
) -> Cell:
    """Return the cell of a value of a gap, with the notes of its two `ends`."""
    return difference_cell(
        metric,
        value,
        sign=sign,
        notes=tuple(dict.fromkeys(note for end in ends for note in end.notes)),
        present=gap.scenes,
        expected=gap.expected,
        interval=gap.interval if interval else None,
    )


def _ends(numbers: Numbers, key: GapKey, name: GapName) -> list[Number]:
    """Return the two numbers whose difference a gap is."""
    conditions = _through(key, PAIRS[name])
    return [numbers.number(Key(key.dataset, key.scene, key.method, c, key.metric)) for c in conditions]


def _through(key: GapKey, tiers: Iterable[str]) -> list[str]:
    """Return the conditions that stand for `tiers` in a gap."""
    return [{"standard": key.standard, "dedicated": key.dedicated}.get(tier, tier) for tier in tiers]


def _ratio_cells(numbers: Numbers, key: GapKey) -> tuple[Cell, ...]:
    cells: list[Cell] = []
    for pair in _RATIOS:
        own = _through(key, pair)
        ratio = numbers.ratios.get(RatioKey(key.dataset, key.method, *own))
        if ratio is None or ratio.value is None:
            ends = [numbers.number(Key(*key[:3], condition, "fps")) for condition in own]
            cells += [absent_cell(ends, "missing" if ratio is None else ratio.reason, "fps")] * 2
            continue
        rates = ratio.per_scene.values()
        count = f" ({len(rates)}/{ratio.expected})" if ratio.partial else ""
        cells.append(Cell(f"{ratio.value:.2f}{count}", ratio.value, "fps", "1"))
        low, high = min(rates, default=0.0), max(rates, default=0.0)
        shown = " to ".join(dict.fromkeys((f"{low:.2f}", f"{high:.2f}")))
        range_ = Cell(shown, f"{low!r} to {high!r}")
        cells.append(range_ if rates else Cell(NOT_THERE))
    return tuple(cells)


def absent_cell(ends: Iterable[Number], reason: str | None, metric: str) -> Cell:
    """Return the cell of a missing value: N/A if a number that it is made of is N/A."""
    unit = METRICS[metric].unit
    for end in ends:
        if end.value is None and end.absent == NOT_SUPPORTED:
            return Cell(NOT_SUPPORTED, None, metric, unit, reason=end.reason)
    return Cell(NOT_THERE, None, metric, unit, reason=REASONS.get(reason or "", reason))

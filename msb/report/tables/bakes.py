"""Tables of bakes: what plain assets made of the models reach and cost, and what the loss is made of."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from msb.bench.records import BAKED
from msb.bench.split import STEPS, Split, StepName
from msb.report.layout import number_cell
from msb.report.metric_format import title, title_with_unit
from msb.report.numbers import (
    MEAN,
    QUALITY,
    Key,
    Number,
    Numbers,
    SplitKey,
    condition_title,
    dataset_title,
    method_title,
)
from msb.report.results import Place
from msb.report.safe_names import slug
from msb.report.table import NOT_THERE, Cell, Column, Row, Table
from msb.report.tables.gaps import absent_cell, gap_cell

STEP_TITLES: dict[StepName, str] = {"colors": "Colours", "faces": "Faces", "blending": "Blending"}
SPLIT_NOTES = (
    "colours: from the best bake that keeps the triangles (the ceiling) to Standard; faces: from the best "
    "other bake to the ceiling; blending: from Dedicated to that bake; best by PSNR, one sample a pixel",
    "to keep the triangles is to move none; those that an opaque picture is better without are left out",
    "the parts are over the same scenes and add up to the loss; what is negative is a gain",
)
_SPLIT_COLUMNS = (
    Column("Loss"),
    *(Column(name, ("made of",)) for name in STEP_TITLES.values()),
    Column("Ceiling", ("between",)),
    Column("Bake", ("between",)),
)
AS_SHIPPED = "as shipped"
BAKES_NOTES = (
    "bakes are taught by training views alone and drawn as Standard is; PSNR with one sample a pixel, and "
    "with 16, about what multisampling shows",
    "tasks: how many of those that were tried work, with care or without",
    "verdict: of the audit; where scenes differ, on how many of them",
)
_SHOWN = ("psnr", "psnr_16", "faces", "asset_size", "memory", "p50_ms", "bake_seconds", "tasks")
# What of a mesh as shipped is on record with the exported mesh.
_OF_MESH = ("faces", "tasks")
_LEVELS = ("ok", "limited", "bad")


def split_table(numbers: Numbers, dataset: str) -> Table:
    """Return what the loss from Dedicated to Standard is made of, by method and metric."""
    rows = [
        Row((title(metric), method_title(method)), _split_cells(numbers, key))
        for metric in QUALITY
        for method in numbers.methods(dataset)
        if (key := SplitKey(dataset, MEAN, method, metric)) in numbers.splits
    ]
    return Table(
        f"loss_split-{slug(dataset)}",
        f"{dataset_title(dataset)}: what the loss from Dedicated to Standard is made of.",
        ("Metric", "Method"),
        _SPLIT_COLUMNS,
        tuple(rows),
        SPLIT_NOTES,
    ).with_common_notes()


def scene_split_table(numbers: Numbers, place: Place) -> Table:
    """Return what the loss of one method on one scene is made of."""
    rows = [
        Row((title(metric),), _split_cells(numbers, key))
        for metric in QUALITY
        if (key := SplitKey(*place, metric)) in numbers.splits
    ]
    caption = "What the loss from Dedicated to Standard is made of."
    return Table("split", caption, ("Metric",), _SPLIT_COLUMNS, tuple(rows), SPLIT_NOTES).with_common_notes()


def _split_cells(numbers: Numbers, key: SplitKey) -> tuple[Cell, ...]:
    split = numbers.splits[key]
    ends = [numbers.number(Key(*key[:3], name, key.metric)) for name in ("dedicated", "standard")]
    if split.total is None or split.total.signed is None:
        total = absent_cell(ends, "missing" if split.total is None else split.total.reason, key.metric)
    else:
        total = gap_cell(key.metric, split.total.signed, split.total, ends)
    steps = (_step_cell(key, split, name, ends) for name in STEPS)
    marks = (Cell(NOT_THERE, reason="no such bake") if name is None else _label(name)
             for name in (split.ceiling, split.baked))  # fmt: skip
    return (total, *steps, *marks)


def _label(condition: str) -> Cell:
    name = condition.partition("/")[2]
    return Cell(name, name)


def _step_cell(key: SplitKey, split: Split, name: StepName, ends: Sequence[Number]) -> Cell:
    gap = split.steps.get(name)
    if gap is not None and gap.signed is not None:
        others = [STEP_TITLES[one].lower() for one, other in split.within.items() if other == name]
        cell = gap_cell(key.metric, gap.signed, gap, ends)
        return replace(cell, notes=(*cell.notes, *(f"with what {other} cost" for other in others)))
    if name in split.within:
        words = (STEP_TITLES[one].lower() for one in (name, split.within[name]))
        return Cell(NOT_THERE, reason="what {} cost is within {}, as no bake stands between".format(*words))
    own = {"colors": ends[1:], "blending": ends[:1]}.get(name, ())
    return absent_cell(own, "missing" if gap is None else gap.reason, key.metric)


def bakes_table(numbers: Numbers, dataset: str) -> Table:
    """Return the mesh as shipped and each bake: image quality, size, speed, seconds, verdict, tasks."""
    methods = numbers.methods(dataset, *numbers.in_place_of(dataset, BAKED))
    rows = [
        row
        for method in methods
        for row in _asset_rows(numbers, (dataset, MEAN, method), method_title(method))
    ]
    caption = f"{dataset_title(dataset)}: the plain meshes as shipped, and what was baked."
    return _bakes_table(f"bakes-{slug(dataset)}", caption, ("Method", "Asset"), rows)


def scene_bakes_table(numbers: Numbers, place: Place) -> Table:
    """Return the same of one model on one scene."""
    rows = _asset_rows(numbers, place)
    return _bakes_table("bakes", "The plain mesh as shipped, and what was baked.", ("Asset",), rows)


def _bakes_table(label: str, caption: str, heads: tuple[str, ...], rows: list[Row]) -> Table:
    columns = (*(Column(title_with_unit(metric)) for metric in _SHOWN), Column("Verdict"))
    return Table(label, caption, heads, columns, tuple(rows), BAKES_NOTES).with_common_notes()


def _asset_rows(numbers: Numbers, place: tuple[str, str, str], *labels: str) -> list[Row]:
    bakes = numbers.in_place_of(place[0], BAKED)
    rows = []
    for condition in ("standard", *bakes):
        if Key(*place, condition, "psnr") not in numbers.values:
            continue
        own = condition in bakes
        mesh = condition if own else "exported_mesh"
        cells = [
            number_cell(
                metric, numbers.number(Key(*place, mesh if metric in _OF_MESH else condition, metric))
            )
            for metric in _SHOWN
        ]
        name = condition_title(condition) if own else AS_SHIPPED
        rows.append(Row((*labels, name), (*cells, _verdict_cell(numbers, place, mesh))))
    return rows


def _verdict_cell(numbers: Numbers, place: tuple[str, str, str], condition: str) -> Cell:
    """Return the level of the verdict on a mesh, or on how many scenes it is which."""
    dataset, scene, method = place
    levels = Counter(
        level
        for key, level in numbers.verdicts.items()
        if (key.dataset, key.method, key.condition) == (dataset, method, condition)
        and scene in (MEAN, key.scene)
    )
    if not levels:
        return Cell(NOT_THERE, reason="the mesh was not audited")
    ordered = [level for level in _LEVELS if levels[level]]
    if len(ordered) == 1:
        return Cell(ordered[0].upper(), ordered[0])
    text = ", ".join(f"{level.upper()} {levels[level]}" for level in ordered)
    return Cell(text, text)

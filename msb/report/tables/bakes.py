"""Tables of baked meshes: their quality, their cost, and the parts of the loss from Dedicated to Standard."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from msb.bench.records import BAKED
from msb.bench.split import STEPS, Split, StepName
from msb.report.layout import number_cell
from msb.report.metric_format import metric_title, metric_title_with_unit
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
from msb.report.table import NOT_AVAILABLE, Table, TableCell, TableColumn, TableRow
from msb.report.tables.gaps import absent_cell, gap_cell

STEP_TITLES: dict[StepName, str] = {"colors": "Colours", "faces": "Faces", "blending": "Blending"}
SPLIT_NOTES = (
    "ceiling: the best bake that keeps the positions of all triangles. bake: the best of all other bakes. "
    "The best bake has the highest PSNR with one sample per pixel",
    "colours: from the ceiling to Standard. faces: from the bake to the ceiling. blending: from Dedicated "
    "to the bake. The ceiling omits triangles that make the opaque rendering worse",
    "all parts are averaged over the same scenes and add up to the loss; a negative part is a gain",
)
_SPLIT_COLUMNS = (
    TableColumn("Loss"),
    *(TableColumn(name, ("Parts",)) for name in STEP_TITLES.values()),
    TableColumn("Ceiling", ("Bakes between",)),
    TableColumn("Bake", ("Bakes between",)),
)
AS_EXPORTED = "as exported"
BAKES_NOTES = (
    "bakes use training views only and are rendered like Standard. PSNR is measured with one sample per "
    "pixel, and with 16 samples, which is close to multisampling",
    "tasks: number of trial tasks that work, possibly with limitations",
    "verdict: the verdict of the audit. If scenes have different verdicts, the cell lists the number of "
    "scenes per verdict",
)
_METRICS = ("psnr", "psnr_16", "faces", "asset_size", "memory", "p50_ms", "bake_seconds", "tasks")
# Metrics in the record of the exported mesh. All other metrics are in the record of the renderings.
_OF_MESH = ("faces", "tasks")
# Audit verdicts from the best to the worst.
_LEVELS = ("ok", "limited", "bad")


def split_table(numbers: Numbers, dataset: str) -> Table:
    """Return the parts of the loss from Dedicated to Standard, by metric and method."""
    rows = [
        TableRow((metric_title(metric), method_title(method)), _split_cells(numbers, key))
        for metric in QUALITY
        for method in numbers.methods(dataset)
        if (key := SplitKey(dataset, MEAN, method, metric)) in numbers.splits
    ]
    return Table(
        f"loss_split-{slug(dataset)}",
        f"{dataset_title(dataset)}: parts of the loss from Dedicated to Standard.",
        ("Metric", "Method"),
        _SPLIT_COLUMNS,
        tuple(rows),
        SPLIT_NOTES,
    ).with_common_notes()


def scene_split_table(numbers: Numbers, place: Place) -> Table:
    """Return the parts of the loss of one asset."""
    rows = [
        TableRow((metric_title(metric),), _split_cells(numbers, key))
        for metric in QUALITY
        if (key := SplitKey(*place, metric)) in numbers.splits
    ]
    caption = "Parts of the loss from Dedicated to Standard."
    return Table("split", caption, ("Metric",), _SPLIT_COLUMNS, tuple(rows), SPLIT_NOTES).with_common_notes()


def _split_cells(numbers: Numbers, key: SplitKey) -> tuple[TableCell, ...]:
    """Return the table cells of a loss: the total, the parts, and the names of the two bakes."""
    split = numbers.splits[key]
    ends = [numbers.number(Key(*key[:3], name, key.metric)) for name in ("dedicated", "standard")]
    if split.total is None or split.total.signed is None:
        total = absent_cell(ends, "missing" if split.total is None else split.total.reason, key.metric)
    else:
        total = gap_cell(key.metric, split.total.signed, split.total, ends)
    steps = (_step_cell(key, split, name, ends) for name in STEPS)
    bakes = (
        TableCell(NOT_AVAILABLE, reason="no bake of this kind was made")
        if name is None
        else _bake_name_cell(name)
        for name in (split.ceiling, split.baked)
    )
    return (total, *steps, *bakes)


def _bake_name_cell(condition: str) -> TableCell:
    name = condition.partition("/")[2]
    return TableCell(name, name)


def _step_cell(key: SplitKey, split: Split, name: StepName, ends: Sequence[Number]) -> TableCell:
    """Return the table cell of one part of a loss.

    If the bake between two parts is missing, only the sum of both parts is known. One table cell then
    contains the sum, and the other cell is empty.
    """
    gap = split.steps.get(name)
    if gap is not None and gap.signed is not None:
        included = [STEP_TITLES[step].lower() for step, outer in split.within.items() if outer == name]
        cell = gap_cell(key.metric, gap.signed, gap, ends)
        return replace(cell, notes=(*cell.notes, *(f"includes the loss of {step}" for step in included)))
    if name in split.within:
        part, outer_part = (STEP_TITLES[step].lower() for step in (name, split.within[name]))
        text = f"the loss of {part} is included in {outer_part}, because no bake separates them"
        return TableCell(NOT_AVAILABLE, reason=text)
    outer_ends = {"colors": ends[1:], "blending": ends[:1]}.get(name, ())
    return absent_cell(outer_ends, "missing" if gap is None else gap.reason, key.metric)


def bakes_table(numbers: Numbers, dataset: str) -> Table:
    """Return a table that compares the exported mesh with each bake."""
    methods = numbers.methods(dataset, *numbers.variants(dataset, BAKED))
    rows = [
        row
        for method in methods
        for row in _asset_rows(numbers, (dataset, MEAN, method), method_title(method))
    ]
    caption = f"{dataset_title(dataset)}: the meshes as exported, and baked."
    return _make_bakes_table(f"bakes-{slug(dataset)}", caption, ("Method", "Asset"), rows)


def scene_bakes_table(numbers: Numbers, place: Place) -> Table:
    """Return the table of bakes of one asset."""
    rows = _asset_rows(numbers, place)
    return _make_bakes_table("bakes", "The mesh as exported, and baked.", ("Asset",), rows)


def _make_bakes_table(label: str, caption: str, heads: tuple[str, ...], rows: list[TableRow]) -> Table:
    columns = (*(TableColumn(metric_title_with_unit(metric)) for metric in _METRICS), TableColumn("Verdict"))
    return Table(label, caption, heads, columns, tuple(rows), BAKES_NOTES).with_common_notes()


def _asset_rows(numbers: Numbers, place: tuple[str, str, str], *labels: str) -> list[TableRow]:
    """Return a row for the exported mesh, and a row per bake. `place` is dataset, scene and method."""
    # The exported mesh is drawn under the condition Standard. A baked mesh is drawn and audited under the
    # condition of its bake.
    bakes = numbers.variants(place[0], BAKED)
    rows = []
    for condition in ("standard", *bakes):
        if Key(*place, condition, "psnr") not in numbers.values:
            continue
        is_bake = condition in bakes
        mesh = condition if is_bake else "exported_mesh"
        keys = [Key(*place, mesh if metric in _OF_MESH else condition, metric) for metric in _METRICS]
        cells = [number_cell(key.metric, numbers.number(key)) for key in keys]
        name = condition_title(condition) if is_bake else AS_EXPORTED
        rows.append(TableRow((*labels, name), (*cells, _verdict_cell(numbers, place, mesh))))
    return rows


def _verdict_cell(numbers: Numbers, place: tuple[str, str, str], condition: str) -> TableCell:
    """Return the audit verdict on a mesh, such as "BAD", or the number of scenes with each verdict."""
    dataset, scene, method = place
    levels = Counter(
        level
        for key, level in numbers.verdicts.items()
        if (key.dataset, key.method, key.condition) == (dataset, method, condition)
        and scene in (MEAN, key.scene)
    )
    if not levels:
        return TableCell(NOT_AVAILABLE, reason="the mesh was not audited")
    ordered = [level for level in _LEVELS if levels[level]]
    if len(ordered) == 1:
        return TableCell(ordered[0].upper(), ordered[0])
    text = ", ".join(f"{level.upper()} {levels[level]}" for level in ordered)
    return TableCell(text, text)

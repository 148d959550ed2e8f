"""Arrange numbers in tables: format the numbers, mark the best values, and add the rows of the paper."""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from msb.bench.aggregate import METRICS
from msb.report.metric_format import (
    choose_decimals,
    format_digits,
    format_value,
    metric_title,
    to_printed_unit,
)
from msb.report.numbers import (
    ON_CPU,
    Key,
    Number,
    Numbers,
    condition_title,
    dataset_title,
    method_title,
    scene_title,
)
from msb.report.table import Table, TableCell, TableColumn, TableRow

# The last label of every row that contains numbers of the paper.
PAPER_ROW = "in the paper"


@dataclass(frozen=True)
class RowSpec:
    """A row of a table before its numbers are added.

    Attributes
    ----------
    labels : tuple of str
    of : mapping of str to str
        Fields that the row adds to the `Key` of each of its numbers.
    section, strong
        As in `TableRow`.
    bold : bool
        Whether all numbers of the row are printed bold.
    """

    labels: tuple[str, ...]
    of: Mapping[str, str]
    section: str = ""
    strong: bool = False
    bold: bool = False


_TITLES: Mapping[str, Callable[[str], str]] = {
    "dataset": dataset_title,
    "scene": scene_title,
    "method": method_title,
    "condition": condition_title,
    "metric": metric_title,
}


def titled_row(**of: str) -> RowSpec:
    """Return a row with the given key fields, such as ``condition="standard"``.

    The titles of the key fields are the labels of the row.
    """
    return RowSpec(tuple(_TITLES[name](value) for name, value in of.items()), of)


def metric_columns(metrics: Iterable[str], *groups: str, **of: str) -> list[TableColumn]:
    """Return a column for each metric, below the headings `groups`.

    The keyword arguments are further fields of the keys.
    """
    return [TableColumn(metric_title(metric), groups, {"metric": metric, **of}) for metric in metrics]


def make_table(
    numbers: Numbers,
    paper: Numbers | None,
    label: str,
    caption: str,
    heads: tuple[str, ...],
    columns: Sequence[TableColumn],
    row_specs: Iterable[RowSpec],
    of: Mapping[str, str],
    *,
    best_of: Sequence[str] = (),
    definitions: tuple[str, ...] = (),
    notes: tuple[str, ...] = (),
) -> Table:
    """Return a table of numbers.

    Parameters
    ----------
    numbers : Numbers
    paper : Numbers or None
        The paper's numbers. Below each of our rows that has published counterparts, a row shows the published
        numbers.
    label, caption, heads
        As in `Table`.
    columns : sequence of TableColumn
    row_specs : iterable of RowSpec
    of : mapping of str to str
        Fields that all keys share. A column can override these fields. A row can override the fields of its
        columns.
    best_of : sequence of str
        Key fields. Numbers form a group if they have the same metric and equal values of these fields. The
        best value of a group is bold. Numbers of the paper and our numbers are in different groups. If no
        fields are given, no value is bold.
    definitions : tuple of str
        Notes on our measurements. Notes on our measurements are omitted from the paper's own tables.
    notes : tuple of str
        Further notes.
    """
    # Collect the rows of the table, and the key of each cell.
    grid = [(spec, [Key(**{**of, **column.of, **spec.of}) for column in columns]) for spec in row_specs]
    rows = _make_rows(numbers, grid, best_of)
    if paper is not None:
        # Insert the paper's rows from the last to the first. Therefore the positions of earlier rows stay
        # valid.
        known = [n for n, (_, keys) in enumerate(grid) if any(paper.value(key) is not None for key in keys)]
        paper_rows = _make_rows(paper, [grid[n] for n in known], best_of)
        for n, row in reversed(list(zip(known, paper_rows, strict=True))):
            labels = (*row.labels[:-1], PAPER_ROW)
            rows.insert(n + 1, replace(row, labels=labels, strong=False, paper=True))
    notes = notes if numbers.of_paper else (*definitions, *notes)
    return Table(label, caption, heads, tuple(columns), tuple(rows), notes).with_common_notes()


def number_cell(metric: str, number: Number) -> TableCell:
    """Return the table cell of a number."""
    parts: dict[str, Any] = {"notes": number.notes, "present": number.present, "expected": number.expected}
    unit = METRICS[metric].unit
    if number.value is None:
        return TableCell(number.absent, None, metric, unit, reason=number.reason, **parts)
    value, printed = to_printed_unit(metric, number.value), format_value(metric, number.value)
    return TableCell(printed + _scene_count(parts), value, metric, unit, interval=number.interval, **parts)


def difference_cell(
    metric: str, value: float, *, sign: bool = True, more: int = 0, **parts: Any
) -> TableCell:
    """Return the table cell of a difference between two values of `metric`.

    `more` is the number of additional decimals. Further keyword arguments are attributes of the cell.
    """
    definition = METRICS[metric]
    printed = format_digits(value, definition.decimals + more, sign=sign)
    return TableCell(printed + _scene_count(parts), value, metric, definition.unit, **parts)


def _scene_count(parts: Mapping[str, Any]) -> str:
    """Return " (7/9)" for a mean over 7 of 9 scenes. For a mean over all scenes, return ""."""
    present, expected = parts.get("present", 1), parts.get("expected", 1)
    return f" ({present}/{expected})" if present < expected else ""


def mark_best(cells: Sequence[TableCell], groups: Sequence[Hashable], *, single: bool) -> list[TableCell]:
    """Return `cells`. The best value of each group and metric is bold.

    Values with the same printed text are also bold.

    Parameters
    ----------
    cells : sequence of TableCell
    groups : sequence of hashable
        The group of each cell. Cells with the group None are never marked.
    single : bool
        Whether a value is bold if it is the only value of its group.
    """
    # the positions of the compared cells, for each (group, metric)
    rivals: dict[tuple[Hashable, str], list[int]] = {}
    for place, (cell, group) in enumerate(zip(cells, groups, strict=True)):
        if group is not None and cell.value is not None and METRICS[cell.metric].better:
            rivals.setdefault((group, cell.metric), []).append(place)
    marked = list(cells)
    for (_, metric), places in rivals.items():
        if len(places) < 2 and not single:
            continue
        choose = max if METRICS[metric].better == "higher" else min
        # Compare printed values: values with the same printed text are equally good.
        best = choose(_round_as_printed(cells[place]) for place in places)
        for place in places:
            marked[place] = replace(cells[place], bold=_round_as_printed(cells[place]) == best)
    return marked


def _round_as_printed(cell: TableCell) -> float:
    assert isinstance(cell.value, float)
    return float(format_digits(cell.value, choose_decimals(cell.metric, cell.value)))


def _make_rows(
    numbers: Numbers, grid: list[tuple[RowSpec, list[Key]]], best_of: Sequence[str]
) -> list[TableRow]:
    """Return the rows of `grid` with their table cells. The best values are bold."""
    keys = [key for _, row_keys in grid for key in row_keys]
    values = [numbers.number(key) for key in keys]
    # A frame rate measured on a CPU is never marked as the best.
    groups = [
        tuple(getattr(key, field) for field in best_of)
        if best_of and not any(note.startswith(ON_CPU) for note in number.notes)
        else None
        for key, number in zip(keys, values, strict=True)
    ]
    plain = [number_cell(key.metric, number) for key, number in zip(keys, values, strict=True)]
    cells = iter(mark_best(plain, groups, single=numbers.of_paper))  # the paper prints these values in bold
    rows = []
    for spec, row_keys in grid:
        row = [next(cells) for _ in row_keys]
        row = [replace(cell, bold=cell.value is not None) for cell in row] if spec.bold else row
        rows.append(TableRow(spec.labels, tuple(row), spec.section, spec.strong))
    return rows

"""From the places of numbers to a table: look up, print, mark the best, set the paper's under ours."""

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from msb.bench.aggregate import METRICS
from msb.report.metric_format import decimals, digits, printed_value, text, title
from msb.report.numbers import ON_CPU, Key, Number, Numbers, condition_title, dataset_title, method_title
from msb.report.table import Cell, Column, Row, Table

PAPER_ROW = "in the paper"


@dataclass(frozen=True)
class Line:
    """A row before its numbers: labels, and the fields it gives to the keys of its cells.

    `bold` prints the whole row bold.
    """

    labels: tuple[str, ...]
    of: Mapping[str, str]
    section: str = ""
    strong: bool = False
    bold: bool = False


_TITLES: Mapping[str, Callable[[str], str]] = {
    "dataset": dataset_title,
    "method": method_title,
    "condition": condition_title,
    "metric": title,
}


def line(**of: str) -> Line:
    """Return the line whose labels are the titles of the fields that it gives to its keys."""
    return Line(tuple(_TITLES[name](value) for name, value in of.items()), of)


def metric_columns(metrics: Iterable[str], *groups: str, **of: str) -> list[Column]:
    """Return a column per metric under the headings `groups`; `of` are more fields of its keys."""
    return [Column(title(metric), groups, {"metric": metric, **of}) for metric in metrics]


def make_table(
    numbers: Numbers,
    paper: Numbers | None,
    label: str,
    caption: str,
    heads: tuple[str, ...],
    columns: Sequence[Column],
    lines: Iterable[Line],
    of: Mapping[str, str],
    *,
    best_of: Sequence[str] = (),
    definitions: tuple[str, ...] = (),
    notes: tuple[str, ...] = (),
) -> Table:
    """Return the table of the numbers whose keys are made of the fields of `of`, a column and a line.

    The paper's numbers stand under each row that has one. Numbers of one metric whose keys agree in the
    fields `best_of` compete for being the best, the paper's apart. `definitions` are notes on how we measure;
    the paper's own tables are printed without them.
    """
    grid = [(line, [Key(**{**of, **column.of, **line.of}) for column in columns]) for line in lines]
    rows = _rows(numbers, grid, best_of)
    if paper is not None:
        known = [n for n, (_, keys) in enumerate(grid) if any(paper.value(key) is not None for key in keys)]
        theirs = _rows(paper, [grid[n] for n in known], best_of)
        for n, row in reversed(list(zip(known, theirs, strict=True))):
            labels = (*row.labels[:-1], PAPER_ROW)
            rows.insert(n + 1, replace(row, labels=labels, strong=False, paper=True))
    notes = notes if numbers.of_paper else (*definitions, *notes)
    return Table(label, caption, heads, tuple(columns), tuple(rows), notes).with_common_notes()


def number_cell(metric: str, number: Number) -> Cell:
    """Return the cell of one number."""
    parts: dict[str, Any] = {"notes": number.notes, "present": number.present, "expected": number.expected}
    unit = METRICS[metric].unit
    if number.value is None:
        return Cell(number.absent, None, metric, unit, reason=number.reason, **parts)
    value, printed = printed_value(metric, number.value), text(metric, number.value)
    return Cell(printed + _count(parts), value, metric, unit, interval=number.interval, **parts)


def difference_cell(metric: str, value: float, *, sign: bool = True, more: int = 0, **parts: Any) -> Cell:
    """Return the cell of a difference, printed with `more` decimals than the metric; `parts` are others."""
    shown = METRICS[metric]
    printed = digits(value, shown.decimals + more, sign=sign)
    return Cell(printed + _count(parts), value, metric, shown.unit, **parts)


def _count(parts: Mapping[str, Any]) -> str:
    """Return of how many scenes a mean is, where some are missing."""
    present, expected = parts.get("present", 1), parts.get("expected", 1)
    return f" ({present}/{expected})" if present < expected else ""


def mark_best(cells: Sequence[Cell], groups: Sequence[Hashable], *, alone: bool) -> list[Cell]:
    """Return `cells` with the best of each group bold, and with it all that are printed alike.

    A cell of the group None does not compete; `alone` says whether a value without a rival is the best.
    """
    rivals: dict[tuple[Hashable, str], list[int]] = {}
    for place, (cell, group) in enumerate(zip(cells, groups, strict=True)):
        if group is not None and cell.value is not None and METRICS[cell.metric].better:
            rivals.setdefault((group, cell.metric), []).append(place)
    marked = list(cells)
    for (_, metric), places in rivals.items():
        if len(places) < 2 and not alone:
            continue
        choose = max if METRICS[metric].better == "higher" else min
        # What is printed decides: a reader sees no more.
        best = choose(_as_printed(cells[place]) for place in places)
        for place in places:
            marked[place] = replace(cells[place], bold=_as_printed(cells[place]) == best)
    return marked


def _as_printed(cell: Cell) -> float:
    assert isinstance(cell.value, float)
    return round(cell.value, decimals(cell.metric, cell.value))


def _rows(numbers: Numbers, grid: list[tuple[Line, list[Key]]], best_of: Sequence[str]) -> list[Row]:
    keys = [key for _, own in grid for key in own]
    values = [numbers.number(key) for key in keys]
    groups = [
        tuple(getattr(key, field) for field in best_of)
        if best_of and not any(note.startswith(ON_CPU) for note in number.notes)
        else None
        for key, number in zip(keys, values, strict=True)
    ]
    made = [number_cell(key.metric, number) for key, number in zip(keys, values, strict=True)]
    cells = iter(mark_best(made, groups, alone=numbers.of_paper))  # as the paper does
    rows = []
    for line, own in grid:
        row = [next(cells) for _ in own]
        row = [replace(cell, bold=cell.value is not None) for cell in row] if line.bold else row
        rows.append(Row(line.labels, tuple(row), line.section, line.strong))
    return rows

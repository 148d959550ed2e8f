"""From the places of numbers to a table: look up, print, mark the best, set the paper's under ours."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from msb.bench.aggregate import METRICS
from msb.report.metric_format import SHOWN, printed_value, text
from msb.report.numbers import ON_CPU
from msb.report.table import Cell, Column, Row, Table

if TYPE_CHECKING:
    from msb.report.numbers import Key, Number, Numbers

PAPER_ROW = "in the paper"


@dataclass(frozen=True)
class Line:
    """A row before its numbers: labels, and the key of each cell. `bold` prints the whole row bold."""

    labels: tuple[str, ...]
    keys: tuple[Key, ...]
    section: str = ""
    strong: bool = False
    bold: bool = False


@dataclass(frozen=True)
class Layout:
    """A table before its numbers.

    `best_of` returns the group in which a cell competes for being the best, or None if it does not compete.
    `definitions` are notes on how we measure; the paper's own tables are printed without them.
    """

    label: str
    caption: str
    heads: tuple[str, ...]
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]
    best_of: Callable[[Key], Hashable] | None = None
    definitions: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def make_table(layout: Layout, numbers: Numbers, paper: Numbers | None = None) -> Table:
    """Return the table of `layout`.

    Parameters
    ----------
    layout : Layout
    numbers : Numbers
    paper : Numbers, optional
        The paper's numbers, set under each row that has one; they never compete for being the best.
    """
    ours = _rows(layout, layout.lines, numbers)
    if paper is None:
        return _finished(layout, ours, numbers)
    known = [line for line in layout.lines if any(paper.value(key) is not None for key in line.keys)]
    theirs = iter(_rows(layout, known, paper))
    rows: list[Row] = []
    for line, row in zip(layout.lines, ours, strict=True):
        rows.append(row)
        if line in known:
            rows.append(
                replace(next(theirs), labels=(*line.labels[:-1], PAPER_ROW), strong=False, paper=True)
            )
    return _finished(layout, rows, numbers)


def number_cell(metric: str, number: Number) -> Cell:
    """Return the cell of one number."""
    unit = SHOWN[metric].unit
    if number.value is None:
        return Cell(
            number.absent, None, metric, unit, reason=number.reason, notes=number.notes,
            present=number.present, expected=number.expected,
        )  # fmt: skip
    printed = text(metric, number.value)
    if number.present < number.expected:
        printed += f" ({number.present}/{number.expected})"
    value = printed_value(metric, number.value)
    return Cell(
        printed, value, metric, unit, notes=number.notes, present=number.present, expected=number.expected,
        interval=number.interval,
    )  # fmt: skip


def mark_best(cells: Sequence[Cell], groups: Sequence[Hashable], *, alone: bool) -> list[Cell]:
    """Return `cells` with the best of each group bold, and with it all that are printed alike.

    Parameters
    ----------
    cells : sequence of Cell
    groups : sequence of hashable
        The group of each cell; a cell of None does not compete.
    alone : bool
        Whether a value without a rival is the best.
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
            if _as_printed(cells[place]) == best:
                marked[place] = replace(cells[place], bold=True)
    return marked


def _as_printed(cell: Cell) -> float:
    assert isinstance(cell.value, float)
    return round(cell.value, SHOWN[cell.metric].decimals)


def _rows(layout: Layout, lines: Sequence[Line], numbers: Numbers) -> list[Row]:
    keys = [key for line in lines for key in line.keys]
    cells = [number_cell(key.metric, numbers.number(key)) for key in keys]
    if layout.best_of is not None:
        noted = [any(note.startswith(ON_CPU) for note in numbers.number(key).notes) for key in keys]
        groups = [None if cpu else layout.best_of(key) for key, cpu in zip(keys, noted, strict=True)]
        cells = mark_best(cells, groups, alone=numbers.of_paper)  # as the paper does
    rows, start = [], 0
    for line in lines:
        own = cells[start : start + len(line.keys)]
        start += len(line.keys)
        if line.bold:
            own = [replace(cell, bold=cell.value is not None) for cell in own]
        rows.append(Row(line.labels, tuple(own), line.section, line.strong))
    return rows


def _finished(layout: Layout, rows: Sequence[Row], numbers: Numbers) -> Table:
    notes = layout.notes if numbers.of_paper else (*layout.definitions, *layout.notes)
    table = Table(layout.label, layout.caption, layout.heads, layout.columns, tuple(rows), notes)
    return table.with_common_notes()

"""A table as data, which every writer writes and every page shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

from msb.bench.intervals import Interval
from msb.metrics.registry import IMAGE_METRICS

SCHEMA = "msb.table/1"
# N/A stands for an unsupported condition, -- for a metric that does not apply or was not reported.
NOT_SUPPORTED, NOT_THERE = "N/A", "--"


@dataclass(frozen=True)
class Cell:
    """One cell: `text` is what is printed without footnote marks, "22.51 (7/9)", "N/A", "--" or "yes".

    `value` is the unrounded value in `unit`, None for N/A and --, which `reason` explains. `metric` and
    `unit` are empty if it is no number, `bold` marks the best. A mean is over `present` of the `expected`
    scenes; `interval` is that of a mean over views or of a difference, in `unit`.
    """

    text: str
    value: float | bool | str | None = None
    metric: str = ""
    unit: str = ""
    bold: bool = False
    reason: str | None = None
    notes: tuple[str, ...] = ()
    present: int = 1
    expected: int = 1
    interval: Interval | None = None

    @property
    def footnotes(self) -> tuple[str, ...]:
        """The notes, the reason included."""
        return self.notes if self.reason is None else (self.reason, *self.notes)

    @property
    def number(self) -> float | None:
        """The value, if it is a number to sort by."""
        return self.value if isinstance(self.value, float) else None

    def to_dict(self) -> dict[str, Any]:
        """Return the cell as JSON data."""
        data: dict[str, Any] = {"text": self.text, "value": self.value, "bold": self.bold}
        if self.metric:
            data |= {"metric": self.metric, "unit": self.unit}
        if self.reason is not None:
            data["reason"] = self.reason
        if self.notes:
            data["notes"] = list(self.notes)
        if self.interval is not None:
            data |= self.interval.to_dict()
        if (self.present, self.expected) != (1, 1):
            data |= {"present": self.present, "expected": self.expected}
            data["partial"] = self.present < self.expected
        return data


@dataclass(frozen=True)
class Column:
    """One column of values. `groups` are headings that span it and its neighbours, outermost first.

    `of` are the fields that it gives to the keys of its numbers (`msb.report.layout`). By one that `filters`
    a page lets rows be chosen.
    """

    title: str
    groups: tuple[str, ...] = ()
    of: Mapping[str, str] = field(default_factory=dict, compare=False)
    filters: bool = False

    @property
    def name(self) -> str:
        """The title with the headings above it."""
        return " ".join((*self.groups, self.title))


@dataclass(frozen=True)
class Row:
    """One row: its labels under `Table.heads`, and a cell per column.

    `section` is a heading above it and its neighbours. `strong` marks means. `paper` marks the paper's own
    numbers, which stand under ours.
    """

    labels: tuple[str, ...]
    cells: tuple[Cell, ...]
    section: str = ""
    strong: bool = False
    paper: bool = False


@dataclass(frozen=True)
class Table:
    """A table. `label` names its files and anchors; `notes` hold for all of it."""

    label: str
    caption: str
    heads: tuple[str, ...]
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()

    @property
    def depth(self) -> int:
        """The number of lines of headings above the columns' own titles."""
        return max((len(column.groups) for column in self.columns), default=0)

    def spans(self, level: int) -> list[tuple[str, int]]:
        """Return the headings of one level, from left to right, each with the columns it spans."""
        # The same heading under another one above it is another heading.
        paths = (column.groups[: level + 1] if level < len(column.groups) else () for column in self.columns)
        return [(path[-1] if path else "", len(list(own))) for path, own in groupby(paths)]

    def blocks(self) -> list[tuple[str, list[Row]]]:
        """Return the rows in blocks, each with its heading: its section and all labels but the last."""

        def heading(row: Row) -> str:
            return ", ".join(filter(None, (row.section, *row.labels[:-1])))

        return [(name, list(rows)) for name, rows in groupby(self.rows, heading)]

    def sortable(self, column: int) -> bool:
        """Return whether a column can sort the rows of each block: it holds numbers of one metric there."""
        blocks = [[row.cells[column] for row in rows if not row.paper] for _, rows in self.blocks()]
        several = any(sum(cell.number is not None for cell in cells) > 1 for cells in blocks)
        return several and all(len({cell.metric for cell in cells}) <= 1 for cells in blocks)

    def footnotes(self) -> dict[str, str]:
        """Return footnote -> mark, "a" to "z", then "aa", in the order in which a reader meets them."""
        texts = dict.fromkeys(note for row in self.rows for cell in row.cells for note in cell.footnotes)
        return {note: _letters(number) for number, note in enumerate(texts)}

    def with_common_notes(self) -> Table:
        """Return the table with notes on all numbers of a metric moved from the cells to the table."""
        cells = [cell for row in self.rows for cell in row.cells if cell.value is not None and not row.paper]
        metrics = dict.fromkeys(cell.metric for cell in cells)
        common: dict[str, str] = {}
        for note in dict.fromkeys(note for cell in cells for note in cell.notes):
            having = dict.fromkeys(cell.metric for cell in cells if note in cell.notes)
            if all(note in cell.notes for cell in cells if cell.metric in having):
                names = ", ".join(IMAGE_METRICS[metric].title for metric in having if metric in IMAGE_METRICS)
                common[note] = note if len(having) == len(metrics) or not names else f"{names}: {note}"
        if not common:
            return self

        def lighter(cell: Cell) -> Cell:
            return replace(cell, notes=tuple(note for note in cell.notes if note not in common))

        rows = tuple(replace(row, cells=tuple(map(lighter, row.cells))) for row in self.rows)
        return replace(self, rows=rows, notes=(*self.notes, *common.values()))

    def without_paper(self) -> Table:
        """Return the table without the paper's rows."""
        return replace(self, rows=tuple(row for row in self.rows if not row.paper))

    def to_dict(self) -> dict[str, Any]:
        """Return the table as JSON data (schema msb.table/1), numbers as full doubles."""
        return {
            "schema": SCHEMA,
            "label": self.label,
            "caption": self.caption,
            "heads": list(self.heads),
            "columns": [{"title": column.title, "groups": list(column.groups)} for column in self.columns],
            "rows": [
                {
                    "labels": list(row.labels),
                    "section": row.section,
                    "source": "paper" if row.paper else "ours",
                    "cells": [cell.to_dict() for cell in row.cells],
                }
                for row in self.rows
            ],
            "notes": list(self.notes),
        }


def _letters(number: int) -> str:
    name = ""
    number += 1
    while number:
        number, rest = divmod(number - 1, 26)
        name = chr(ord("a") + rest) + name
    return name

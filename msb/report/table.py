"""Tables as data, independent of output formats."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

from msb.bench.intervals import Interval
from msb.metrics.registry import IMAGE_METRICS

SCHEMA = "msb.table/1"
# Texts of table cells without a value. The condition is not supported, or the value is missing or undefined.
NOT_SUPPORTED, NOT_AVAILABLE = "N/A", "--"
# Text of a table cell whose frame rate differs too much between timing rounds.
UNSTEADY = "unsteady"


@dataclass(frozen=True)
class TableCell:
    """One cell of a table.

    Attributes
    ----------
    text : str
        The printed text without footnote marks, such as "22.51 (7/9)", "N/A", "--" or "yes".
    value : float, bool, str or None
        The unrounded value in `unit`. The value is None for "N/A" and "--".
    metric, unit : str
        Metric and unit. Metric and unit are empty if the value is not a measurement.
    bold : bool
        Whether the value is printed bold. Usually, bold marks the best value of a group.
    reason : str or None
        Why the value is missing.
    notes : tuple of str
        Footnotes of this cell.
    present, expected : int
        The number of averaged scenes, and the number of all scenes.
    interval : Interval or None
        95 % confidence interval of a mean over views, or of a difference, in `unit`.
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
        """The notes of this table cell. If the value is missing, the first note is the reason."""
        return self.notes if self.reason is None else (self.reason, *self.notes)

    @property
    def number(self) -> float | None:
        """The value by which rows are sorted, or None."""
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
class TableColumn:
    """One column of values.

    Attributes
    ----------
    title : str
        The heading directly above the values.
    groups : tuple of str
        The headings above the title, starting with the top heading. Neighbouring columns with equal headings
        share one printed heading.
    of : mapping of str to str
        Fields that the column adds to the `Key` of each of its numbers.
    filters : bool
        Whether the page has a list that filters rows by this column.
    """

    title: str
    groups: tuple[str, ...] = ()
    of: Mapping[str, str] = field(default_factory=dict, compare=False)
    filters: bool = False

    @property
    def full_title(self) -> str:
        """The title, preceded by the headings above it."""
        return " ".join((*self.groups, self.title))


@dataclass(frozen=True)
class TableRow:
    """One row of a table.

    Attributes
    ----------
    labels : tuple of str
        One label for each entry of `Table.heads`.
    cells : tuple of TableCell
        One table cell for each column.
    section : str
        Heading above this row and above its neighbours.
    strong : bool
        Whether the row contains means.
    paper : bool
        Whether the row contains the paper's numbers. The paper's rows are printed below ours.
    """

    labels: tuple[str, ...]
    cells: tuple[TableCell, ...]
    section: str = ""
    strong: bool = False
    paper: bool = False


@dataclass(frozen=True)
class Table:
    """A table: `label` names its files and anchors, and `notes` apply to the whole table."""

    label: str
    caption: str
    heads: tuple[str, ...]
    columns: tuple[TableColumn, ...]
    rows: tuple[TableRow, ...]
    notes: tuple[str, ...] = ()

    @property
    def depth(self) -> int:
        """The number of heading lines above the column titles."""
        return max((len(column.groups) for column in self.columns), default=0)

    def spans(self, level: int) -> list[tuple[str, int]]:
        """Return the headings of one level from left to right.

        Each heading is returned with the number of columns below it.
        """
        # Do not merge equal headings if the headings above them differ.
        paths = (column.groups[: level + 1] if level < len(column.groups) else () for column in self.columns)
        return [(path[-1] if path else "", len(list(columns))) for path, columns in groupby(paths)]

    def blocks(self) -> list[tuple[str, list[TableRow]]]:
        """Return the rows in blocks with a common heading.

        The heading of a block consists of the section and all labels except the last label.
        """

        def heading(row: TableRow) -> str:
            return ", ".join(filter(None, (row.section, *row.labels[:-1])))

        return [(name, list(rows)) for name, rows in groupby(self.rows, heading)]

    def sortable(self, column: int) -> bool:
        """Return whether rows can be sorted by a column.

        In each block of rows, all cells of the column must belong to one metric.
        """
        blocks = [[row.cells[column] for row in rows if not row.paper] for _, rows in self.blocks()]
        several = any(sum(cell.number is not None for cell in cells) > 1 for cells in blocks)
        return several and all(len({cell.metric for cell in cells}) <= 1 for cells in blocks)

    def footnotes(self) -> dict[str, str]:
        """Return the mark of each footnote in reading order: "a" to "z", then "aa"."""
        texts = dict.fromkeys(note for row in self.rows for cell in row.cells for note in cell.footnotes)
        return {note: _letters(number) for number, note in enumerate(texts)}

    def with_common_notes(self) -> Table:
        """If all cells of a metric have the same note, move the note from the cells to the table."""
        cells = [cell for row in self.rows for cell in row.cells if cell.value is not None and not row.paper]
        metrics = dict.fromkeys(cell.metric for cell in cells)
        common: dict[str, str] = {}
        for note in dict.fromkeys(note for cell in cells for note in cell.notes):
            noted_metrics = dict.fromkeys(cell.metric for cell in cells if note in cell.notes)
            if all(note in cell.notes for cell in cells if cell.metric in noted_metrics):
                images = [metric for metric in noted_metrics if metric in IMAGE_METRICS]
                names = ", ".join(IMAGE_METRICS[metric].title for metric in images)
                is_clear = len(noted_metrics) == len(metrics) or not names or note.startswith(names)
                common[note] = note if is_clear else f"{names}: {note}"
        if not common:
            return self

        def without_common_notes(cell: TableCell) -> TableCell:
            return replace(cell, notes=tuple(note for note in cell.notes if note not in common))

        rows = tuple(replace(row, cells=tuple(map(without_common_notes, row.cells))) for row in self.rows)
        return replace(self, rows=rows, notes=(*self.notes, *common.values()))

    def without_paper(self) -> Table:
        """Return the table without the paper's rows."""
        return replace(self, rows=tuple(row for row in self.rows if not row.paper))

    def to_dict(self) -> dict[str, Any]:
        """Return the table as JSON data (schema msb.table/1) with unrounded numbers."""
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
    """Return the mark of the footnote with index `number`: "a" to "z", "aa", "ab", ..."""
    name = ""
    number += 1
    while number:
        number, rest = divmod(number - 1, 26)
        name = chr(ord("a") + rest) + name
    return name

"""The console for results: lines and cells end between words, also where a word is longer than they are."""

from __future__ import annotations

import re
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text


class WholeWordConsole(Console):
    """A console that breaks no word.

    A path that is longer than a line stands on a line of its own, which the terminal wraps, so that it can be
    copied. A table is as wide as its longest words need, and else no wider than the terminal.
    """

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as rich does, but without breaking words."""
        one = objects[0] if len(objects) == 1 else None
        whole = options.pop("soft_wrap", None)
        if isinstance(one, Table):
            before, self.width = self.width, max(self.width, _fit(one, self))
            super().print(one, **options)
            self.width = before
        elif isinstance(one, str) and not whole:
            text = self.render_str(one, markup=options.pop("markup", None))
            super().print(_broken(text, self.width), soft_wrap=True, **options)
        else:
            super().print(*objects, soft_wrap=whole, **options)


def _broken(text: Text, width: int) -> Text:
    """Return `text` with line ends between words, lines as long as `width` allows."""
    lines = []
    for line in text.split("\n", allow_blank=True):
        offsets, column = [], 0
        for word in re.finditer(r"\S+\s*", line.plain):
            if column and column + cell_len(word[0].rstrip()) > width:
                offsets.append(word.start())
                column = 0
            column += cell_len(word[0])
        parts = line.divide(offsets)
        for part in parts:
            part.rstrip()
        lines += list(parts)
    return Text("\n").join(lines)


def _fit(table: Table, console: Console) -> int:
    """Give every column a width and return that of the table.

    It is at least the column's longest word. What is left goes first to columns that want little more.
    """
    wide = console.options.update(width=10_000)
    ranges = []
    for column in table.columns:
        sizes = [Measurement.get(console, wide, cell) for cell in (column.header, *column.cells)]
        ranges.append((max(size.minimum for size in sizes), max(size.maximum for size in sizes)))
    gaps = table.padding[1] * (len(ranges) - 1)
    left = max(0, console.width - gaps - sum(least for least, _ in ranges))
    hungry = sorted(range(len(ranges)), key=lambda number: ranges[number][1] - ranges[number][0])
    for waiting, number in zip(range(len(hungry), 0, -1), hungry, strict=True):
        least, most = ranges[number]
        more = min(most - least, left // waiting)
        table.columns[number].width = least + more
        left -= more
    return gaps + sum(column.width or 0 for column in table.columns)

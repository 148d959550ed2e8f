"""Where text goes: results to standard output, notes and progress to standard error, files whole."""

from __future__ import annotations

import contextlib
import io
import json
import os
import sys
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

from msb.atomic import new_file
from msb.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from rich.console import Console
    from rich.table import Table

    from msb.asset.progress import Progress

STDOUT = "-"


@dataclass(frozen=True)
class Output:
    """What the user wants to see, and where.

    `json_file` "-" takes standard output for itself; the human text is then not printed at all.
    """

    json_file: Path | None = None
    quiet: bool = False
    verbose: int = 0
    force: bool = False

    @property
    def prints_text(self) -> bool:
        """Whether the human-readable result is wanted on standard output."""
        return str(self.json_file) != STDOUT

    def console(self) -> Console:
        """Return the console for results. Colour only on a terminal and without NO_COLOR."""
        from rich.console import Console

        return Console(highlight=False)

    def note(self, text: str, *, level: int = 0) -> None:
        """Print a note on standard error, if the user wants this much."""
        if not self.quiet and self.verbose >= level:
            print(text, file=sys.stderr)  # noqa: T201 - notes go here

    @contextlib.contextmanager
    def progress(self, text: str) -> Iterator[None]:
        """Show `text` with a spinner while the block runs, on a terminal only."""
        if self.quiet or not sys.stderr.isatty():
            yield
            return
        from rich.console import Console

        with Console(stderr=True).status(text):
            yield

    @contextlib.contextmanager
    def bars(self) -> Iterator[Progress | None]:
        """Yield a function that draws a bar in bytes for each stage, on a terminal only; else None."""
        if self.quiet or not sys.stderr.isatty():
            yield None
            return
        from rich.console import Console
        from rich.progress import BarColumn, DownloadColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TimeRemainingColumn())
        tasks: dict[str, Any] = {}
        with Bars(*columns, console=Console(stderr=True), transient=True) as bars:

            def update(stage: str, done: int, total: int) -> None:
                if stage not in tasks:
                    tasks[stage] = bars.add_task(stage, total=total)
                bars.update(tasks[stage], completed=done)

            yield update

    @contextlib.contextmanager
    def counted(self, text: str, total: int) -> Iterator[Callable[[], None]]:
        """Yield a function to call after each of `total` steps; it draws a bar, on a terminal only."""
        if self.quiet or not sys.stderr.isatty():
            yield lambda: None
            return
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bars

        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
            task = bars.add_task(text, total=total)
            yield lambda: bars.advance(task)

    def check_free(self, path: Path | None) -> None:
        """Refuse to overwrite `path` without --force.

        Raises
        ------
        UsageError
            `OUTPUT_EXISTS`.
        """
        if path is not None and str(path) != STDOUT and os.path.lexists(path) and not self.force:
            raise UsageError("OUTPUT_EXISTS", "it exists; --force replaces it", file=path)

    def write_json(self, data: Any) -> None:
        """Write `data` where --json points to, if it was given."""
        if self.json_file is None:
            return
        text = json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
        if self.prints_text:
            with new_file(self.json_file) as file:
                file.write(text.encode())
        else:
            sys.stdout.flush()
            sys.stdout.buffer.write(text.encode())


@contextlib.contextmanager
def csv_text(file: IO[bytes]) -> Iterator[io.TextIOWrapper]:
    """Yield a binary file as the text file the csv module wants; the file itself stays open."""
    text = io.TextIOWrapper(file, "utf-8", newline="", write_through=True)
    try:
        yield text
    finally:
        text.detach()


def plain_table(*headers: str, right: tuple[int, ...] = (), gap: int = 2) -> Table:
    """Return a table without a frame, `right` naming the right-aligned columns, `gap` blanks between them."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, gap, 0, 0), header_style="bold")
    for number, header in enumerate(headers):
        table.add_column(header, justify="right" if number in right else "left", overflow="fold")
    return table

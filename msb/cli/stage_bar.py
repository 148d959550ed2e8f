"""The bar of a long run: how far the stage is, how long it takes, and what is being computed."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Group

    from msb.bench.progress import Left, Stage
    from msb.cli.output import Output


@contextlib.contextmanager
def stage_bar(stage: Stage, output: Output) -> Iterator[None]:
    """Draw the state of `stage` while the block runs, on a terminal only."""
    if not output.shows_progress:
        yield
        return
    from rich.console import Console
    from rich.live import Live

    console = Console(stderr=True)
    with Live(get_renderable=lambda: stage_lines(stage), console=console, transient=True):
        yield


def stage_lines(stage: Stage) -> Group:
    """Return two lines: the stage, its bar and the time left; and the first task being computed."""
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    line = Table.grid(padding=(0, 1), expand=True)
    for ratio in (None, None, 1, None):
        line.add_column(no_wrap=True, ratio=ratio)
    bar = ProgressBar(total=len(stage.names), completed=stage.done)
    line.add_row(Text(stage.title), Text(f"{stage.done}/{len(stage.names)}"), bar, Text(_told(stage)))
    names = stage.now
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return Group(line, Text(f"  {names[0]}{more}" if names else "", no_wrap=True, overflow="ellipsis"))


def _told(stage: Stage) -> str:
    """Return the time left and what follows; without an estimate there is no number."""
    left = stage.left()
    told = [] if left is None else [_left(left)]
    told += [f"then {' and '.join(stage.then)}"] if stage.then else []
    return ", ".join(told)


def _left(left: Left) -> str:
    seconds = round(left.seconds)
    minutes = round(left.seconds / 60)
    if seconds < 90:
        text = f"{max(seconds, 1)} s"
    elif minutes < 90:
        text = f"{minutes} min"
    else:
        text = f"{minutes // 60} h {minutes % 60} min"
    return f"{'more than ' if left.at_least else ''}{text} left"

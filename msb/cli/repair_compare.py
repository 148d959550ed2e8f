"""`msb repair --compare`: the table of ways to repair an asset, and pictures of them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from msb.cli.output import Output, echo, plain_table

if TYPE_CHECKING:
    from rich.console import Console

    from msb.cli.camera_options import Views
    from msb.repair import Options
    from msb.trial.repairs import Look, Row
    from msb.trial.run import Trial

_NAMES = (
    *("Strategy", "Kept", "Added", "Cut", "Pieces", "Bound.", "Verdict"),
    *("Tasks", "Standard", "Dedicated", "MB", "Seconds"),
)
_WORDS = ("Strategy", "Verdict", "Tasks")
"""Columns that are aligned to the left."""
_LEAST_WANTED = ("MB", "Added", "Bound.", "Seconds", "Cut")
"""Columns that a terminal does without if it is not as wide as the table, the first one first."""
NO_TASK = "none"
"""What --task takes for no task at all."""


def compare_strategies(
    source: Path,
    folder: Path | None,
    options: Options,
    views: Views,
    tasks: Sequence[str],
    device: str | None,
    output: Output,
) -> None:
    """Print the table of `msb.trial.repairs`, and write its JSON and a picture of each strategy."""
    from msb.base.atomic import new_folder
    from msb.cli.inputs import open_asset
    from msb.errors import about
    from msb.trial.repairs import compare, document, strategies
    from msb.views import choose_views

    wanted = _tasks(tasks)
    output.check_free(folder, folder=True)
    with output.progress(f"reading {source.name}"):
        asset = open_asset(source, output)
    given = None if views.cameras is None else views.read(output)
    with about(source):
        seen = choose_views(asset, given, size=(960, 720), device=device).seeing(asset, device)
    which = seen.said if given is None else seen.said.replace("given", f"of {views.cameras}")
    with (
        output.counted("trying repairs", len(strategies(options)) + 1) as step,
        nullcontext() if folder is None else new_folder(folder) as keep,
    ):
        rows = compare(asset, seen, options, tasks=wanted, device=device, keep=keep, step=step)
    output.write_json(document(str(source), which, rows))
    if output.prints_text:
        _print(rows, which, output)


def _tasks(given: Sequence[str]) -> list[str]:
    from msb.trial.registry import chosen_tasks
    from msb.trial.repairs import TASKS

    if given == (NO_TASK,):
        return []
    return [task.name for task in chosen_tasks(given or TASKS)]


def _print(rows: list[Row], which: str, output: Output) -> None:
    console = output.console()
    if not console.is_terminal:
        console.width = 10_000  # no table is as wide
    print_table([_cells(row) for row in rows], console)
    if output.quiet:
        return
    stored = rows[0]
    if stored.before is not None and stored.before.corners_coincide is False:
        echo("No two corners coincide: it is no surface, and no repair makes it one.")
    for row in rows:
        if row.why is not None:
            echo(f"{row.strategy}: {row.why}")
    tried = [one.task for one in stored.tried if one.outcome != "not_run"]
    if tried:
        echo(f"Tasks: how many of {', '.join(tried)} work, with care or without; msb trial says why.")
    for one in stored.tried:
        if one.outcome == "not_run":
            echo(f"{one.task}: not run: {one.why}")
    looks = [(tier, look.why) for row in rows for tier, look in (row.looks or {}).items() if look.why]
    for tier, why in dict.fromkeys(looks):
        echo(f"{tier.capitalize()}: not drawn: {why}")
    if any(look.same or look.psnr is not None for look in (stored.looks or {}).values()):
        echo(f"PSNR in dB against the asset as stored, the mean over {which}.")


def _cells(row: Row) -> list[str]:
    from msb.topology.shown import structure_text
    from msb.topology.verdict import judge

    if row.before is None or row.after is None or row.looks is None:
        return [row.strategy, *[""] * (_NAMES.index("Verdict") - 1), "not done"]
    ratio = row.after.metrics.boundary_edge_ratio
    return [
        row.strategy,
        f"{100 * row.faces_kept / max(row.before.counts.faces, 1):.1f} %",
        f"{row.faces_added:,}",
        f"{row.edges_cut:,}",
        f"{row.after.counts.components:,}",
        "-" if ratio is None else structure_text("boundary_edge_ratio", ratio),
        judge(row.after).word,
        _passed_text(row.tried),
        *(_look_text(look) for look in row.looks.values()),
        f"{row.size / 1e6:.2f}",
        f"{row.seconds:.1f}",
    ]


def print_table(rows: list[list[str]], console: Console) -> None:
    """Print as much of the table as the terminal is wide; what says nothing is left out first."""
    full = [[*row, *[""] * (len(_NAMES) - len(row))] for row in rows]
    silent = [name for name, *cells in zip(_NAMES, *full, strict=True) if not {*cells} - {"", "-"}]
    boundless = console.options.update(width=10_000)
    order = [*silent, *(name for name in _LEAST_WANTED if name not in silent)]
    for count in range(len(order) + 1):
        names = [name for name in _NAMES if name not in order[:count]]
        table = plain_table(*names, right=tuple(i for i, name in enumerate(names) if name not in _WORDS))
        for row in full:
            table.add_row(*(cell for name, cell in zip(_NAMES, row, strict=True) if name in names))
        if console.measure(table, options=boundless).maximum <= console.width:
            break
    console.print(table)
    if lost := order[len(silent) : count]:
        console.print(f"[dim]A wider terminal and --json also show: {', '.join(lost)}[/dim]")


def _passed_text(trials: tuple[Trial, ...]) -> str:
    from msb.trial.repairs import passed

    done = [one for one in trials if one.outcome != "not_run"]
    return f"{passed(done)} of {len(done)}" if done else "-"


def _look_text(look: Look) -> str:
    if look.same:
        return "same"
    return "-" if look.psnr is None else f"{look.psnr:.1f}"

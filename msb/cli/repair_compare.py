"""`msb repair --compare`: the table of ways to repair an asset, and pictures of them."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

from msb.cli.output import Output, plain_table

if TYPE_CHECKING:
    from rich.console import Console

    from msb.repair.plan import Options
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
    plan: tuple[str, ...] | None,
    options: Options,
    cameras: str | None,
    tasks: list[str] | None,
    device: str | None,
    output: Output,
) -> None:
    """Print the table of `msb.trial.repairs`, and write its JSON and a picture of each strategy."""
    from msb.base.atomic import new_folder
    from msb.cli.inputs import open_asset
    from msb.errors import about
    from msb.scenes import read_cameras
    from msb.trial.repairs import STRATEGIES, compare, document
    from msb.views import choose_views

    wanted = _tasks(tasks)
    output.check_free(folder, folder=True)
    output.check_outputs()
    with output.progress(f"reading {source.name}"):
        asset = open_asset(source, output)
    given = None if cameras is None else read_cameras(cameras)
    with about(source):
        views = choose_views(asset, given, size=(960, 720), device=device).seeing(asset, device)
    which = views.said if cameras is None else views.said.replace("given", f"of {cameras}")
    total = len(STRATEGIES) + 1 + (plan is not None and ",".join(plan) not in STRATEGIES)
    with (
        output.counted("trying repairs", total) as step,
        nullcontext() if folder is None else new_folder(folder) as keep,
    ):
        rows = compare(asset, views, options, plan=plan, tasks=wanted, device=device, keep=keep, step=step)
    output.write_json(document(str(source), which, rows))
    if output.prints_text:
        _print(rows, which, output)


def _tasks(given: list[str] | None) -> list[str]:
    from msb.trial.registry import chosen_tasks
    from msb.trial.repairs import TASKS

    if given == [NO_TASK]:
        return []
    return [task.name for task in chosen_tasks(given or TASKS)]


def _print(rows: list[Row], which: str, output: Output) -> None:
    from rich.markup import escape

    from msb.topology.shown import structure_text
    from msb.topology.verdict import judge

    console = output.console()
    if not console.is_terminal:
        console.width = 10_000  # no table is as wide
    cells = []
    for row in rows:
        if row.before is None or row.after is None or row.looks is None:
            cells.append([row.strategy, *[""] * (_NAMES.index("Verdict") - 1), "not done"])
            continue
        ratio = row.after.metrics.boundary_edge_ratio
        cells.append(
            [
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
        )
    print_table(cells, console)
    if output.quiet:
        return
    if rows[0].before is not None and rows[0].before.corners_coincide is False:
        console.print(
            "No two corners coincide: it is no surface, and no repair makes it one.", soft_wrap=True
        )
    for row in rows:
        if row.why is not None:
            console.print(escape(f"{row.strategy}: {row.why}"), soft_wrap=True)
    tried = [one.task for one in rows[0].tried if one.outcome != "not_run"]
    if tried:
        text = f"Tasks: how many of {', '.join(tried)} work, with care or without; msb trial says why."
        console.print(text, soft_wrap=True)
    for one in rows[0].tried:
        if one.outcome == "not_run":
            console.print(escape(f"{one.task}: not run: {one.why}"), soft_wrap=True)
    looks = [(tier, look.why) for row in rows for tier, look in (row.looks or {}).items() if look.why]
    for tier, why in dict.fromkeys(looks):
        console.print(escape(f"{tier.capitalize()}: not drawn: {why}"), soft_wrap=True)
    if any(look.same or look.psnr is not None for look in (rows[0].looks or {}).values()):
        text = f"PSNR in dB against the asset as stored, the mean over {escape(which)}."
        console.print(text, soft_wrap=True)


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

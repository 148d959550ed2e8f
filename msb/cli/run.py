"""`msb run`: a protocol of methods, scenes and conditions, evaluated; or one asset on one scene."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from msb.base.paths import shell_word
from msb.cli.options import DeviceName, JsonFile, Quiet, Verbose, alone, epilog
from msb.cli.output import Output, echo, plain_table, say
from msb.cli.scene_options import ImageFolder
from msb.cli.stage_bar import stage_bar
from msb.errors import UsageError

if TYPE_CHECKING:
    from msb.bench.progress import Stage
    from msb.bench.protocol import ProtocolFile
    from msb.bench.records import Reason
    from msb.bench.run import Report, Row

EPILOG = epilog(
    "msb run --example paper",
    "msb run --dry-run data_stubs/protocol.toml",
    "msb run -o out/run --only two_dts/nerf_synthetic data_stubs/protocol.toml",
    "msb run --scene data_stubs/scenes/nerf_synthetic/pebble -o out/one \\\n"
    "      data_stubs/models/pebble/two_dts",
)
SCHEMA = "msb.run/1"


def run(
    context: typer.Context,
    path: Annotated[
        Path | None, typer.Argument(metavar="PROTOCOL", help="A protocol.toml; or an asset, with --scene.")
    ] = None,
    scene: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Evaluate the asset PROTOCOL on this scene.")
    ] = None,
    non_engine: Annotated[
        str | None,
        typer.Option(
            metavar="DIR|reference", help="With --scene: official renderings, or our NumPy renderer."
        ),
    ] = None,
    image_folder: ImageFolder = None,
    device: DeviceName = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="DIR", help="Results folder, instead of the protocol's."),
    ] = None,
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=1, max=1024, metavar="N", help="Processes on this machine.")
    ] = 1,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Use the workers of this Dask scheduler instead."),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="WORD[/WORD]",
            help="Only cells whose dataset, scene, method or condition match. May be given again.",
        ),
    ] = None,
    redo: Annotated[bool, typer.Option("--redo", help="Compute finished cells again.")] = False,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", "-n", help="Only show what is done, what is not, and all that is missing for it."
        ),
    ] = False,
    example: Annotated[
        Literal["paper", "demo"] | None,
        typer.Option(
            help="Print a protocol to begin with, and nothing else: the paper's, or that of msb demo-data."
        ),
    ] = None,
    json_file: JsonFile = None,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Evaluate methods on scenes in all conditions: images, gaps, speed, memory, audit.

    Every cell (dataset, scene, method, condition) is one record. A finished cell is not computed again, so
    the command can be started again after an interruption or when models were added. A failed cell does not
    stop the others; the exit status is the highest of theirs. msb report makes the tables.
    """
    if example is not None:
        alone(context, "example")
        _print_example(example)
        return
    if path is None:
        context.fail("Missing argument 'PROTOCOL'; --example paper prints one to begin with")
    from msb.bench.run import run_protocol

    output = Output(json_file, quiet, verbose, force=True)
    output.check_outputs()
    file = _protocol(path, scene, non_engine, image_folder)
    # A default that a file sets counts less than what the protocol says.
    default = getattr(context.get_parameter_source("device"), "name", "") == "DEFAULT_MAP"
    if device is not None and not (default and file.protocol.device):
        file = replace(file, protocol=file.protocol.model_copy(update={"device": device}))
    if out is not None:
        file = replace(file, results_instead=out)
    watch = _Watch(output)
    try:
        found = run_protocol(
            file, jobs=jobs, scheduler=scheduler, only=only or (), redo=redo, dry=dry_run, watch=watch
        )
    except KeyboardInterrupt:
        if not dry_run:
            output.note(f"interrupted: {watch.cells} cells were done now; the same command goes on")
        raise
    output.write_json(_document(file, found))
    for name, reason in found.models.items():
        say(f"{reason.code}: {name}: {reason.message}")
    for reason, names in _failures(found, dry=dry_run).items():
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        say(f"{reason.code}: {names[0]}{more}: {reason.message}")
    if output.prints_text:
        _print(file, found, output, dry=dry_run)
    qualities = [row.result.quality for row in found.rows if row.result is not None and row.result.quality]
    for text in dict.fromkeys(text for quality in qualities for text in quality.missing.values()):
        output.note(f"warning: {text}; it has no mean where it failed")
    for missing in found.missing:
        say(f"{missing.code}: {missing.message}")
    raise typer.Exit(found.exit_status)


def _failures(found: Report, *, dry: bool) -> dict[Reason, list[str]]:
    """Return every reason for which something is not there -> the cells, or their parts, that it costs."""
    failures: dict[Reason, list[str]] = {}
    for row in found.rows:
        if dry and row.planned.status == "failed":  # said once for all cells, after the table
            continue
        for part, reason in row.reasons.items():
            if not reason.code.startswith("UNSUPPORTED_"):
                what = _name(row) if part == "cell" else f"{_name(row)}, {part}"
                failures.setdefault(reason, []).append(what)
    return failures


def _print_example(name: str) -> None:
    from msb.bench.protocol import example

    echo(example(name).decode().removesuffix("\n"))


def _protocol(
    path: Path, scene: Path | None, non_engine: str | None, image_folder: str | None
) -> ProtocolFile:
    from msb.bench.protocol import read_protocol, single_protocol

    only_with_scene = {"--non-engine": non_engine, "--image-folder": image_folder}
    if scene is not None:
        file = single_protocol(path, scene, non_engine=non_engine, image_folder=image_folder)
    elif given := [option for option, value in only_with_scene.items() if value is not None]:
        raise UsageError("USAGE", f"{given[0]} goes with --scene; a protocol has a key of that name")
    elif path.suffix.lower() != ".toml" and path.exists():
        text = f'"{path.name}" is no .toml; to evaluate an asset, say on which scene: --scene DIR'
        raise UsageError("USAGE", text)
    else:
        file = read_protocol(path)
    return file


class _Watch:
    """A bar for each stage on a terminal; a line for each task with -v."""

    def __init__(self, output: Output) -> None:
        self.output = output
        self.cells = 0

    @contextlib.contextmanager
    def stage(self, stage: Stage) -> Iterator[Callable[[str], None]]:
        with stage_bar(stage, self.output):

            def step(name: str) -> None:
                self.cells += stage.title == "cells"
                self.output.note(f"{stage.title}: {name}", level=1)

            yield step

    def note(self, text: str) -> None:
        self.output.note(text)


def _name(row: Row) -> str:
    return " ".join(row.planned.cell.names)


def _numbers(row: Row) -> dict[str, float | None]:
    from msb.bench.aggregate import METRICS
    from msb.metrics import IMAGE_METRICS

    result = row.result
    return {name: None if result is None else METRICS[name].get(result) for name in (*IMAGE_METRICS, "fps")}


def _document(file: ProtocolFile, found: Report) -> dict[str, Any]:
    rows = [
        {
            **row.planned.cell.model_dump(),
            "plan": row.planned.status,
            "parts": dict(row.planned.why),
            "status": None if row.result is None else row.result.status,
            "reasons": {part: reason.model_dump() for part, reason in row.reasons.items()},
            "seconds": row.seconds,
            **_numbers(row),
        }
        for row in found.rows
    ]
    return {
        "schema": SCHEMA,
        "protocol": str(file.path),
        "results": str(file.results),
        "seconds": found.seconds,
        "missing": [vars(one) for one in found.missing],
        "models": {name: reason.model_dump() for name, reason in found.models.items()},
        "cells": rows,
    }


def _print(file: ProtocolFile, found: Report, output: Output, *, dry: bool) -> None:
    from rich.markup import escape

    from msb.metrics import IMAGE_METRICS

    headers = (*(metric.title for metric in IMAGE_METRICS.values()), "FPS")
    decimals = {**{key: metric.decimals for key, metric in IMAGE_METRICS.items()}, "fps": 0}
    console = output.console()
    states = [_state(row, dry=dry) for row in found.rows]
    for dataset, group in groupby(
        zip(found.rows, states, strict=True), lambda one: one[0].planned.cell.dataset
    ):
        if output.quiet:
            break
        right = tuple(range(2, 2 + len(headers)))
        table = plain_table("Scene, method", "Condition", *headers, "", right=right)
        for column in table.columns[:-1]:
            column.no_wrap = True
        # A scene has a line of its own: beside its methods a long name would break the lines of a terminal.
        for scene, own in groupby(group, lambda one: one[0].planned.cell.scene):
            table.add_row(escape(scene))
            for row, state in own:
                _, _, method, condition = row.planned.cell.names
                cells = [_cell(value, decimals[name]) for name, value in _numbers(row).items()]
                table.add_row(f"  {escape(method)}", escape(condition), *cells, escape(state))
        console.print(f"[bold]{escape(dataset)}[/bold]")
        console.print(table)
        console.print()
    kinds = [state.partition(":")[0] for state in states]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)) or "none"
    console.print(f"{len(kinds)} cells: {counts}; {found.seconds:.0f} s", soft_wrap=True)
    console.print(escape(str(file.results)), soft_wrap=True)
    if not dry and not output.quiet:
        console.print(escape(f"next: msb report {shell_word(file.results)}"), soft_wrap=True)


def _cell(value: float | None, decimals: int) -> str:
    return "--" if value is None else f"{value:.{decimals}f}"


def _state(row: Row, *, dry: bool) -> str:
    """Return in a word or two what became of a cell, or would become of it if the run is dry."""
    planned = row.planned
    if planned.status == "unsupported":
        return "N/A"
    failed = row.reasons.get("cell") or planned.reason
    if failed is not None and not (dry and planned.status == "pending"):
        return "blocked" if dry else f"failed: {failed.code}"  # by what is said below, once for all
    if planned.status == "done":
        return "as before"
    why = dict.fromkeys(planned.why.values())
    told = "" if list(why) == ["new"] else f": {'; '.join(why)}"
    return f"{'to do' if dry else 'done now'}{told}"

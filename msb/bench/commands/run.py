"""`msb run`: evaluate the methods, scenes and conditions of a protocol, or one asset on one scene."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from msb.base.atomic import is_stream
from msb.base.option import Argument, Option
from msb.base.paths import shell_word
from msb.cli.command import Typed, command, require
from msb.cli.output import Output, echo, say
from msb.cli.progress import format_duration
from msb.errors import UsageError
from msb.render.options import SCENE_OPTIONS, RendererOptions, SceneOptions

if TYPE_CHECKING:
    from rich.console import Group

    from msb.bench.progress import RemainingTime, Stage
    from msb.bench.protocol import ProtocolFile
    from msb.bench.records import Reason
    from msb.bench.run import CellOutcome, Report

_SCHEMA = "msb.run/1"
# The first bytes of every JSON file written by msb run.
_START = re.compile(rb'\s*\{\s*"schema"\s*:\s*"%s"' % re.escape(_SCHEMA).encode())


@dataclass(frozen=True)
class RunOptions:
    """Options for the protocol, the benchmark cells to evaluate, the results folder and the workers."""

    scene: Annotated[
        Path | None, Option("Evaluate a single asset, given as PROTOCOL, on this scene.", metavar="DIR")
    ] = None
    non_engine: Annotated[
        Path | None,
        Option(
            "Renderings to compare with --scene: a folder of official renderings, or our reference renderer.",
            metavar="DIR|reference",
        ),
    ] = None
    out: Annotated[
        Path | None,
        Option(
            "Write results to DIR instead of the protocol's folder.",
            ("--out", "-o"),
            metavar="DIR",
            output="folder",
        ),
    ] = None
    jobs: Annotated[
        int, Option("Use N processes on this machine.", ("--jobs", "-j"), metavar="N", least=1, most=1024)
    ] = 1
    scheduler: Annotated[
        str | None,
        Option("Use the workers of this Dask scheduler instead.", metavar="tcp://HOST:PORT"),
    ] = None
    only: Annotated[
        tuple[str, ...],
        Option(
            "Evaluate only benchmark cells whose dataset, scene, method or condition is WORD. Repeatable.",
            metavar="WORD[/WORD]",
        ),
    ] = ()
    redo: Annotated[bool, Option("Compute finished cells again.")] = False
    dry_run: Annotated[
        bool,
        Option(
            "Show finished and pending benchmark cells and missing inputs without running anything.",
            ("--dry-run", "-n"),
        ),
    ] = False
    example: Annotated[
        Literal["paper", "demo"] | None,
        Option("Print an example protocol and exit: for the paper, or for msb demo-data."),
    ] = None

    def read_protocol(self, path: Path, reading: SceneOptions) -> ProtocolFile:
        """Return the protocol at `path`.

        With --scene, return a protocol for the asset at `path` on that scene.
        """
        from msb.bench.protocol import make_single_protocol, read_protocol

        if self.scene is not None:
            non_engine = None if self.non_engine is None else str(self.non_engine)
            file = make_single_protocol(path, self.scene, non_engine=non_engine, **reading.given)
        elif path.suffix.lower() != ".toml" and path.exists():
            text = f'"{path.name}" is not a .toml file; pass --scene DIR to evaluate an asset on a scene'
            raise UsageError("USAGE", text)
        else:
            file = read_protocol(path)
        return file if self.out is None else replace(file, results_instead=self.out)


@dataclass(frozen=True)
class RunOutput(Output):
    """An output option.

    If --force is not given, the command replaces no file except the JSON file of an earlier run.
    """

    _remedy: ClassVar[str] = "msb run replaces only JSON files of earlier runs; use another file name"

    def may_replace(self, path: Path) -> bool:
        """Return whether the file at `path` is the JSON of a run."""
        if is_stream(path):  # do not open a pipe, because opening waits until another program writes
            return True
        try:
            with path.open("rb") as file:
                return _START.match(file.read(100)) is not None
        except OSError:  # the file disappeared or cannot be read
            return False


@command(
    "msb run --example paper",
    "msb run --dry-run data_stubs/protocol.toml",
    "msb run -o out/run --only two_dts/nerf_synthetic data_stubs/protocol.toml",
    "msb run --scene data_stubs/scenes/nerf_synthetic/pebble -o out/one \\\n"
    "      data_stubs/models/pebble/two_dts",
)
def run(
    path: Annotated[
        Path | None, Argument("A protocol (.toml), or with --scene an asset.", metavar="PROTOCOL")
    ] = None,
    *,
    options: RunOptions,
    reading: SceneOptions,
    drawing: Annotated[RendererOptions, ("device",)],
    output: Annotated[RunOutput, ("json_file", "quiet", "verbose")],
    typed: Typed,
) -> int:
    """Evaluate methods on scenes under all conditions: image quality, gaps, speed, memory and audits.

    Each benchmark cell (dataset, scene, method, condition) has one record. Finished benchmark cells are not
    computed again. Start the same command again to continue after an interruption, or to evaluate added
    models. A failed benchmark cell does not stop other cells. The exit status is the highest status of all
    failures. msb report writes tables.
    """
    if options.example is not None:
        others = typed.keys() - {"example", "quiet", "verbose", "color", "log_file", "debug"}
        typed.reject(others, "cannot be combined with --example")
    require(path or options.example, "Missing PROTOCOL. Print an example with: msb run --example paper")
    if options.scene is None:
        keys = ["non_engine", *(name for name in SCENE_OPTIONS if name != "dataset")]
        typed.reject(keys, "applies to --scene only; for a protocol, set the key with this name in the file")
        typed.reject(["dataset"], "applies to --scene only; the protocol names the datasets")
    if options.example is not None:
        from msb.bench.protocol import read_example

        echo(read_example(options.example).decode().removesuffix("\n"))
        return 0
    assert path is not None
    from msb.bench.models import detect_method
    from msb.bench.run import run_protocol

    file = options.read_protocol(path, reading)
    if drawing.device is not None:
        file = replace(file, protocol=file.protocol.model_copy(update={"device": drawing.device}))
    dry = options.dry_run
    if options.scene is not None and not dry:
        detect_method(path)  # an invalid model raises its error here, before results are changed
    watch = _ProgressDisplay(output)
    try:
        report = run_protocol(
            file,
            jobs=options.jobs,
            scheduler=options.scheduler,
            only=options.only,
            redo=options.redo,
            dry=dry,
            watch=watch,
        )
    except KeyboardInterrupt:
        if not dry:
            count = "1 cell" if watch.cells == 1 else f"{watch.cells} cells"
            output.note(f"interrupted after {count}; start the same command again to continue")
        raise
    output.write_json(_make_document(file, report))
    for name, reason in report.models.items():
        where = "" if reason.message.startswith(name) else f"{name}: "
        say(f"{reason.code}: {where}{reason.message}")
    for reason, names in _group_failures(report, dry=dry).items():
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        say(f"{reason.code}: {names[0]}{more}: {reason.message}")
    if output.prints_text:
        _print(file, report, output, dry=dry)
    qualities = [row.result.quality for row in report.rows if row.result is not None and row.result.quality]
    for text in dict.fromkeys(text for quality in qualities for text in quality.missing.values()):
        output.note(f"warning: {text}; cells with this failure have no average of the metric")
    for missing in report.missing:
        say(f"{missing.code}: {missing.message}")
    return report.exit_status


def _group_failures(report: Report, *, dry: bool) -> dict[Reason, list[str]]:
    """Group the failed benchmark cells and the failed parts of cells by the reason of the failure."""
    failures: dict[Reason, list[str]] = {}
    for row in report.rows:
        if dry and row.planned.status == "failed":  # these inputs are already in the list of missing inputs
            continue
        for part, reason in row.reasons.items():
            if not reason.code.startswith("UNSUPPORTED_"):
                name = _format_name(row) if part == "cell" else f"{_format_name(row)}, {part}"
                failures.setdefault(reason, []).append(name)
    return failures


class _ProgressDisplay:
    """Shows the progress of each stage: a bar on a terminal, lines elsewhere, and with -v all tasks."""

    def __init__(self, output: Output) -> None:
        self.output = output
        self.cells = 0

    @contextlib.contextmanager
    def stage(self, stage: Stage) -> Iterator[Callable[[str], None]]:
        with show_stage(stage, self.output):

            def step(name: str) -> None:
                self.cells += stage.title == "cells"
                self.output.note(f"{stage.title}: {name}", level=1)
                if self.output.progress_lines is not None:
                    text = f"{stage.title} {stage.done}/{len(stage.names)}, finished {name}"
                    self.output.progress_lines.write_first(text)

            yield step

    def note(self, text: str) -> None:
        self.output.note(text)


def _format_name(row: CellOutcome) -> str:
    return " ".join(row.planned.cell.names)


def _is_unsteady(row: CellOutcome) -> bool:
    from msb.bench.aggregate import why_unsteady

    return row.result is not None and why_unsteady(row.result) is not None


def _get_numbers(row: CellOutcome) -> dict[str, float | None]:
    """Return the image metrics and the frame rate of a benchmark cell."""
    from msb.bench.aggregate import METRICS
    from msb.metrics import IMAGE_METRICS

    result = row.result
    return {name: None if result is None else METRICS[name].get(result) for name in (*IMAGE_METRICS, "fps")}


def _make_document(file: ProtocolFile, report: Report) -> dict[str, Any]:
    """Return the JSON document of a run."""
    rows = [
        {
            **row.planned.cell.model_dump(),
            "plan": row.planned.status,
            "parts": dict(row.planned.why),
            "status": None if row.result is None else row.result.status,
            "reasons": {part: reason.model_dump() for part, reason in row.reasons.items()},
            "seconds": row.seconds,
            **_get_numbers(row),
            "fps_unsteady": _is_unsteady(row),
        }
        for row in report.rows
    ]
    return {
        "schema": _SCHEMA,
        "protocol": str(file.path),
        "results": str(file.results),
        "seconds": report.seconds,
        "missing": [vars(missing) for missing in report.missing],
        "models": {name: reason.model_dump() for name, reason in report.models.items()},
        "cells": rows,
    }


def _print(file: ProtocolFile, report: Report, output: Output, *, dry: bool) -> None:
    """Print a table for each dataset, the number of benchmark cells in each state, and the results folder."""
    from msb.metrics import IMAGE_METRICS

    headers = [metric.title for metric in IMAGE_METRICS.values()] + ["FPS"]
    states = [_describe_state(row, dry=dry) for row in report.rows]
    rows = zip(report.rows, states, strict=True)
    for dataset, group in groupby(rows, lambda pair: pair[0].planned.cell.dataset):
        if output.quiet:
            break
        cells: list[tuple[str, ...]] = []
        # The scene is printed on a separate line, because a column for long names would not fit into a
        # terminal.
        for scene, members in groupby(group, lambda pair: pair[0].planned.cell.scene):
            cells.append((scene, *[""] * (len(headers) + 2)))
            cells += [(*_format_row(row), state) for row, state in members]
        output.line((dataset, "bold"))
        columns = ("Scene, method", "Condition", *headers)
        output.table((*columns, ""), cells, right=range(2, len(columns)), unbroken=range(len(columns)))
        echo()
    kinds = [state.partition(":")[0] for state in states]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)) or "none"
    echo(f"{len(kinds)} cells: {counts}; {report.seconds:.0f} s")
    echo(str(file.results))
    if not dry and not output.quiet:
        echo(f"next: msb report {shell_word(file.results)}")


def _format_row(row: CellOutcome) -> list[str]:
    """Return method, condition and numbers as one line of the table."""
    from msb.metrics import IMAGE_METRICS

    decimals = {**{key: metric.decimals for key, metric in IMAGE_METRICS.items()}, "fps": 0}
    numbers = {
        key: "--" if value is None else f"{value:.{decimals[key]}f}"
        for key, value in _get_numbers(row).items()
    }
    if _is_unsteady(row):
        numbers["fps"] = "unsteady"
    _, _, method, condition = row.planned.cell.names
    return [f"  {method}", condition, *numbers.values()]


def _describe_state(row: CellOutcome, *, dry: bool) -> str:
    """Return the state of a benchmark cell in the table, such as "computed" or, in a dry run, "pending"."""
    planned = row.planned
    if planned.status == "unsupported":
        return "N/A"
    failed = row.reasons.get("cell") or planned.reason
    if failed is not None and not (dry and planned.status == "pending"):
        return "blocked" if dry else f"failed: {failed.code}"  # the list of missing inputs gives the reason
    if planned.status == "done":
        return "unchanged"
    why = dict.fromkeys(planned.why.values())
    reasons = "" if list(why) == ["new"] else f": {'; '.join(why)}"
    return f"{'pending' if dry else 'computed'}{reasons}"


@contextlib.contextmanager
def show_stage(stage: Stage, output: Output) -> Iterator[None]:
    """Show the progress of `stage` during the block, as a bar on a terminal and as lines elsewhere."""
    if not output.shows_progress:
        lines = output.progress_lines
        with contextlib.nullcontext() if lines is None else lines.watch(lambda: _describe_stage(stage)):
            yield
        return
    from rich.console import Console
    from rich.live import Live

    console = Console(stderr=True)
    with Live(get_renderable=lambda: draw_stage(stage), console=console, transient=True):
        yield


def _describe_stage(stage: Stage) -> str:
    """Return one line: the stage, its finished tasks, the current task and the remaining time."""
    parts = [f"{stage.title} {stage.done}/{len(stage.names)}", *_name_current(stage), _describe_rest(stage)]
    return ", ".join(filter(None, parts))


def _name_current(stage: Stage) -> list[str]:
    """Return the first current task and the number of other current tasks as text.

    Without a task, return "".
    """
    names = stage.current
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return [f"{names[0]}{more}"] if names else []


def draw_stage(stage: Stage) -> Group:
    """Return two lines: the stage with its bar and remaining time, and its first current task."""
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table
    from rich.text import Text

    line = Table.grid(padding=(0, 1), expand=True)
    for ratio in (None, None, 1, None):
        line.add_column(no_wrap=True, ratio=ratio)
    bar = ProgressBar(total=len(stage.names), completed=stage.done)
    line.add_row(
        Text(stage.title), Text(f"{stage.done}/{len(stage.names)}"), bar, Text(_describe_rest(stage))
    )
    current = "".join(f"  {name}" for name in _name_current(stage))
    return Group(line, Text(current, no_wrap=True, overflow="ellipsis"))


def _describe_rest(stage: Stage) -> str:
    """Return the estimated remaining time and the names of the following stages as text."""
    left = stage.estimate_rest()
    parts = [] if left is None else [_format_time(left)]
    parts += [f"then {' and '.join(stage.then)}"] if stage.then else []
    return ", ".join(parts)


def _format_time(left: RemainingTime) -> str:
    """Return an estimated time as text in seconds, minutes or hours."""
    return f"{'more than ' if left.at_least else ''}{format_duration(left.seconds)} left"

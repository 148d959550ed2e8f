"""`msb run`: a protocol of methods, scenes and conditions, evaluated; or one asset on one scene."""

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
from msb.errors import UsageError
from msb.render.options import Drawing, ImageFolder

if TYPE_CHECKING:
    from rich.console import Group

    from msb.bench.progress import Left, Stage
    from msb.bench.protocol import ProtocolFile
    from msb.bench.records import Reason
    from msb.bench.run import Report, Row

_SCHEMA = "msb.run/1"
# How the JSON of every run begins.
_START = re.compile(rb'\s*\{\s*"schema"\s*:\s*"%s"' % re.escape(_SCHEMA).encode())


@dataclass(frozen=True)
class RunOptions:
    """What is evaluated, where its results go, and by whom it is computed."""

    scene: Annotated[Path | None, Option("Evaluate the asset PROTOCOL on this scene.", metavar="DIR")] = None
    non_engine: Annotated[
        Path | None,
        Option("With --scene: official renderings, or our NumPy renderer.", metavar="DIR|reference"),
    ] = None
    image_folder: ImageFolder = None
    out: Annotated[
        Path | None,
        Option("Results folder, instead of the protocol's.", ("--out", "-o"), metavar="DIR", output="folder"),
    ] = None
    jobs: Annotated[
        int, Option("Processes on this machine.", ("--jobs", "-j"), metavar="N", least=1, most=1024)
    ] = 1
    scheduler: Annotated[
        str | None,
        Option("Use the workers of this Dask scheduler instead.", metavar="tcp://HOST:PORT"),
    ] = None
    only: Annotated[
        tuple[str, ...],
        Option(
            "Only cells whose dataset, scene, method or condition match. May be given again.",
            metavar="WORD[/WORD]",
        ),
    ] = ()
    redo: Annotated[bool, Option("Compute finished cells again.")] = False
    dry_run: Annotated[
        bool,
        Option("Only show what is done, what is not, and all that is missing for it.", ("--dry-run", "-n")),
    ] = False
    example: Annotated[
        Literal["paper", "demo"] | None,
        Option("Print a protocol to begin with, and nothing else: the paper's, or that of msb demo-data."),
    ] = None

    def protocol(self, path: Path) -> ProtocolFile:
        """Return the protocol at `path`, or the one that evaluates the asset there on the scene."""
        from msb.bench.protocol import read_protocol, single_protocol

        if self.scene is not None:
            non_engine = None if self.non_engine is None else str(self.non_engine)
            file = single_protocol(path, self.scene, non_engine=non_engine, image_folder=self.image_folder)
        elif path.suffix.lower() != ".toml" and path.exists():
            text = f'"{path.name}" is no .toml; to evaluate an asset, say on which scene: --scene DIR'
            raise UsageError("USAGE", text)
        else:
            file = read_protocol(path)
        return file if self.out is None else replace(file, results_instead=self.out)


@dataclass(frozen=True)
class RunOutput(Output):
    """Output whose JSON may replace that of a run, for a run is started again and again; no other file."""

    _remedy: ClassVar[str] = "msb run replaces only what its --json wrote; name another file"

    def may_replace(self, path: Path) -> bool:
        """Return whether what is at `path` is the JSON of a run."""
        if is_stream(path):  # it is written through; to read it would wait for a writer
            return True
        try:
            with path.open("rb") as file:
                return _START.match(file.read(100)) is not None
        except OSError:  # it has come to be no file, or cannot be read
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
        Path | None, Argument("A protocol.toml; or an asset, with --scene.", metavar="PROTOCOL")
    ] = None,
    *,
    options: RunOptions,
    drawing: Annotated[Drawing, ("device",)],
    output: Annotated[RunOutput, ("json_file", "quiet", "verbose")],
    typed: Typed,
) -> int:
    """Evaluate methods on scenes in all conditions: images, gaps, speed, memory, audit.

    Every cell (dataset, scene, method, condition) is one record. A finished cell is not computed again, so
    the command can be started again after an interruption or when models were added. A failed cell does not
    stop the others; the exit status is the highest of theirs. msb report makes the tables.
    """
    if options.example is not None:
        others = typed.keys() - {"example", "quiet", "verbose", "color", "log_file", "debug"}
        typed.reject(others, "does not go with --example, which stands alone")
    require(path or options.example, "Missing PROTOCOL. msb run --example paper prints one to begin with")
    if options.scene is None:
        typed.reject(["non_engine", "image_folder"], "needs --scene; a protocol has a key of that name")
    if options.example is not None:
        from msb.bench.protocol import example

        echo(example(options.example).decode().removesuffix("\n"))
        return 0
    assert path is not None
    from msb.bench.models import method_of
    from msb.bench.run import run_protocol

    file = options.protocol(path)
    if drawing.device is not None:
        file = replace(file, protocol=file.protocol.model_copy(update={"device": drawing.device}))
    dry = options.dry_run
    if options.scene is not None and not dry:
        method_of(path)  # before anything is written: what is no model spoils no results that are there
    watch = _Watch(output)
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
            output.note(f"interrupted: {watch.cells} cells were done now; the same command goes on")
        raise
    output.write_json(_document(file, report))
    for name, reason in report.models.items():
        where = "" if reason.message.startswith(name) else f"{name}: "
        say(f"{reason.code}: {where}{reason.message}")
    for reason, names in _failures(report, dry=dry).items():
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        say(f"{reason.code}: {names[0]}{more}: {reason.message}")
    if output.prints_text:
        _print(file, report, output, dry=dry)
    qualities = [row.result.quality for row in report.rows if row.result is not None and row.result.quality]
    for text in dict.fromkeys(text for quality in qualities for text in quality.missing.values()):
        output.note(f"warning: {text}; it has no mean where it failed")
    for missing in report.missing:
        say(f"{missing.code}: {missing.message}")
    return report.exit_status


def _failures(report: Report, *, dry: bool) -> dict[Reason, list[str]]:
    """Return every reason for which something is not there -> the cells, or their parts, that it costs."""
    failures: dict[Reason, list[str]] = {}
    for row in report.rows:
        if dry and row.planned.status == "failed":  # said once for all cells, after the table
            continue
        for part, reason in row.reasons.items():
            if not reason.code.startswith("UNSUPPORTED_"):
                what = _name(row) if part == "cell" else f"{_name(row)}, {part}"
                failures.setdefault(reason, []).append(what)
    return failures


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


def _document(file: ProtocolFile, report: Report) -> dict[str, Any]:
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
        for row in report.rows
    ]
    return {
        "schema": _SCHEMA,
        "protocol": str(file.path),
        "results": str(file.results),
        "seconds": report.seconds,
        "missing": [vars(one) for one in report.missing],
        "models": {name: reason.model_dump() for name, reason in report.models.items()},
        "cells": rows,
    }


def _print(file: ProtocolFile, report: Report, output: Output, *, dry: bool) -> None:
    from msb.metrics import IMAGE_METRICS

    headers = [metric.title for metric in IMAGE_METRICS.values()] + ["FPS"]
    states = [_state(row, dry=dry) for row in report.rows]
    rows = zip(report.rows, states, strict=True)
    for dataset, group in groupby(rows, lambda one: one[0].planned.cell.dataset):
        if output.quiet:
            break
        cells: list[tuple[str, ...]] = []
        # A scene has a line of its own: beside its methods a long name would break the lines of a terminal.
        for scene, own in groupby(group, lambda one: one[0].planned.cell.scene):
            cells.append((scene, *[""] * (len(headers) + 2)))
            cells += [(*_cells(row), state) for row, state in own]
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


def _cells(row: Row) -> list[str]:
    """Return method, condition and numbers of a row of the table."""
    from msb.metrics import IMAGE_METRICS

    decimals = {**{key: metric.decimals for key, metric in IMAGE_METRICS.items()}, "fps": 0}
    numbers = (
        "--" if value is None else f"{value:.{decimals[key]}f}" for key, value in _numbers(row).items()
    )
    _, _, method, condition = row.planned.cell.names
    return [f"  {method}", condition, *numbers]


def _state(row: Row, *, dry: bool) -> str:
    """Return in a word or two what became of a cell, or would become of it if the run is dry."""
    planned = row.planned
    if planned.status == "unsupported":
        return "N/A"
    failed = row.reasons.get("cell") or planned.reason
    if failed is not None and not (dry and planned.status == "pending"):
        return "blocked" if dry else f"failed: {failed.code}"  # by what is said below, once for all
    if planned.status == "done":
        return "unchanged"
    why = dict.fromkeys(planned.why.values())
    reasons = "" if list(why) == ["new"] else f": {'; '.join(why)}"
    return f"{'pending' if dry else 'computed'}{reasons}"


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

"""Print results on standard output and notes on standard error, and check the paths of outputs."""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import IO, TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from msb.base.atomic import REPLACES, check_place, folder_is_taken, is_stream, new_file
from msb.base.files import is_folder
from msb.base.option import Option
from msb.base.own_folder import check_own_folder, listed_files
from msb.base.paths import real_place
from msb.base.version import __version__
from msb.cli.progress import ProgressLines, format_duration
from msb.errors import EXIT_STATUS, MsbError, OutputError, UsageError, formula_safe, one_line

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from msb.asset.progress import Progress

STDOUT = "-"
_STDOUT_NAMES = (STDOUT, "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1")
# Width of tables in characters, even if the terminal is narrower.
_LEAST_WIDTH = 80
# Text that replaces arrows if a stream cannot print arrows.
_PLAIN = str.maketrans({"↑": "(up)", "↓": "(down)"})


# The text of a table cell, or a text and its style.
Cell = str | tuple[str, str]


def file_option(text: str, *flags: str, endings: tuple[str, ...] = ()) -> Option:
    """Return the `Option` of an output file. If `endings` are given, the file name must have one of these
    endings."""
    return Option(text, flags, "FILE", output="file", endings=endings)


@dataclass(frozen=True)
class Output:
    """The options of output, and the functions that print results and check output paths.

    If an output file is "-" or ``/dev/stdout``, its content goes to standard output instead of the text.
    """

    json_file: Annotated[
        Path | None,
        file_option("Write JSON to FILE, or to standard output (-) instead of text.", "--json"),
    ] = None
    quiet: Annotated[bool, Option("Print errors and short results only.", ("--quiet", "-q"))] = False
    verbose: Annotated[
        int, Option("Print details; -vv also prints each step and its time.", ("--verbose", "-v"), count=True)
    ] = 0
    force: Annotated[bool, Option("Replace existing outputs.", ("--force", "-f"))] = False
    json_lines: Annotated[
        Path | None,
        file_option("Write one line of JSON per input to FILE, or to standard output (-).", "--jsonl"),
    ] = None
    csv_file: Annotated[
        Path | None,
        file_option("Write one row per item to FILE, or to standard output (-).", "--csv"),
    ] = None
    fail_fast: Annotated[bool, Option("Stop at the first input that fails.")] = False
    _inputs: set[object] = field(default_factory=set, init=False)
    _outputs: dict[object, tuple[str, Path]] = field(default_factory=dict, init=False)
    _checked: dict[str, str] = field(default_factory=dict, init=False)
    _progress_lines: ProgressLines = field(
        default_factory=lambda: ProgressLines(_print_progress), init=False, compare=False
    )
    _remedy: ClassVar[str] = "--force replaces it"

    def __post_init__(self) -> None:
        files = {"--json": self.json_file, "--jsonl": self.json_lines, "--csv": self.csv_file}
        taken = [option for option, path in files.items() if is_stdout(path)]
        if len(taken) > 1:
            raise UsageError("USAGE", f"{' and '.join(taken)} cannot both go to standard output")

    @property
    def prints_text(self) -> bool:
        """Whether the text of the result is printed."""
        return not any(map(is_stdout, (self.json_file, self.json_lines, self.csv_file)))

    @property
    def shows_progress(self) -> bool:
        """Whether progress bars are shown. Progress bars need a terminal and a printed text result."""
        return self.prints_text and not self.quiet and sys.stderr.isatty()

    @property
    def progress_lines(self) -> ProgressLines | None:
        """The writer of progress lines; None on a terminal and with --quiet."""
        return None if self.quiet or sys.stderr.isatty() else self._progress_lines

    @contextlib.contextmanager
    def _report(self, describe: Callable[[], str]) -> Iterator[None]:
        """Write ``describe()`` and the elapsed time at intervals during the block, except on a terminal."""
        start = time.monotonic()
        lines = self.progress_lines
        if lines is None:
            yield
            return
        with lines.watch(lambda: f"{describe()}, {format_duration(time.monotonic() - start)} so far"):
            yield

    def console(self) -> Console:
        """Return the console for results. Rich applies FORCE_COLOR and TERM=dumb; NO_COLOR gives plain text.

        The console has at least 80 columns. With fewer columns, rich would break the numbers of a table.
        """
        from rich.console import Console

        colors: Any = None if os.environ.get("NO_COLOR") else "auto"
        console = Console(highlight=False, color_system=colors)
        console.width = max(console.width, _LEAST_WIDTH)
        return console

    def table(
        self,
        headers: Sequence[str],
        rows: Iterable[Sequence[Cell]],
        *,
        right: Iterable[int] = (),
        gap: int = 2,
        unbroken: Iterable[int] = (),
        whole: bool = False,
    ) -> None:
        """Print a table without a frame.

        Parameters
        ----------
        headers : sequence of str
            Titles of the columns. Without titles, the title line is omitted.
        rows : iterable
            The cells of each row.
        right : iterable of int
            Columns that are aligned to the right.
        gap : int
            Blanks between columns.
        unbroken : iterable of int
            Columns whose cells stay on one line.
        whole : bool
            In a pipe, print every row as one line.
        """
        from rich.measure import Measurement
        from rich.text import Text

        console = self.console()
        if whole and not console.is_terminal:
            console.width = 10_000  # wider than every table
        rows = list(rows)
        names = headers or [""] * len(rows[0])
        table = plain_table(*names, right=tuple(right), gap=gap)
        table.show_header = bool(headers)
        for number in unbroken:
            table.columns[number].no_wrap = True
        for row in rows:
            cells = (cell if isinstance(cell, tuple) else (cell, "") for cell in row)
            table.add_row(*(Text(text, style) for text, style in cells))
        # Widen the table until no word is broken.
        words = Measurement.get(console, console.options.update(width=10_000), table).minimum
        console.width = max(console.width, words)
        console.print(table)

    def line(self, *parts: Cell) -> None:
        """Print texts in their styles on one line.

        Do not wrap the line, so that users can copy a path from the line. Only the terminal may wrap the
        line.
        """
        from rich.text import Text

        texts = (part if isinstance(part, tuple) else (part, "") for part in parts)
        self.console().print(Text.assemble(*texts), soft_wrap=True)

    def note(self, text: str, *, level: int = 0) -> None:
        """Print a note on standard error if --verbose is at least `level`. A log file gets every note.

        At level 0 the text gets the prefix "note: ", unless it begins with "note: " or "warning: ".
        """
        text = one_line(text)
        if level == 0 and not text.startswith(("note: ", "warning: ")):
            text = f"note: {text}"
        log(text, "DEBUG" if level > 1 else "INFO")
        if not self.quiet and self.verbose >= level:
            _print_aside(text)

    @contextlib.contextmanager
    def progress(self, text: str) -> Iterator[None]:
        """Show `text` while the block runs: with a spinner on a terminal, as lines elsewhere.

        With -vv, the elapsed time is printed.
        """
        start = time.perf_counter()
        if self.shows_progress:
            from rich.console import Console

            with Console(stderr=True).status(text, spinner="line"):  # ASCII characters only
                yield
        else:
            with self._report(lambda: text):
                yield
        self.note(f"{text}: {1000 * (time.perf_counter() - start):.1f} ms", level=2)

    @contextlib.contextmanager
    def bars(self, unit: Literal["bytes", "steps"] = "bytes") -> Iterator[Progress]:
        """Yield a function that shows the progress of each stage: a bar on a terminal, lines elsewhere.

        With -v, the times of the stages are printed at the end.
        """
        begun: list[tuple[str, float]] = []
        state = ["starting"]
        with (
            self._bars("DownloadColumn" if unit == "bytes" else "MofNCompleteColumn") as bars,
            self._report(lambda: state[0]),
        ):
            tasks: dict[str, Any] = {}

            def update(stage: str, done: int, total: int) -> None:
                # A percentage is useless for a stage with a single step.
                state[0] = stage if total <= 1 else f"{stage} {100 * done // total} %"
                if not begun or begun[-1][0] != stage:
                    if begun and bars is not None:  # the previous stage has ended
                        ended = tasks[begun[-1][0]]
                        bars.update(ended, completed=bars.tasks[ended].total)
                    begun.append((stage, time.perf_counter()))
                if bars is not None:
                    if stage not in tasks:
                        tasks[stage] = bars.add_task(stage, total=total)
                    bars.update(tasks[stage], completed=done, total=total)

            yield update
        spent: dict[str, float] = {}
        for (stage, start), (_, stop) in pairwise([*begun, ("", time.perf_counter())]):
            spent[stage] = spent.get(stage, 0.0) + stop - start
        if spent:
            times = (f"{stage} {seconds:.1f} s" for stage, seconds in spent.items())
            self.note(f"time: {', '.join(times)}", level=1)

    @contextlib.contextmanager
    def counted(self, text: str, total: int) -> Iterator[Callable[[], None]]:
        """Yield a function to call after each of `total` steps. A bar or lines show the progress."""
        done = 0
        with self._bars("MofNCompleteColumn") as bars, self._report(lambda: f"{text} {done}/{total}"):
            task = None if bars is None else bars.add_task(text, total=total)

            def step() -> None:
                nonlocal done
                done += 1
                if bars is not None:
                    bars.advance(task)

            yield step

    @contextlib.contextmanager
    def _bars(self, counter: str) -> Iterator[Any]:
        if not self.shows_progress:
            yield None
            return
        from rich import progress
        from rich.console import Console

        # The spinner and the elapsed time are updated even during a long step.
        columns = (
            progress.SpinnerColumn("line"),  # ASCII characters only
            progress.TextColumn("{task.description}"),
            progress.BarColumn(),
            getattr(progress, counter)(),
            progress.TimeElapsedColumn(),
            progress.TimeRemainingColumn(),
        )
        with progress.Progress(*columns, console=Console(stderr=True), transient=True) as bars:
            yield bars

    def add_input(self, path: Path) -> None:
        """Register the path of an input. No output may be the same file as an input."""
        self._inputs.add(_identity(path))

    def add_inputs(self, paths: Iterable[Path]) -> None:
        """Register the files of a folder or pattern, and check all registered outputs again."""
        for path in paths:
            self.add_input(path)
        for _, path in self._outputs.values():
            self._check_apart(path)

    def add_output(self, path: Path, label: str) -> None:
        """Register the path of an output. The path must differ from all inputs and other outputs.

        Several outputs may go to one device or pipe.
        """
        if is_stdout(path) or is_stream(path):
            return
        self._check_apart(path)
        other, _ = self._outputs.setdefault(_identity(path), (label, path))
        if other != label:
            raise UsageError("USAGE", f"{label} and {other} name the same file", file=path)

    def check_free(
        self, path: Path | None, *, folder: bool = False, label: str = "a file next to the output"
    ) -> None:
        """Reject an output that is also an input, cannot be written, or may not be replaced.

        `label` names the option in the message about two outputs with the same file. Without --force, an
        existing `folder` must be empty. Devices and pipes are always accepted.
        """
        if path is None or is_stdout(path):
            return
        self._check_apart(path)
        taken = folder_is_taken(path) if folder else os.path.lexists(path) and not is_stream(path)
        if taken and not self.may_replace(path):
            if not folder and is_folder(path):
                check_place(path)  # a folder cannot be replaced, even with --force
            raise UsageError("OUTPUT_EXISTS", f"the path exists; {self._remedy}", file=path)
        check_place(path, folder=folder)
        if not is_stream(path):
            place = os.path.join(os.path.realpath(path.parent), path.name)  # noqa: PTH118 - a link is replaced
            if place in self._checked:
                other = self._checked[place]
                text = f"{other} and {label} would both write" if other != label else f"{label} would write"
                twice = "" if other != label else " twice"
                raise UsageError("USAGE", f"{text} this file{twice}; use different names", file=path)
            self._checked[place] = label

    def check_folder(self, folder: Path, *, replace: bool | None = None) -> None:
        """Check a folder that `msb.base.own_folder` will write.

        The default of `replace` is the option --force.

        The folder must be new or empty. With `replace`, the folder may contain files of an earlier run,
        unless one of these files is an input.
        """
        if folder_is_taken(folder) and not (self.force if replace is None else replace):
            raise UsageError("OUTPUT_EXISTS", f"the path exists; {self._remedy}", file=folder)
        check_own_folder(folder)
        self._check_apart(folder)
        files = [folder / name for name in listed_files(folder) or ()]
        for place in {*files, *(above for file in files for above in file.parents)} - {*folder.parents}:
            self._check_apart(place)  # the folder can be inside an input folder

    def may_replace(self, path: Path) -> bool:
        """Return whether a file at `path` may be replaced, even if it appears while the command runs."""
        del path  # subclasses use it
        return self.force

    def _check_apart(self, path: Path) -> None:
        if not is_stream(path) and _identity(path) in self._inputs:
            raise UsageError("USAGE", "the path is an input; write the output to another file", file=path)

    def reword(self, error: MsbError) -> None:
        """Replace the parameter `overwrite` in the message of an error by the option --force."""
        error.message = error.message.replace(REPLACES, self._remedy)

    def write_json(self, data: Any) -> None:
        """Write a document, or a list of documents, to the file of --json, if the option was given."""
        if self.json_file is None:
            return
        data = [_add_version(document) for document in data] if isinstance(data, list) else _add_version(data)
        text = json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
        self._write(self.json_file, text)

    def write_documents(self, documents: Sequence[dict[str, Any]]) -> None:
        """Write one document per input. --json gets one document or a list, and --jsonl gets a line per
        document.
        """
        self.write_json(documents[0] if len(documents) == 1 else list(documents))
        if self.json_lines is not None:
            signed = map(_add_version, documents)
            lines = (json.dumps(document, allow_nan=False, ensure_ascii=False) for document in signed)
            self._write(self.json_lines, "".join(f"{line}\n" for line in lines))

    def write_csv(self, columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
        """Write `rows` to the file of --csv, if this option was given.

        The function `formula_safe` escapes texts that a spreadsheet would run as formulas.
        """
        if self.csv_file is None:
            return
        import csv

        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, fieldnames=columns)
        writer.writeheader()
        for row in rows:
            writer.writerow({key: formula_safe(v) if isinstance(v, str) else v for key, v in row.items()})
        self._write(self.csv_file, text.getvalue())

    def _write(self, path: Path, text: str) -> None:
        # Bytes of file names that are not UTF-8 become \udcXX in JSON, and readers can restore them.
        data = text.encode(errors="backslashreplace")
        if is_stdout(path):
            sys.stdout.flush()
            sys.stdout.buffer.write(data)
        else:
            with new_file(path, size=len(data), overwrite=self.may_replace(path)) as file:
                file.write(data)


# Options of a command that writes no JSON.
PlainOutput = Annotated[Output, ("force", "quiet", "verbose")]
JsonOutput = Annotated[Output, ("json_file", "force", "quiet", "verbose")]
# Options of a command that takes several inputs.
ManyOutput = Annotated[Output, ("json_file", "fail_fast", "force", "quiet", "verbose")]
# Options of a command that writes a document per input.
LinesOutput = Annotated[Output, ("json_file", "json_lines", "fail_fast", "force", "quiet", "verbose")]


def is_stdout(path: Path | None) -> bool:
    """Return whether `path` is a name of standard output."""
    return str(path) in _STDOUT_NAMES


def _identity(path: Path) -> object:
    """Return a key that is equal for all paths of a file. The key is the inode, or the path of a new file."""
    try:
        status = path.stat()
    except (OSError, ValueError):  # the file does not exist, or its name is invalid
        return real_place(path)
    return status.st_dev, status.st_ino


def _add_version(document: dict[str, Any]) -> dict[str, Any]:
    """Return `document` with the version of msb as its second key, after the schema."""
    return {"schema": document["schema"], "tool_version": __version__, **document}


def echo(text: str = "") -> None:
    """Print lines of a result on standard output.

    On an ASCII stream, words replace arrows, and escapes replace other characters. (typer.echo always
    writes UTF-8.)
    """
    if not (sys.stdout.encoding or "").lower().startswith("utf"):
        text = text.translate(_PLAIN)
    print(text)  # noqa: T201 - this is the only place that prints results


def say(text: str) -> None:
    """Print an error as one line on standard error, and write it to the log file."""
    log(text, "ERROR")
    _print_aside(text)


def report_error(error: MsbError) -> int:
    """Print `error` as one line on standard error and return its exit status."""
    say(str(error).replace(REPLACES, Output._remedy))
    return EXIT_STATUS[type(error)]


def _print_progress(text: str) -> None:
    """Print a progress line on standard error at once, and write it to the log file."""
    text = one_line(f"progress: {text}")
    log(text, "INFO")
    _print_aside(text)


def _print_aside(text: str) -> None:
    """Print on standard error. If standard error is closed or full, the text is lost."""
    try:
        print(text, file=sys.stderr, flush=True)  # noqa: T201 - only this line prints notes and errors
    except OSError:
        silence(sys.stderr)


def silence(stream: IO[str]) -> None:
    """Discard the buffer of `stream`, and everything that is written to the stream later."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def log(text: str, level: str) -> None:
    """Write `text` to the log file, if a log file is open. After an error the log is closed."""
    if not _LOG:
        return
    stamp = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    file = _LOG[0]
    try:
        print(stamp, level, text, file=file, flush=True)
    except OSError as error:
        _LOG.clear()
        silence(file)
        file.close()
        say(str(_log_error(file.name, error)))


def _log_error(path: object, error: OSError) -> OutputError:
    return OutputError("OUTPUT_UNWRITABLE", f"the log cannot be written: {error.strerror}", file=path)


def open_log(path: Path) -> None:
    """Open the log file at `path` for appending, and write the command line to the log."""
    import shlex

    try:
        if not is_stream(path):
            _check_log(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        # The file stays open until the process ends, and every line is flushed.
        _LOG[:] = [path.open("a", encoding="utf-8", errors="backslashreplace")]
    except OSError as error:
        raise _log_error(path, error) from error
    log(f"msb {__version__}: {shlex.join(sys.argv)}", "INFO")


def _check_log(path: Path) -> None:
    """Reject an existing file that does not begin like a log of msb."""
    with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
        begin = file.read(_LOG_BEGINS_WITHIN)
        if begin and not _LOG_BEGINS.match(begin):
            text = "the file exists and is not a log of msb; name another file"
            raise UsageError("OUTPUT_EXISTS", f"--log-file: {text}", file=path)


_LOG_BEGINS = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\S{5,6} (INFO|DEBUG|ERROR) ")
_LOG_BEGINS_WITHIN = 100
# The log file, or None without a log.
_LOG: list[IO[str]] = []


def setting_text(value: object) -> str:
    """Return the value of a setting as text with the 7 digits of a float32."""
    if value is None:
        return "none"
    return f"{value:.7g}" if isinstance(value, float) else str(value)


def plain_table(*headers: str, right: tuple[int, ...] = (), gap: int = 2) -> Table:
    """Return a table without a frame. Columns in `right` are right-aligned; `gap` blanks separate columns."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, gap, 0, 0), header_style="bold")
    for number, header in enumerate(headers):
        table.add_column(header, justify="right" if number in right else "left", overflow="fold")
    return table

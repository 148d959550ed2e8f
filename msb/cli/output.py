"""Print results on standard output and notes on standard error; write files whole."""

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
from msb.base.version import __version__
from msb.errors import EXIT_STATUS, MsbError, OutputError, UsageError, formula_safe, one_line

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from msb.asset.progress import Progress

STDOUT = "-"
_STDOUT_NAMES = (STDOUT, "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1")
_LEAST_WIDTH = 80
_PLAIN = str.maketrans({"↑": "(up)", "↓": "(down)"})


Cell = str | tuple[str, str]
"""A text of a table, or a text and its style."""


def file_option(text: str, *flags: str, endings: tuple[str, ...] = ()) -> Option:
    """Return the option of a file that is written, with one of these endings if there are any."""
    return Option(text, flags, "FILE", output="file", endings=endings)


@dataclass(frozen=True)
class Output:
    """The user's wishes about output: what to print, and where.

    A file "-" (or ``/dev/stdout``) takes standard output for itself; the human text is then not printed.
    """

    json_file: Annotated[
        Path | None,
        file_option("Write JSON to FILE; - is standard output, and nothing else.", "--json"),
    ] = None
    quiet: Annotated[bool, Option("Say less: no progress, no notes, short results.", ("--quiet", "-q"))] = (
        False
    )
    verbose: Annotated[
        int, Option("Say more; twice: also each step and its time.", ("--verbose", "-v"), count=True)
    ] = 0
    force: Annotated[bool, Option("Replace outputs that exist.", ("--force", "-f"))] = False
    json_lines: Annotated[
        Path | None,
        file_option("Write one line of JSON per input to FILE; - as above.", "--jsonl"),
    ] = None
    csv_file: Annotated[
        Path | None,
        file_option("Write one row per item to FILE; - is standard output.", "--csv"),
    ] = None
    fail_fast: Annotated[bool, Option("Stop at the first input that fails.")] = False
    _inputs: set[object] = field(default_factory=set, init=False)
    _outputs: dict[object, str] = field(default_factory=dict, init=False)
    _files: list[Path] = field(default_factory=list, init=False)
    _checked: set[str] = field(default_factory=set, init=False)
    _remedy: ClassVar[str] = "--force replaces it"

    def __post_init__(self) -> None:
        files = {"--json": self.json_file, "--jsonl": self.json_lines, "--csv": self.csv_file}
        taken = [option for option, path in files.items() if is_stdout(path)]
        if len(taken) > 1:
            raise UsageError("USAGE", f"{' and '.join(taken)} cannot both go to standard output")

    @property
    def prints_text(self) -> bool:
        """Whether the human-readable result is wanted on standard output."""
        return not any(map(is_stdout, (self.json_file, self.json_lines, self.csv_file)))

    @property
    def shows_progress(self) -> bool:
        """Whether bars and spinners are drawn: on a terminal, beside a result for people."""
        return self.prints_text and not self.quiet and sys.stderr.isatty()

    def console(self) -> Console:
        """Return the console for results. Rich heeds FORCE_COLOR and TERM=dumb; NO_COLOR is plain text.

        Tables are laid out for 80 columns or more: narrower terminals break their lines, not their numbers.
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

        `right` are the columns that are aligned to the right, `unbroken` those whose cells stay on one line.
        There are `gap` blanks between columns, and no line of headers without any. With `whole` every row is
        one line in a pipe, where programs read lines.
        """
        from rich.measure import Measurement
        from rich.text import Text

        console = self.console()
        if whole and not console.is_terminal:
            console.width = 10_000  # no table is as wide
        rows = list(rows)
        names = headers or [""] * len(rows[0])
        table = plain_table(*names, right=tuple(right), gap=gap)
        table.show_header = bool(headers)
        for number in unbroken:
            table.columns[number].no_wrap = True
        for row in rows:
            cells = (cell if isinstance(cell, tuple) else (cell, "") for cell in row)
            table.add_row(*(Text(text, style) for text, style in cells))
        # No word is broken: a table is at least as wide as its longest words need.
        words = Measurement.get(console, console.options.update(width=10_000), table).minimum
        console.width = max(console.width, words)
        console.print(table)

    def line(self, *parts: Cell) -> None:
        """Print a line of texts and their styles. The terminal wraps it, so that a path can be copied."""
        from rich.text import Text

        texts = (part if isinstance(part, tuple) else (part, "") for part in parts)
        self.console().print(Text.assemble(*texts), soft_wrap=True)

    def note(self, text: str, *, level: int = 0) -> None:
        """Print a note on standard error, if the user wants this much; a log file gets it in any case.

        A text that warns begins with "warning: " itself; what -v asks for has no word before it.
        """
        text = one_line(text)
        if level == 0 and not text.startswith(("note: ", "warning: ")):
            text = f"note: {text}"
        log(text, "DEBUG" if level > 1 else "INFO")
        if not self.quiet and self.verbose >= level:
            _print_aside(text)

    @contextlib.contextmanager
    def progress(self, text: str) -> Iterator[None]:
        """Show `text` with a spinner while the block runs, on a terminal; its time with -vv."""
        start = time.perf_counter()
        if self.shows_progress:
            from rich.console import Console

            with Console(stderr=True).status(text, spinner="line"):  # of ASCII
                yield
        else:
            yield
        self.note(f"{text}: {1000 * (time.perf_counter() - start):.1f} ms", level=2)

    @contextlib.contextmanager
    def bars(self, unit: Literal["bytes", "steps"] = "bytes") -> Iterator[Progress]:
        """Yield a function that draws a bar for each stage, on a terminal; their times with -v."""
        begun: list[tuple[str, float]] = []
        with self._bars("DownloadColumn" if unit == "bytes" else "MofNCompleteColumn") as bars:
            tasks: dict[str, Any] = {}

            def update(stage: str, done: int, total: int) -> None:
                if not begun or begun[-1][0] != stage:
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
            self.note(f"time went to: {', '.join(times)}", level=1)

    @contextlib.contextmanager
    def counted(self, text: str, total: int) -> Iterator[Callable[[], None]]:
        """Yield a function to call after each of `total` steps; it draws a bar, on a terminal only."""
        with self._bars("MofNCompleteColumn") as bars:
            if bars is None:
                yield lambda: None
            else:
                task = bars.add_task(text, total=total)
                yield lambda: bars.advance(task)

    @contextlib.contextmanager
    def _bars(self, counter: str) -> Iterator[Any]:
        if not self.shows_progress:
            yield None
            return
        from rich import progress
        from rich.console import Console

        columns = (
            progress.TextColumn("{task.description}"),
            progress.BarColumn(),
            getattr(progress, counter)(),
            progress.TimeRemainingColumn(),
        )
        with progress.Progress(*columns, console=Console(stderr=True), transient=True) as bars:
            yield bars

    def add_input(self, path: Path) -> None:
        """Register a path that is read: no output may be the same file."""
        self._inputs.add(_identity(path))

    def add_inputs(self, paths: Iterable[Path]) -> None:
        """Register the files that a folder or pattern on the command line stands for; check outputs again."""
        for path in paths:
            self.add_input(path)
        for path in self._files:
            self._check_apart(path)

    def add_output(self, path: Path, label: str) -> None:
        """Register a file that is written; it may be no input, and no other output.

        Streams can take several outputs.
        """
        if is_stdout(path) or is_stream(path):
            return
        self._check_apart(path)
        self._files.append(path)
        if (other := self._outputs.setdefault(_identity(path), label)) != label:
            raise UsageError("USAGE", f"{label} and {other} name the same file", file=path)

    def check_free(self, path: Path | None, *, folder: bool = False) -> None:
        """Reject an output that is an input, that exists without --force, or that cannot be written.

        A device or pipe is written through. An existing `folder` without --force must be empty.
        """
        if path is None or is_stdout(path):
            return
        self._check_apart(path)
        taken = folder_is_taken(path) if folder else os.path.lexists(path) and not is_stream(path)
        if taken and not self.may_replace(path):
            if not folder and is_folder(path):
                check_place(path)  # --force would not replace a folder by a file
            raise UsageError("OUTPUT_EXISTS", f"it exists; {self._remedy}", file=path)
        check_place(path, folder=folder)
        if not is_stream(path):
            place = os.path.join(os.path.realpath(path.parent), path.name)  # noqa: PTH118 - one text a file
            if place in self._checked:
                raise UsageError("USAGE", "two outputs would be written to it; name them apart", file=path)
            self._checked.add(place)

    def check_folder(self, folder: Path) -> None:
        """Reject a folder that holds anything; with --force one that no earlier run wrote.

        None of the files that would be replaced may be an input (`msb.base.own_folder`).
        """
        if folder_is_taken(folder) and not self.force:
            raise UsageError("OUTPUT_EXISTS", f"it exists; {self._remedy}", file=folder)
        check_own_folder(folder)
        for name in listed_files(folder) or ():
            self._check_apart(folder / name)

    def may_replace(self, path: Path) -> bool:
        """Return whether what is at `path`, or appears there while the command runs, may be replaced."""
        del path  # a command may look at what is there
        return self.force

    def _check_apart(self, path: Path) -> None:
        if not is_stream(path) and _identity(path) in self._inputs:
            raise UsageError("USAGE", "it is an input; write the output to another file", file=path)

    def reword(self, error: MsbError) -> None:
        """Let an error of the library, which knows no options, name the option of this command."""
        error.message = error.message.replace(REPLACES, self._remedy)

    def write_json(self, data: Any) -> None:
        """Write `data`, a document or a list of them, where --json points to, if it was given."""
        if self.json_file is None:
            return
        data = [_signed(one) for one in data] if isinstance(data, list) else _signed(data)
        text = json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
        self._write(self.json_file, text)

    def write_documents(self, documents: Sequence[dict[str, Any]]) -> None:
        """Write one document per input: --json gets it, or a list of several, --jsonl a line for each."""
        self.write_json(documents[0] if len(documents) == 1 else list(documents))
        if self.json_lines is not None:
            lines = (json.dumps(_signed(one), allow_nan=False, ensure_ascii=False) for one in documents)
            self._write(self.json_lines, "".join(f"{line}\n" for line in lines))

    def write_csv(self, columns: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
        """Write `rows` where --csv points to, if it was given; texts as `formula_safe` has them."""
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
        # A file name need not be text: its odd bytes become \udcXX, which JSON reads back as they were.
        data = text.encode(errors="backslashreplace")
        if is_stdout(path):
            sys.stdout.flush()
            sys.stdout.buffer.write(data)
        else:
            with new_file(path, size=len(data), overwrite=self.may_replace(path)) as file:
                file.write(data)


PlainOutput = Annotated[Output, ("force", "quiet", "verbose")]
"""Of a command that writes no JSON."""
JsonOutput = Annotated[Output, ("json_file", "force", "quiet", "verbose")]
ManyOutput = Annotated[Output, ("json_file", "fail_fast", "force", "quiet", "verbose")]
"""Of a command that takes several inputs."""
LinesOutput = Annotated[Output, ("json_file", "json_lines", "fail_fast", "force", "quiet", "verbose")]
"""Of one that writes a document for each of them."""


def is_stdout(path: Path | None) -> bool:
    """Return whether `path` is standard output, by its short name or one of the system's."""
    return str(path) in _STDOUT_NAMES


def _identity(path: Path) -> object:
    """Return what is equal for two paths of one file: its inode, or its place where there is none yet."""
    try:
        status = path.stat()
    except (OSError, ValueError):  # it does not exist yet, or cannot; its use reports that
        return os.path.realpath(path) if "\0" not in str(path) else str(path)
    return status.st_dev, status.st_ino


def _signed(document: dict[str, Any]) -> dict[str, Any]:
    """Return `document` with the version that made it after its schema."""
    return {"schema": document["schema"], "tool_version": __version__, **document}


def echo(text: str = "") -> None:
    """Print lines of a result on standard output.

    It replaces typer.echo, which writes UTF-8 to a stream that is set to ASCII. On a stream that cannot write
    them, arrows become words and other characters become escapes.
    """
    if not (sys.stdout.encoding or "").lower().startswith("utf"):
        text = text.translate(_PLAIN)
    print(text)  # noqa: T201 - the one place lines of results are printed


def say(text: str) -> None:
    """Print an error on standard error, as one line that a log file gets too."""
    log(text, "ERROR")
    _print_aside(text)


def report_error(error: MsbError) -> int:
    """Print `error` as one line on standard error and return its exit status."""
    # What somebody wrote there while the command ran is found by the library, which knows no options.
    say(str(error).replace(REPLACES, Output._remedy))
    return EXIT_STATUS[type(error)]


def _print_aside(text: str) -> None:
    """Print on standard error; where that is closed or full there is nobody to tell."""
    try:
        print(text, file=sys.stderr)  # noqa: T201 - the one place where notes and errors are printed
    except OSError:
        silence(sys.stderr)


def silence(stream: IO[str]) -> None:
    """Let what is and will be written to `stream` vanish, the interpreter's own flush at its end included."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def log(text: str, level: str) -> None:
    """Write `text` to the log file, if --log-file opened one; if it cannot be, say so once and go on."""
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
    """Append to the file at `path` from now on; the command line is the first line."""
    import shlex

    try:
        if not is_stream(path):
            _check_log(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        # Open as long as the process lives; every line is flushed.
        _LOG[:] = [path.open("a", encoding="utf-8", errors="backslashreplace")]
    except OSError as error:
        raise _log_error(path, error) from error
    log(f"msb {__version__}: {shlex.join(sys.argv)}", "INFO")


def _check_log(path: Path) -> None:
    """Reject a file that does not begin as our logs do."""
    with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
        begin = file.read(_LOG_BEGINS_WITHIN)
        if begin and not _LOG_BEGINS.match(begin):
            text = "it is not a log of msb, and lines are only added to one; name another file"
            raise UsageError("OUTPUT_EXISTS", f"--log-file: {text}", file=path)


_LOG_BEGINS = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\S{5,6} (INFO|DEBUG|ERROR) ")
_LOG_BEGINS_WITHIN = 100
_LOG: list[IO[str]] = []
"""The log file, if there is one."""


def setting_text(value: object) -> str:
    """Return a setting's value as a person reads it: a float32 without the digits it does not have."""
    if value is None:
        return "none"
    return f"{value:.7g}" if isinstance(value, float) else str(value)


def plain_table(*headers: str, right: tuple[int, ...] = (), gap: int = 2) -> Table:
    """Return a table without a frame, `right` naming the right-aligned columns, `gap` blanks between them."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, gap, 0, 0), header_style="bold")
    for number, header in enumerate(headers):
        table.add_column(header, justify="right" if number in right else "left", overflow="fold")
    return table

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

from msb.base.atomic import REPLACES, check_place, is_stream, new_file
from msb.base.files import is_folder
from msb.base.option import Option
from msb.base.version import __version__
from msb.cli.parts import is_made, names, own_place
from msb.errors import EXIT_STATUS, MsbError, OutputError, UsageError, formula_safe, one_line

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from msb.asset.progress import Progress
    from msb.meshes import Mesh
    from msb.meshes.formats import Style

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
    _checked: set[str] = field(default_factory=set, init=False)
    _inputs: list[tuple[str, Path]] = field(default_factory=list, init=False)
    _read: set[object] = field(default_factory=set, init=False)
    _folders: dict[Path, str] = field(default_factory=dict, init=False)
    _written: list[Path] = field(default_factory=list, init=False)
    _replaced: list[Path] = field(default_factory=list, init=False)
    _way_out: ClassVar[str] = "--force replaces it"

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
        from msb.cli.whole_words import WholeWordConsole

        colors: Any = None if os.environ.get("NO_COLOR") else "auto"
        console = WholeWordConsole(highlight=False, color_system=colors)
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
        console.print(table)

    def line(self, *parts: Cell) -> None:
        """Print a line of texts and their styles: broken between words on a terminal, whole in a pipe."""
        from rich.markup import escape

        console = self.console()
        texts = (part if isinstance(part, tuple) else (part, "") for part in parts)
        markup = "".join(f"[{style}]{escape(text)}[/]" if style else escape(text) for text, style in texts)
        console.print(markup, soft_wrap=not console.is_terminal)

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

    def check_free(self, path: Path | None, *, folder: bool = False) -> None:
        """Refuse to overwrite `path` without --force, and a place where nothing can be written.

        A device or pipe is written through, and a `folder` cannot be.
        """
        if path is None or is_stdout(path):
            return
        self.check_apart(path)
        replaced = not is_stream(path)
        if replaced and os.path.lexists(path) and not self.may_replace(path):
            if not folder and is_folder(path):
                check_place(path)  # says so: --force would not replace it
            raise UsageError("OUTPUT_EXISTS", f"it exists; {self._way_out}", file=path)
        check_place(path, folder=folder)
        place = own_place(path)
        if replaced and place in self._checked:
            raise UsageError("USAGE", "two outputs would be written to it; give each its own", file=path)
        self._checked.add(place)

    def may_replace(self, path: Path) -> bool:
        """Return whether what is at `path`, or comes there while the command runs, may be replaced."""
        del path  # a command may look at what is there
        return self.force

    def keep(self, label: str, path: Path, *, written: bool = False, searched: bool = False) -> None:
        """Remember an input, which no output may be and no folder that is replaced may hold, or an output.

        A folder is one input with all that it holds, unless it is `searched` for inputs.
        """
        if written:
            self._written.append(path)
            return
        self._inputs.append((label, path))
        self._read.add(place_of(path))
        if not searched and is_folder(path):
            places = Path(os.path.abspath(path)), Path(os.path.realpath(path))  # noqa: PTH100 - as in check_apart
            self._folders.update(dict.fromkeys(places, label))

    def keep_found(self, inputs: Iterable[Path]) -> None:
        """Remember the inputs that a typed folder or pattern stands for; refuse outputs that are one."""
        for path in inputs:
            self.keep(str(path), path)
        for path in self._written:
            self.check_apart(path)
        for folder in self._replaced:
            self._check_holds_no_input(folder)

    def check_apart(self, path: Path) -> None:
        """Refuse an output that is an input or a file in one: --force is no wish to lose it.

        What a folder in an input holds is looked at where that is replaced; a log is only added to, and what
        commands wrote there is no part of an input.
        """
        if not self._read or is_stdout(path) or is_stream(path):
            return
        if place_of(path) in self._read:
            raise UsageError("USAGE", "it is an input; an output needs a place of its own", file=path)
        if self.force and os.path.lexists(path) and not is_folder(path) and not _is_log(path):
            places = Path(os.path.abspath(path)), Path(own_place(path))  # noqa: PTH100 - without links, and with
            inside = [each for place in places for each in place.parents if each in self._folders]
            # A model may lie in its scene: the nearest of such folders says what the file is.
            folder = max(inside, key=lambda each: len(os.path.realpath(each)), default=None)
            if folder is not None and not is_made(path, folder):
                label = self._folders[folder]
                text = f"it is a file of {label}, an input; an output needs a place of its own"
                raise UsageError("USAGE", text, file=path)

    def check_unnamed(self, path: Path) -> None:
        """Refuse to replace a file that an input names, or a library of materials of that."""
        for label, source in self._inputs if os.path.lexists(path) else ():
            if names(source, path):
                text = f"{label} names it, which makes it an input; an output needs a place of its own"
                raise UsageError("USAGE", text, file=path)

    def check_folder(self, folder: Path, check: Callable[[Path], bool]) -> None:
        """Refuse a folder with an input in it, or that `check` refuses, and without --force one to replace.

        `check` returns whether nothing is replaced, as `msb.base.own_folder.check_own_folder` does.
        """
        self._replaced.append(folder)
        self._check_holds_no_input(folder)
        if check(folder) and os.path.lexists(folder):
            check_place(folder, folder=True)
        else:
            self.check_free(folder, folder=True)

    def _check_holds_no_input(self, folder: Path) -> None:
        place = os.path.realpath(folder)
        for label, path in self._inputs if is_folder(folder) else ():
            # A link to an input would be lost, too.
            if any(Path(each).is_relative_to(place) for each in (os.path.realpath(path), own_place(path))):
                text = f"{label} lies in it; an output needs a place of its own"
                raise UsageError("USAGE", text, file=folder)

    def reword(self, error: MsbError) -> None:
        """Let an error of the library, which knows no options, name the option of this command."""
        error.message = error.message.replace(REPLACES, self._way_out)

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


def place_of(path: Path) -> object:
    """Return what is equal for two paths of one file: its number, or its place where there is none yet."""
    try:
        status = path.stat()
    except (OSError, ValueError):  # it is not there yet, or cannot be: said when it is used
        return real_place(path)
    return status.st_dev, status.st_ino


def real_place(path: Path) -> str:
    """Return the place to which a path leads; of one that none can have, itself."""
    return os.path.realpath(path) if "\0" not in str(path) else str(path)


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
    say(str(error).replace(REPLACES, Output._way_out))
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


def _is_log(path: Path) -> bool:
    return any(Path(file.name) == path for file in _LOG)


def _check_log(path: Path) -> None:
    """Refuse a file that does not begin as our logs do, and one that a search for inputs would find."""
    from msb.asset import ASSET_SUFFIX
    from msb.meshes import MESH_SUFFIXES

    with contextlib.suppress(FileNotFoundError), path.open("rb") as file:
        begin = file.read(_LOG_BEGINS_WITHIN)
        if begin and not _LOG_BEGINS.match(begin):
            text = "it is no log of msb's, and a log is only added to one; name another file"
            raise UsageError("OUTPUT_EXISTS", f"--log-file: {text}", file=path)
    if path.suffix.lower() in (ASSET_SUFFIX, *MESH_SUFFIXES):
        raise UsageError("USAGE", f"--log-file: a log is no {path.suffix} file; name another", file=path)


_LOG_BEGINS = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\S{5,6} (INFO|DEBUG|ERROR) ")
_LOG_BEGINS_WITHIN = 100
_LOG: list[IO[str]] = []
"""The log file, if there is one."""


def write_held(held: Mesh, target: Path, output: Output, style: Style | None = None) -> None:
    """Write a mesh with the files that it needs beside it, none of which may be there without --force."""
    from msb.meshes.files import beside, write_whole
    from msb.meshes.formats import Style

    for other in beside(held, target, style or Style()):
        output.check_free(other)
        output.check_unnamed(other)
    write_whole(held, target, style, overwrite=output.force)


def check_asset_place(target: Path, form: str | None, output: Output) -> None:
    """Refuse a place for a `.triasset` of this form. Of a folder that is there only an asset is replaced."""
    from msb.asset.writer import check_asset_folder

    if form == "folder" and is_folder(target):
        output.check_folder(target, check_asset_folder)
    else:
        output.check_free(target, folder=form == "folder")


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

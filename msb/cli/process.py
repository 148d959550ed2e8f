"""Run a command: prepare streams and signals, and turn exceptions into a line of text and an exit status."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import re
import signal
import sys
import threading
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.base.atomic import DISK_ERRORS
from msb.cli.output import log, report_error, say, silence
from msb.errors import EXIT_INTERRUPTED, EXIT_OK, MsbError, OutputError, UsageError, shorten

if TYPE_CHECKING:
    import typer

# Exit status of a bug in this program: EX_SOFTWARE of sysexits.h.
_INTERNAL = 70
# Packages of this project. An installation can leave out some packages.
_OURS = {"msb", "msb_viewers"}
_NOT_READABLE = {errno.EACCES, errno.EPERM, errno.ENAMETOOLONG}


def run(app: typer.Typer, name: str) -> int:
    """Run `app` on the arguments of this process and return the exit status.

    Errors go to standard error as a line ``CODE: FILE: message``, with a traceback only if ``--debug`` is
    given.
    """
    _open_closed_streams()
    with _ending_on_signals():
        return _run(app, name)


def _run(app: typer.Typer, name: str) -> int:
    debug = "--debug" in sys.argv
    for stream in (sys.stdout, sys.stderr):
        # File names can contain bytes that are not text, and terminals can lack characters.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        from typer.main import get_command

        command = get_command(app)
        if _is_completing():
            # Typer calls this function only for its two completion options, which are off, and does not
            # export it.
            from typer.completion import completion_init  # type: ignore[attr-defined]

            completion_init()
        status = command(prog_name=name, standalone_mode=False)
        sys.stdout.flush()
        return status if isinstance(status, int) else EXIT_OK
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except (BrokenPipeError, SystemExit) as error:
        # The program that reads the pipe has ended, as in `| head`. A closed pipe is not an error. Typer and
        # rich would exit with status 1.
        if not isinstance(error.__context__ if isinstance(error, SystemExit) else error, BrokenPipeError):
            raise
        silence(sys.stdout)
        return EXIT_OK
    except Exception as error:
        if (status := _interruption(error)) is not None:
            return status
        if debug:
            traceback.print_exc()
        log(traceback.format_exc(), "DEBUG")
        failure = _output_error(error) or _as_msb_error(error, name)
        return _INTERNAL if failure is None else report_error(failure)


def _interruption(error: BaseException) -> int | None:
    """Return the exit status of the interruption that led to `error`, or None without an interruption.

    After an interruption, closing a file can raise another error, for example about an incomplete archive.
    The other error then replaces the interruption.
    """
    before = error.__context__
    while before is not None:
        if isinstance(before, KeyboardInterrupt):
            return EXIT_INTERRUPTED
        if isinstance(before, SystemExit) and isinstance(before.code, int) and before.code > 128:
            return before.code
        before = before.__context__
    return None


@contextlib.contextmanager
def _ending_on_signals() -> Iterator[None]:
    """Raise an exception on SIGTERM and SIGHUP, so that temporary files are removed.

    Signals that already have a handler keep this handler.
    """

    def end(number: int, _frame: object) -> None:
        raise SystemExit(128 + number)  # the exit status that shells report for a signal

    taken = []
    if threading.current_thread() is threading.main_thread():
        # Windows has no SIGHUP.
        numbers = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
        taken = [number for number in numbers if signal.getsignal(number) == signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


def _open_closed_streams() -> None:
    """Open the null device for closed standard streams.

    Without this step, the next opened file would become a standard stream.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115 - never closed


def _output_error(error: Exception) -> OutputError | None:
    """Return the error to report if writing to standard output raised `error`, otherwise None.

    The function ignores errors of other files: such errors contain a file name, or are errors of msb.
    """
    if not isinstance(error, OSError) or error.filename is not None or error.errno not in DISK_ERRORS:
        return None
    silence(sys.stdout)  # writing the stream's buffer would fail again
    text = f"the output cannot be written: {error.strerror}"
    return OutputError("OUTPUT_UNWRITABLE", text, file="standard output or a temporary file")


def _is_completing() -> bool:
    """Return whether this process was started by the script of `msb completion`."""
    return any(key.startswith("_MSB") and key.endswith("_COMPLETE") for key in os.environ)


def _as_msb_error(error: Exception, name: str) -> MsbError | None:
    if isinstance(error, MsbError):
        return error
    if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in _OURS:
        text = f"this command needs {error.name}, which is not part of this installation"
        return UsageError("EXTRA_MISSING", text)
    if hasattr(error, "format_message"):  # usage errors that typer raises
        return UsageError("USAGE", _usage_text(error, name))
    if isinstance(error, OSError) and error.filename is not None and error.errno in _NOT_READABLE:
        # For example, Path.exists can raise this error for an input path. Errors of outputs are instances of
        # MsbError.
        from msb.base.files import open_error

        return open_error(error, error.filename)
    if isinstance(error, MemoryError):
        say("OUT_OF_MEMORY: this machine does not have enough memory for this input")
        return None
    text = f"{type(error).__name__}: {shorten(str(error), 200)}"
    say(f"INTERNAL: {text}; this is a bug in msb, --debug shows where")
    return None


def _value_of(option: str) -> str:
    """Return the value of `option` on the command line with a colon before it, such as ":0.5" or ":exact"."""
    words = [word for given in sys.argv[1:] for word in given.split("=", 1)]
    after = words[words.index(option) + 1 :][:1] if option in words else []
    return f":{after[0]}" if after and re.fullmatch(r"exact|[0-9.]+(e-?[0-9]+)?", after[0]) else ""


def _usage_text(error: Any, name: str) -> str:
    """Return the text of a usage error with the usage line. For an unknown option, the text suggests a
    similar option."""
    from msb.cli.command import plain_words

    text = plain_words(str(error.format_message()), error)
    if hasattr(error, "option_name") and getattr(error, "possibilities", None):
        import difflib

        (nearest,) = difflib.get_close_matches(error.option_name, error.possibilities, 1, 0.0)
        command = getattr(getattr(error, "ctx", None), "command", None)
        instead = getattr(getattr(command, "callback", None), "instead", {})
        if error.option_name in instead:
            nearest = instead[error.option_name].replace("{value}", _value_of(error.option_name))
        text = f"No such option: {error.option_name}; did you mean {nearest}?"
    context = getattr(error, "ctx", None)
    if context is None:
        return f"{shorten(text, 200)} (see {name} --help)"
    usage = " ".join(context.get_usage().split()).removeprefix("Usage: ")
    return f"{shorten(text, 200)} (usage: {usage}; see {context.command_path} --help)"

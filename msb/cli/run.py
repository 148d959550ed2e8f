"""From any exception to one line on standard error and an exit status."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import signal
import sys
import threading
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msb.cli.output import log, say, silence
from msb.errors import (
    EXIT_INTERRUPTED,
    EXIT_OK,
    EXIT_STATUS,
    InputError,
    MsbError,
    OutputError,
    UsageError,
    shorten,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    import typer

    from msb.cli.settings import Settings

_INTERNAL = 70
"""EX_SOFTWARE: a bug of ours, told apart from everything a user can cause."""
_DISK_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}


def run(app: typer.Typer, name: str) -> int:
    """Run `app` on the process's arguments and return the exit status.

    Errors end up on standard error as ``CODE: FILE: what is wrong ...``; a traceback appears only with
    ``--debug``.
    """
    _open_closed_streams()
    with _ending_on_signals():
        return _run(app, name)


def _run(app: typer.Typer, name: str) -> int:
    debug = "--debug" in sys.argv
    for stream in (sys.stdout, sys.stderr):
        # A file name need not be text, and a terminal need not know every character.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    settings: Settings = {}
    try:
        from typer.main import get_command

        command = get_command(app)
        settings = _settings(command, name)
        values = {each: {k: v.value for k, v in found.items()} for each, found in settings.items()}
        own = values if hasattr(command, "commands") else values.get(name, {})
        status = command(prog_name=name, standalone_mode=False, default_map=own)
        sys.stdout.flush()
        return status if isinstance(status, int) else EXIT_OK
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except (BrokenPipeError, SystemExit) as error:
        # The reader of a pipe left (say, `| head`): not an error. typer and rich end with status 1 then.
        if not isinstance(error.__context__ if isinstance(error, SystemExit) else error, BrokenPipeError):
            raise
        silence(sys.stdout)
        return EXIT_OK
    except Exception as error:
        if debug:
            traceback.print_exc()
        log(traceback.format_exc(), "DEBUG")
        return report(_output_error(error) or _as_msb_error(error, name, settings))


@contextlib.contextmanager
def _ending_on_signals() -> Iterator[None]:
    """Remove temporary files when asked to end, too; a signal that is ignored (nohup) or handled stays so."""

    def end(number: int, _frame: object) -> None:
        raise SystemExit(128 + number)  # the shell's status for it

    taken = []
    if threading.current_thread() is threading.main_thread():
        # There is no SIGHUP on Windows.
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
    """Let standard streams that are closed lead nowhere: a file opened later would take their number."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115 - for good


def _output_error(error: Exception) -> OutputError | None:
    """Return what to say if `error` is that standard output cannot be written.

    It is told by what it is not: of a file to be written `msb.atomic` would have said so, and what fails to
    open has a name.
    """
    if not isinstance(error, OSError) or error.filename is not None or error.errno not in _DISK_ERRORS:
        return None
    silence(sys.stdout)  # what it still holds would fail again
    text = f"it cannot be written: {error.strerror}"
    return OutputError("OUTPUT_UNWRITABLE", text, file="standard output or a temporary file")


def _settings(command: Any, name: str) -> Settings:
    """Return what files and environment set; msb-audit has the settings of msb audit."""
    from msb.cli import settings

    completing = any(key.endswith("_COMPLETE") for key in os.environ)
    if completing or not settings.anything_set():
        return {}
    if hasattr(command, "commands"):
        return settings.read_settings(settings.single_commands(command))
    from typer.main import get_command

    from msb.cli.app import app

    found = settings.read_settings(settings.single_commands(get_command(app)))
    return {name: found[name.removeprefix("msb-")]}


def report(error: MsbError | None) -> int:
    """Print `error` as one line on standard error and return its exit status."""
    if error is None:
        return _INTERNAL
    say(str(error))
    return EXIT_STATUS[type(error)]


@contextlib.contextmanager
def about(path: object) -> Iterator[None]:
    """Give errors about arrays, which know no file, the name of the file the arrays came from."""
    try:
        yield
    except MsbError as error:
        if error.file is not None:
            raise
        where = {"pointer": error.pointer, "value": error.value, "limit": error.limit}
        raise type(error)(error.code, error.message, file=path, **where) from error


def _as_msb_error(error: Exception, name: str, settings: Settings) -> MsbError | None:
    if isinstance(error, MsbError):
        return error
    if hasattr(error, "format_message"):  # the command-line library's own usage errors
        return UsageError("USAGE", _usage_text(error, name, settings))
    if isinstance(error, PermissionError) and error.filename is not None:
        # Looking whether there is a file raises it, too. What is written has its own error: `msb.atomic`.
        text = f"it cannot be read: {error.strerror}"
        return InputError("FILE_UNREADABLE", text, file=error.filename)
    if isinstance(error, MemoryError):
        say("OUT_OF_MEMORY: there is not enough memory for this input")
        return None
    text = f"{type(error).__name__}: {shorten(str(error), 200)}"
    say(f"INTERNAL: {text}; this is a bug of ours, --debug shows where")
    return None


def _usage_text(error: Any, name: str, settings: Settings) -> str:
    """Return what is wrong, the option that was meant or the file that set it, and the usage."""
    text = str(error.format_message()).rstrip(".")
    if getattr(error, "possibilities", None):
        text = f"No such option: {error.option_name}; did you mean {_nearest(error)}?"
    context, param = getattr(error, "ctx", None), getattr(error, "param", None)
    if context is None:
        return f"{shorten(text, 200)} (see {name} --help)"
    if param is not None:
        setting = settings.get(context.info_name, {}).get(param.name)
        from_setting = getattr(context.get_parameter_source(param.name), "name", "") == "DEFAULT_MAP"
        text += f", set by {setting.source}" if setting and from_setting else ""
    usage = " ".join(context.get_usage().split()).removeprefix("Usage: ")
    return f"{shorten(text, 200)} (usage: {usage}; see {context.command_path} --help)"


def _nearest(error: Any) -> str:
    import difflib

    return str(difflib.get_close_matches(error.option_name, error.possibilities, 1, 0.0)[0])

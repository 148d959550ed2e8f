"""From any exception to one line on standard error and an exit status."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import traceback
from typing import TYPE_CHECKING, Any

from msb.cli.output import log, say
from msb.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_STATUS, MsbError, UsageError, shorten

if TYPE_CHECKING:
    from collections.abc import Iterator

    import typer

    from msb.cli.settings import Settings

_INTERNAL = 70
"""EX_SOFTWARE: a bug of ours, told apart from everything a user can cause."""


def run(app: typer.Typer, name: str) -> int:
    """Run `app` on the process's arguments and return the exit status.

    Errors end up on standard error as ``CODE: FILE: what is wrong ...``; a traceback appears only with
    ``--debug``.
    """
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
    except BrokenPipeError:
        # The reader of a pipe left (say, `| head`): not an error, and no message from the interpreter's
        # own flush at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return EXIT_OK
    except Exception as error:
        if debug:
            traceback.print_exc()
        log(traceback.format_exc(), "DEBUG")
        return report(_as_msb_error(error, name, settings))


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

"""From any exception to one line on standard error and an exit status."""

from __future__ import annotations

import contextlib
import io
import os
import sys
import traceback
from typing import TYPE_CHECKING

from msb.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_STATUS, MsbError, UsageError, shorten

if TYPE_CHECKING:
    from collections.abc import Iterator

    import typer

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
    try:
        status = app(prog_name=name, standalone_mode=False)
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
        return report(_as_msb_error(error, name))


def report(error: MsbError | None) -> int:
    """Print `error` as one line on standard error and return its exit status."""
    if error is None:
        return _INTERNAL
    print(error, file=sys.stderr)  # noqa: T201 - the one place errors are printed
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


def _as_msb_error(error: Exception, name: str) -> MsbError | None:
    if isinstance(error, MsbError):
        return error
    if hasattr(error, "format_message"):  # the command-line library's own usage errors
        text = shorten(str(error.format_message()), 200)
        return UsageError("USAGE", f"{text} (see {name} --help)")
    if isinstance(error, MemoryError):
        print("OUT_OF_MEMORY: there is not enough memory for this input", file=sys.stderr)  # noqa: T201
        return None
    text = f"{type(error).__name__}: {shorten(str(error), 200)}"
    print(f"INTERNAL: {text}; this is a bug of ours, --debug shows where", file=sys.stderr)  # noqa: T201
    return None

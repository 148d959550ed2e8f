"""Errors as commands meet them: said in one line with an exit status, and given the file they are about."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from msb.cli.output import say
from msb.errors import EXIT_STATUS, MsbError

if TYPE_CHECKING:
    from collections.abc import Iterator


def report_error(error: MsbError) -> int:
    """Print `error` as one line on standard error and return its exit status."""
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

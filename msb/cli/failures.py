"""Report errors of commands in one line, and determine the exit status."""

from __future__ import annotations

from msb.cli.output import say
from msb.errors import EXIT_STATUS, MsbError


def report_error(error: MsbError) -> int:
    """Print `error` as one line on standard error and return its exit status."""
    say(str(error))
    return EXIT_STATUS[type(error)]

"""The command line, in this process and in one of its own."""

from tests.cli.conftest import here, msb

__all__ = ["here", "msb"]

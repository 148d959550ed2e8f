"""The command line, in this process and in one of its own."""

from tests.cli.conftest import here, msb, refused

__all__ = ["here", "msb", "refused"]

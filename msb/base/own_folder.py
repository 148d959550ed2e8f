"""Folders that a command writes whole: of one that is there only what it wrote itself is replaced."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from msb.base.atomic import is_stream
from msb.errors import OutputError, UsageError, shorten


def check_own_folder(folder: Path, maker: str, others: Callable[[list[str]], Iterable[str]]) -> bool:
    """Return whether a folder can be written without any replacement: it is empty, or there is none.

    `others` returns those of the sorted names in it that no `maker` wrote.

    Raises
    ------
    UsageError
        OUTPUT_EXISTS: it is a file, or holds what no `maker` wrote.
    OutputError
        OUTPUT_UNWRITABLE: it cannot be read.
    """
    if not os.path.lexists(folder) or is_stream(folder):
        return True
    if not folder.is_dir():
        raise UsageError("OUTPUT_EXISTS", "it is a file; give a folder", file=folder)
    try:
        names = sorted(path.name for path in folder.iterdir())
    except OSError as error:
        raise OutputError("OUTPUT_UNWRITABLE", f"it cannot be read: {error.strerror}", file=folder) from error
    if (other := next(iter(others(names)), None)) is not None:
        text = f"it holds {shorten(other, 60)}, which no {maker} wrote and which would be lost"
        raise UsageError("OUTPUT_EXISTS", f"{text}; give another folder", file=folder)
    return not names

"""What a fuzz target is: a file of hostile bytes at a place, and the reader that is given it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from msb.errors import MsbError

LONGEST = 1 << 14
"""Bytes of a seed; longer ones slow the search down and seldom lead to other code."""


@dataclass(frozen=True)
class Target:
    """One reader.

    Attributes
    ----------
    read : callable
        Given the path of the file; what it returns counts for nothing.
    seeds : callable
        Return contents to start from, good and bad.
    file : str
        Where the hostile file lies below the target's own folder; its suffix may say what it is.
    wrap : callable, optional
        What becomes of the bytes before they are written: an archive around them with the right checksums.
    beside : mapping
        Good files that the reader needs besides, path below the folder -> content.
    """

    read: Callable[[Path], Any]
    seeds: Callable[[], Iterable[bytes]]
    file: str
    wrap: Callable[[bytes], bytes] = bytes
    beside: Mapping[str, bytes] = field(default_factory=dict)

    def small_seeds(self) -> list[bytes]:
        """Return the seeds of at most `LONGEST` bytes, each once, in their order."""
        return [seed for seed in dict.fromkeys(self.seeds()) if len(seed) <= LONGEST]

    def at(self, folder: Path) -> Callable[[bytes], MsbError | None]:
        """Return the function to fuzz, which keeps its files below the empty folder `folder`.

        It returns the error of a reader that refuses with one clear line, None of one that gives a value; all
        else is a finding, and raised.
        """
        path = folder / self.file
        path.parent.mkdir(parents=True, exist_ok=True)
        for name, content in self.beside.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)

        def feed(data: bytes) -> MsbError | None:
            # A new file each time: a reader may still map the old one.
            with contextlib.suppress(FileNotFoundError):
                path.unlink()
            path.write_bytes(self.wrap(data))
            try:
                self.read(path)
            except MsbError as error:
                check_line(error)
                return error
            return None

        return feed


def check_line(error: MsbError) -> None:
    """Hold an error to what is promised of all: a registered code, one printable line, not endless."""
    line = str(error)
    assert error.code in error.codes, error.code
    assert line.isprintable(), f"{error.code}: not printable"
    assert len(error.message) < 1000, f"{error.code}: {len(error.message)} characters"

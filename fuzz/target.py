"""A fuzz target: a file of hostile bytes, and the reader of its path."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from msb.errors import MsbError

LONGEST = 1 << 14
"""Maximum size of a seed in bytes. Longer seeds slow the search down and rarely reach other code."""


@dataclass(frozen=True)
class Target:
    """One reader.

    Attributes
    ----------
    read : callable
        Takes the path of the file; its return value is ignored.
    seeds : callable
        Return valid and broken contents.
    file : str
        Path of the hostile file below the target's folder; its suffix may select the format.
    wrap : callable, optional
        Transforms the bytes before they are written, for example into an archive with correct checksums.
    beside : mapping
        The contents of other valid files that the reader needs, by their paths below the folder.
    """

    read: Callable[[Path], Any]
    seeds: Callable[[], Iterable[bytes]]
    file: str
    wrap: Callable[[bytes], bytes] = bytes
    beside: Mapping[str, bytes] = field(default_factory=dict)

    def small_seeds(self) -> list[bytes]:
        """Return the distinct seeds of at most `LONGEST` bytes, in order."""
        return [seed for seed in dict.fromkeys(self.seeds()) if len(seed) <= LONGEST]

    def at(self, folder: Path) -> Callable[[bytes], MsbError | None]:
        """Return the function to fuzz, which writes its files below the empty folder `folder`.

        It returns the reader's error if the file is rejected with a clear line, and None if the file is read.
        Anything else is a finding and is raised.
        """
        path = folder / self.file
        path.parent.mkdir(parents=True, exist_ok=True)
        for name, content in self.beside.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)

        def feed(data: bytes) -> MsbError | None:
            # Use a new file each time, because a reader may still map the old one.
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
    """Check that an error has a registered code, and a message of one printable line of limited length."""
    line = str(error)
    assert error.code in error.codes, error.code
    assert line.isprintable(), f"{error.code}: not printable"
    assert len(error.message) < 1000, f"{error.code}: {len(error.message)} characters"

"""A file of cameras, opened without trust, and how errors about it are worded."""

from __future__ import annotations

import contextlib
import mmap
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from msb.base.files import map_file
from msb.errors import SceneError


@dataclass(frozen=True)
class Source:
    """A file, as it was given, and its bytes: a mapping costs no memory until it is read."""

    path: Path
    data: bytes | mmap.mmap

    @classmethod
    def open(cls, path: Path) -> Source:
        """Map the regular file at `path`; a pipe or device is never opened."""
        return cls(path, map_file(path))

    def error(self, code: str, message: str, *, pointer: str | None = None) -> SceneError:
        """Return the error about this file; a `pointer` opens the message."""
        text = f"{pointer}: {message}" if pointer else message
        return SceneError(code, text, file=self.path, pointer=pointer)

    @contextlib.contextmanager
    def locating(self, pointer: str | None, what: str = "") -> Iterator[None]:
        """Add this file, `pointer` and `what` is read there to an error that names no file yet.

        `Camera` and its checks raise such errors, because they know values but not their source.
        """
        try:
            yield
        except SceneError as error:
            if error.file is not None:
                raise
            message = f"{what}: {error.message}" if what else error.message
            located = self.error(error.code, message, pointer=pointer)
            raise located from None

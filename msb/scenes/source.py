"""An untrusted file of cameras, and errors about it."""

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
    """A camera file: its path as the user gave it, and its bytes.

    A memory mapping uses no memory until it is read.
    """

    path: Path
    data: bytes | mmap.mmap

    @classmethod
    def open(cls, path: Path) -> Source:
        """Map the regular file at `path`. Pipes and devices are never opened."""
        return cls(path, map_file(path))

    def error(self, code: str, message: str, *, pointer: str | None = None) -> SceneError:
        """Return an error about this file. If `pointer` is given, the message begins with `pointer`."""
        text = f"{pointer}: {message}" if pointer else message
        return SceneError(code, text, file=self.path, pointer=pointer)

    @contextlib.contextmanager
    def locating(self, pointer: str | None, what: str = "") -> Iterator[None]:
        """If an error names no file, add the path of this file, `pointer` and `what`.

        For example, errors of the class `Camera` name no file.
        """
        try:
            yield
        except SceneError as error:
            if error.file is not None:
                raise
            message = f"{what}: {error.message}" if what else error.message
            located = self.error(error.code, message, pointer=pointer)
            raise located from None

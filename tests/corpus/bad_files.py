"""Paths behind which there is no asset, and packed assets cut short."""

from __future__ import annotations

import gzip
import io
import os
import struct
import tarfile
from typing import TYPE_CHECKING

from tests.corpus.bad_zips import from_bytes, good_entries
from tests.corpus.case import Case
from tests.corpus.forge import forge
from tests.corpus.good import mesh, parts

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


def _tar() -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        for entry in good_entries():
            info = tarfile.TarInfo(entry.name)
            info.size = len(entry.data)
            archive.addfile(info, io.BytesIO(entry.data))
    return stream.getvalue()


_STRANGERS: list[tuple[str, str, Callable[[], bytes]]] = [
    ("zero_bytes", "an empty file", lambda: b""),
    ("one_byte", "one byte", lambda: b"P"),
    ("three_bytes", "the first three bytes of a ZIP", lambda: b"PK\x03"),
    ("text", "a text file", lambda: b"this is no asset\n"),
    ("manifest_alone", "a manifest without its container", lambda: parts(mesh()).text()),
    ("gzip", "a gzip of an asset", lambda: gzip.compress(forge(good_entries()), mtime=0)),
    ("tar", "a tar of an asset", _tar),
    ("zeros", "64 kB of zeros", lambda: bytes(1 << 16)),
    ("glb", "a GLB", lambda: struct.pack("<4s2I", b"glTF", 2, 12)),
]

# What is left of the file, and how much of it.
_CUTS: list[tuple[str, str, Callable[[bytes], int]]] = [
    ("signature", "the first four bytes", lambda _: 4),
    ("local_header", "the first local header", lambda _: 30),
    ("half", "the first half", lambda z: len(z) // 2),
    ("members", "all members, no directory", lambda z: z.index(b"PK\x01\x02")),
    ("directory", "a directory cut in two", lambda z: z.rindex(b"PK\x01\x02")),
    ("end", "everything but the end record", lambda z: len(z) - 22),
    ("end_half", "half of the end record", lambda z: len(z) - 11),
    ("last_byte", "everything but the last byte", lambda z: len(z) - 1),
]


def _cut(name: str, title: str, length: Callable[[bytes], int]) -> Case:
    def make() -> bytes:
        data = forge(good_entries())
        return data[: length(data)]

    return from_bytes(f"cut_{name}", title, "TRIASSET_ZIP_TRUNCATED", make)


def _nothing(path: Path) -> None:
    """Write nothing."""


def _denied(path: Path) -> None:
    path.write_bytes(forge(good_entries()))
    path.chmod(0)


CASES = [
    *(from_bytes(f"not_zip_{name}", title, "FILE_NOT_RECOGNISED", make) for name, title, make in _STRANGERS),
    *(_cut(name, title, length) for name, title, length in _CUTS),
    Case("not_there", "nothing at all", "FILE_NOT_FOUND", _nothing),
    Case("not_there_link", "a link to nothing", "FILE_NOT_FOUND", lambda path: path.symlink_to("nothing")),
    Case("not_there_loop", "a link to itself", "FILE_UNREADABLE", lambda path: path.symlink_to(path.name)),
    Case("not_file_pipe", "a pipe that would block for ever", "FILE_UNREADABLE", os.mkfifo),
    Case("denied_file", "a file we may not read", "FILE_UNREADABLE", _denied, denied=True),
]

"""Paths behind which there is no asset, and packed assets cut short."""

from __future__ import annotations

import gzip
import io
import os
import struct
import tarfile
from collections.abc import Callable
from pathlib import Path

from tests.corpus.bad_zips import from_bytes, good_entries
from tests.corpus.case import Case
from tests.corpus.forge import forge
from tests.corpus.good import mesh, parts


def _tar() -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        for entry in good_entries():
            info = tarfile.TarInfo(entry.name)
            info.size = len(entry.data)
            archive.addfile(info, io.BytesIO(entry.data))
    return stream.getvalue()


_STRANGERS: list[tuple[str, str, Callable[[], bytes]]] = [
    ("zero_bytes", lambda: b""),
    ("one_byte", lambda: b"P"),
    ("three_bytes", lambda: b"PK\x03"),
    ("text", lambda: b"this is no asset\n"),
    ("manifest_alone", lambda: parts(mesh()).text()),
    ("gzip", lambda: gzip.compress(forge(good_entries()), mtime=0)),
    ("tar", _tar),
    ("zeros", lambda: bytes(1 << 16)),
    ("glb", lambda: struct.pack("<4s2I", b"glTF", 2, 12)),
]

# What is left of the file, and how much of it.
_CUTS: list[tuple[str, str, Callable[[bytes], int]]] = [
    ("signature", lambda _: 4),
    ("local_header", lambda _: 30),
    ("half", lambda z: len(z) // 2),
    ("members", lambda z: z.index(b"PK\x01\x02")),
    ("directory", lambda z: z.rindex(b"PK\x01\x02")),
    ("end", lambda z: len(z) - 22),
    ("end_half", lambda z: len(z) - 11),
    ("last_byte", lambda z: len(z) - 1),
]


def _cut(name: str, length: Callable[[bytes], int]) -> Case:
    def make() -> bytes:
        data = forge(good_entries())
        return data[: length(data)]

    return from_bytes(f"cut_{name}", "TRIASSET_DAMAGED", make)


def _nothing(path: Path) -> None:
    """Write nothing."""


def _denied(path: Path) -> None:
    path.write_bytes(forge(good_entries()))
    path.chmod(0)


CASES = [
    *(from_bytes(f"not_zip_{name}", "FILE_NOT_RECOGNISED", make) for name, make in _STRANGERS),
    *(_cut(name, length) for name, length in _CUTS),
    Case("not_there", "FILE_NOT_FOUND", _nothing),
    Case("not_there_link", "FILE_NOT_FOUND", lambda path: path.symlink_to("nothing")),
    Case("not_there_loop", "FILE_UNREADABLE", lambda path: path.symlink_to(path.name)),
    Case("not_file_pipe", "FILE_UNREADABLE", os.mkfifo),
    Case("denied_file", "FILE_UNREADABLE", _denied, denied=True),
]

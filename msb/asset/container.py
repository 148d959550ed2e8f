"""The two forms of an asset behind one interface: names, sizes and mapped bytes."""

from __future__ import annotations

import itertools
import mmap
import os
import stat
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from msb.asset.manifest import ASSET_SUFFIX, MANIFEST_NAME
from msb.asset.packed import parse_packed
from msb.asset.paths import map_member
from msb.asset.strict_json import MAX_BYTES
from msb.base.files import map_file, open_error
from msb.base.paths import given_path
from msb.errors import AssetError, Finding, InputError, finding, shorten

if TYPE_CHECKING:
    from msb.asset.strict_zip import Member

_CRC_CHUNK = 1 << 24
_MAX_LISTED = 1000


class Container(Protocol):
    """What a reader needs of either form. The methods of both classes are documented here."""

    path: Path
    form: str

    def manifest_bytes(self) -> bytes:
        """Return the bytes of manifest.json, of which at most one byte more than the size limit is read."""

    def file_size(self, file: str) -> int:
        """Return the size in bytes of the buffer file `file`."""

    def map(self, file: str) -> tuple[memoryview, int]:
        """Return mapped bytes and the offset in them at which `file` starts."""

    def undeclared(self, declared: set[str]) -> list[Finding]:
        """Return a finding for each file in the asset that is not `declared`."""

    def check_bytes(self) -> list[Finding]:
        """Return findings about the container's own checksums; this reads the whole asset."""


class PackedContainer:
    """A single file."""

    form = "packed"

    def __init__(self, path: Path, data: mmap.mmap | bytes) -> None:
        self.path = path
        self._view = memoryview(data)
        self._members = parse_packed(data, file=path)

    def _member(self, name: str) -> Member:
        if name in self._members:
            return self._members[name]
        code = "TRIASSET_MANIFEST_MISSING" if name == MANIFEST_NAME else "TRIASSET_DAMAGED"
        raise AssetError(code, f"there is no {name} in it", file=self.path, pointer=name)

    def manifest_bytes(self) -> bytes:
        member = self._member(MANIFEST_NAME)
        start = member.offset
        return bytes(self._view[start : start + min(member.size, MAX_BYTES + 1)])

    def file_size(self, file: str) -> int:
        return self._member(file).size

    def map(self, file: str) -> tuple[memoryview, int]:
        return self._view, self._member(file).offset

    def undeclared(self, declared: set[str]) -> list[Finding]:
        return [
            finding("TRIASSET_FILE_UNDECLARED", f"{name} is in the ZIP but no buffer declares it", file=name)
            for name in self._members
            if name not in declared and name != MANIFEST_NAME
        ]

    def check_bytes(self) -> list[Finding]:
        found = []
        for member in self._members.values():
            crc = 0
            end = member.offset + member.size
            for start in range(member.offset, end, _CRC_CHUNK):
                crc = zlib.crc32(self._view[start : min(end, start + _CRC_CHUNK)], crc)
            if crc != member.crc:
                text = f"{member.name} has CRC-32 {crc:08x}; the ZIP says {member.crc:08x}"
                found.append(
                    finding("TRIASSET_DAMAGED", text, file=member.name, pointer=f"byte {member.offset}")
                )
        return found


class FolderContainer:
    """A folder `NAME.triasset` with manifest.json and buffers/*.bin."""

    form = "folder"

    def __init__(self, path: Path) -> None:
        self.path = path
        self._maps: dict[str, memoryview] = {}
        self._link_counts: dict[str, int] = {}

    def manifest_bytes(self) -> bytes:
        return bytes(self.map(MANIFEST_NAME)[0][: MAX_BYTES + 1])

    def file_size(self, file: str) -> int:
        return len(self.map(file)[0])

    def map(self, file: str) -> tuple[memoryview, int]:
        if file not in self._maps:
            if file != MANIFEST_NAME and stat.S_ISLNK(_mode(self.path / "buffers")):
                raise AssetError(
                    "TRIASSET_PATH", "buffers is a symbolic link", file=self.path, pointer="buffers"
                )
            data, status = map_member(self.path / file, file, asset=self.path)
            self._maps[file] = memoryview(data)
            self._link_counts[file] = status.st_nlink
        return self._maps[file], 0

    def undeclared(self, declared: set[str]) -> list[Finding]:
        """Return a warning for each stray file, because file managers leave such files behind."""
        names: list[str] = []
        found: list[Finding] = []
        for folder, prefix in ((self.path, ""), (self.path / "buffers", "buffers/")):
            if prefix and not stat.S_ISDIR(_mode(folder)):
                continue  # what should be in it is missing or behind a link: findings of their own
            try:
                with os.scandir(folder) as entries:
                    names += [prefix + entry.name for entry in itertools.islice(entries, _MAX_LISTED)]
            except OSError as error:
                text = f"{prefix or 'the folder'} cannot be listed: {error.strerror}"
                found.append(finding("TRIASSET_FILE_UNREADABLE", text, severity="warning"))
        found += [
            finding(
                "TRIASSET_FILE_UNDECLARED",
                f"{shorten(name)} is in the folder but no buffer declares it",
                severity="warning",
                file=shorten(name),
            )
            for name in sorted(names)
            if name not in declared and name not in (MANIFEST_NAME, "buffers")
        ]
        return found

    def check_bytes(self) -> list[Finding]:
        """Return a finding for each hard link; a folder has no checksums of its own."""
        return [
            finding(
                "TRIASSET_PATH",
                f"{file} has a second name outside or inside the folder",
                severity="warning",
                file=file,
            )
            for file, links in self._link_counts.items()
            if links > 1
        ]


def _mode(path: Path) -> int:
    """Return the file mode of `path` itself, 0 if there is nothing to be seen."""
    try:
        return path.lstat().st_mode
    except OSError:
        return 0


def is_asset(path: Path) -> bool:
    """Return whether `path` is, or claims to be, an asset of either form."""
    try:
        return path.suffix.lower() == ASSET_SUFFIX or (path.is_dir() and (path / MANIFEST_NAME).exists())
    except OSError as error:
        raise open_error(error, path) from error


def open_container(path: str | os.PathLike[str]) -> Container:
    """Open the asset at `path`, of either form, without reading any values."""
    path = given_path(path)
    try:
        is_folder = stat.S_ISDIR(path.stat().st_mode)
    except (OSError, ValueError) as error:
        raise open_error(error, path, "file or folder") from error
    if is_folder:
        return FolderContainer(path)
    data = map_file(path)
    if data[:4] not in (b"PK\x03\x04", b"PK\x05\x06"):
        tail = data[-(22 + 0xFFFF) :]
        if b"PK\x05\x06" in tail:
            text = "there is data before the first member; a packed asset starts with it"
            raise AssetError("TRIASSET_HOSTILE", text, file=path, pointer="byte 0")
        what = "it is empty" if not data else "it does not start like a packed asset (a ZIP)"
        raise InputError(
            "FILE_NOT_RECOGNISED", f"{what}; a .triasset is a ZIP or a folder with manifest.json", file=path
        )
    return PackedContainer(path, data)

"""An asset in packed form or in folder form, with a common interface for file names, sizes and mapped bytes.

The packed form is a ZIP of stored (uncompressed) members, which is mapped as a whole. Each member starts on
a 64-byte boundary. The archive is the strict subset of ZIP that docs/triasset.md describes and
`msb.asset.strict_zip` reads.
"""

import itertools
import mmap
import os
import re
import stat
import zlib
from pathlib import Path
from typing import NoReturn

from msb.asset.manifest import ALIGNMENT, ASSET_SUFFIX, MANIFEST_NAME
from msb.asset.strict_json import MAX_BYTES
from msb.asset.strict_zip import UTF8, Member, Policy, read_members
from msb.base.files import (
    POINTER,
    READ_ONLY,
    is_missing,
    is_pointer,
    map_descriptor,
    map_file,
    open_error,
    special_kind,
    system_reason,
)
from msb.base.paths import given_path
from msb.errors import AssetError, Finding, InputError, finding, shorten

# Number of bytes that are read at a time to compute a CRC-32.
_CRC_CHUNK = 1 << 24
# Maximum number of folder entries that are listed.
_MAX_LISTED = 1000
# Maximum length of an extra field in bytes. The padding to 64 bytes and a ZIP64 record need fewer bytes than
# this. A longer extra field might hide data.
_MAX_EXTRA = 128
_DOS_FOLDER = 0x10
_BUFFER_FILE = re.compile(r"buffers/[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}\.bin\Z")


class _Packed(Policy):
    """The rules for the archive of a packed asset. Errors name `file`."""

    # The members are manifest.json and up to 64 buffers, which a manifest can declare.
    max_members = 65

    def __init__(self, file: object) -> None:
        self.file = file

    def refuse(self, code: str, message: str, at: int) -> NoReturn:
        pointer = f"byte {at}"
        raise AssetError(f"TRIASSET_{code}", message, file=self.file, pointer=pointer)

    def name(self, raw: bytes, flags: int, at: int) -> str:
        text = raw.decode("utf-8" if flags & UTF8 else "cp437", "replace")
        is_member = text == MANIFEST_NAME or _BUFFER_FILE.match(text)
        if not is_member or text.encode() != raw:
            message = f'the member "{shorten(text)}" is neither {MANIFEST_NAME} nor buffers/NAME.bin'
            self.refuse("FORM", message, at)
        return text

    def same_name(self, name: str) -> str:
        return name.casefold()

    def check_entry(self, name: str, extra: int, attributes: int, at: int) -> None:
        """Reject members that a program would unpack as a link, a folder or a device."""
        if extra > _MAX_EXTRA:
            self.refuse("DAMAGED", f"{name} has {extra} bytes of extra data", at)
        kind = stat.S_IFMT(attributes >> 16)
        if kind == stat.S_IFLNK:
            self.refuse("PATH", f"{name} is a symbolic link", at)
        if kind not in (0, stat.S_IFREG) or attributes & _DOS_FOLDER:
            self.refuse("PATH", f"{name} is marked as a folder or device", at)

    def check_place(self, name: str, start: int, extra: int) -> None:
        if extra > _MAX_EXTRA:
            text = f"{name} has {extra} bytes of extra data"
            self.refuse("HOSTILE", text, start - extra)
        if start % ALIGNMENT:
            text = f"{name} starts at byte {start}; it must be a multiple of {ALIGNMENT}"
            self.refuse("FORM", text, start)


class PackedContainer:
    """An asset in a single file. The method docstrings also apply to `FolderContainer`."""

    def __init__(self, path: Path, data: mmap.mmap | bytes) -> None:
        self.path = path
        self._view = memoryview(data)
        self._members = read_members(data, _Packed(path))

    def _member(self, name: str) -> Member:
        if name in self._members:
            return self._members[name]
        code = "TRIASSET_MANIFEST_MISSING" if name == MANIFEST_NAME else "TRIASSET_DAMAGED"
        raise AssetError(code, f"it has no file {name}", file=self.path, pointer=name)

    def manifest_bytes(self) -> bytes:
        """Return the bytes of manifest.json, at most one byte more than the size limit."""
        member = self._member(MANIFEST_NAME)
        start = member.offset
        return bytes(self._view[start : start + min(member.size, MAX_BYTES + 1)])

    def file_size(self, file: str) -> int:
        """Return the size in bytes of the buffer file `file`."""
        return self._member(file).size

    def map(self, file: str) -> tuple[memoryview, int]:
        """Return mapped bytes that contain `file`, and the offset of `file` in these bytes."""
        return self._view, self._member(file).offset

    def undeclared(self, declared: set[str]) -> list[Finding]:
        """Return a finding for each file in the asset that is not `declared`."""
        return [
            finding(
                "TRIASSET_FILE_UNDECLARED", f"the ZIP contains {name}, which no buffer declares", file=name
            )
            for name in self._members
            if name not in declared and name != MANIFEST_NAME
        ]

    def check_bytes(self) -> list[Finding]:
        """Return findings about the checksums of the ZIP. This check reads the whole asset."""
        findings = []
        for member in self._members.values():
            crc = 0
            end = member.offset + member.size
            for start in range(member.offset, end, _CRC_CHUNK):
                crc = zlib.crc32(self._view[start : min(end, start + _CRC_CHUNK)], crc)
            if crc != member.crc:
                text = f"{member.name} has CRC-32 {crc:08x}, but {member.crc:08x} in the ZIP"
                findings.append(
                    finding("TRIASSET_DAMAGED", text, file=member.name, pointer=f"byte {member.offset}")
                )
        return findings


class FolderContainer:
    """A folder `NAME.triasset` with manifest.json and buffers/*.bin."""

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
            data, status = _map_member(self.path / file, file, asset=self.path)
            self._maps[file] = memoryview(data)
            self._link_counts[file] = status.st_nlink
        return self._maps[file], 0

    def undeclared(self, declared: set[str]) -> list[Finding]:
        """Return a warning for each undeclared file.

        An undeclared file is not an error, because file managers add files.
        """
        names: list[str] = []
        findings: list[Finding] = []
        for folder, prefix in ((self.path, ""), (self.path / "buffers", "buffers/")):
            if prefix and not stat.S_ISDIR(_mode(folder)):
                continue  # A missing folder or a link is reported by another check.
            try:
                with os.scandir(folder) as entries:
                    names += [prefix + entry.name for entry in itertools.islice(entries, _MAX_LISTED)]
            except OSError as error:
                text = f"{prefix or 'the folder'} cannot be listed: {error.strerror}"
                findings.append(finding("TRIASSET_FILE_UNREADABLE", text, severity="warning"))
        findings += [
            finding(
                "TRIASSET_FILE_UNDECLARED",
                f"the folder contains {shorten(name)}, which no buffer declares",
                severity="warning",
                file=shorten(name),
            )
            for name in sorted(names)
            if name not in declared and name not in (MANIFEST_NAME, "buffers")
        ]
        return findings

    def check_bytes(self) -> list[Finding]:
        """Return a warning for each hard link. A folder has no checksums, unlike a ZIP."""
        return [
            finding(
                "TRIASSET_PATH",
                f"{file} is a hard link: the same file has another name",
                severity="warning",
                file=file,
            )
            for file, links in self._link_counts.items()
            if links > 1
        ]


def _map_member(path: Path, member: str, *, asset: object) -> tuple[mmap.mmap | bytes, os.stat_result]:
    """Map the file at `path` read-only. The file is the member `member` of `asset`.

    Return the mapping and the file's status.

    Links, pipes, devices and folders are rejected before opening, and again after opening.
    """
    try:
        _reject_special(path.lstat(), asset, member)
        descriptor = _open_member(path, member)
        try:
            status = os.fstat(descriptor)
            _reject_special(status, asset, member)
            if is_pointer(descriptor):
                text = f"{member}: {POINTER}"
                raise AssetError("TRIASSET_FILE_UNREADABLE", text, file=asset, pointer=member)
            return map_descriptor(descriptor), status
        finally:
            os.close(descriptor)
    except (OSError, ValueError) as error:
        if is_missing(error):
            code = "TRIASSET_MANIFEST_MISSING" if member == MANIFEST_NAME else "TRIASSET_DAMAGED"
            raise AssetError(code, f"it has no file {member}", file=asset, pointer=member) from error
        text = f"{member} cannot be read: {system_reason(error)}"
        raise AssetError("TRIASSET_FILE_UNREADABLE", text, file=asset, pointer=member) from error


def _open_member(path: Path, member: str) -> int:
    """Return a descriptor of `path`.

    Links are never followed, even if another program creates a link during this call.
    """
    flags = READ_ONLY | getattr(os, "O_NOFOLLOW", 0)
    if "/" not in member or os.open not in os.supports_dir_fd:
        return os.open(path, flags)
    folder = os.open(path.parent, flags | os.O_DIRECTORY)
    try:
        return os.open(path.name, flags, dir_fd=folder)
    finally:
        os.close(folder)


def _reject_special(status: os.stat_result, asset: object, member: str) -> None:
    """Raise an error unless `status` describes a regular file."""
    if stat.S_ISLNK(status.st_mode):
        raise AssetError("TRIASSET_PATH", f"{member} is a symbolic link", file=asset, pointer=member)
    if kind := special_kind(status):
        text = f"{member} is {kind}; it must be a regular file"
        raise AssetError("TRIASSET_PATH", text, file=asset, pointer=member)


def _mode(path: Path) -> int:
    """Return the file mode of `path` without following links, or 0 if the file is not accessible."""
    try:
        return path.lstat().st_mode
    except OSError:
        return 0


Container = PackedContainer | FolderContainer


def is_asset(path: Path) -> bool:
    """Return whether `path` has the name of an asset, or is a folder with a manifest."""
    try:
        return path.suffix.lower() == ASSET_SUFFIX or (path.is_dir() and (path / MANIFEST_NAME).exists())
    except OSError as error:
        raise open_error(error, path) from error


def open_container(path: str | os.PathLike[str]) -> Container:
    """Open an asset of either form without reading values."""
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
            text = "it has data before its first member; a packed asset must start with a member"
            raise AssetError("TRIASSET_HOSTILE", text, file=path, pointer="byte 0")
        what = "it is empty" if not data else "it is not a packed asset (a ZIP)"
        raise InputError(
            "FILE_NOT_RECOGNISED", f"{what}; a .triasset is a ZIP or a folder with manifest.json", file=path
        )
    return PackedContainer(path, data)

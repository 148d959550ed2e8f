"""The packed form: a ZIP of stored members, each starting on a 64-byte boundary, mapped as a whole.

Only the strict subset of ZIP that `docs/triasset.md` describes is accepted: local headers tile the file from
byte 0, the central directory follows, then the end record, and nothing else is in the file. What the standard
library's reader tolerates (duplicate names, data before or between members, headers that contradict each
other) is how one file shows different content to different readers, so it is refused by name.
Record layouts: PKWARE APPNOTE 6.3.10, sections 4.3.7, 4.3.12, 4.3.14 to 4.3.16 and 4.5.3.
"""

from __future__ import annotations

import stat
import struct
from dataclasses import dataclass
from typing import Any, NoReturn

from msb.asset.manifest import ALIGNMENT, MANIFEST_NAME
from msb.asset.paths import is_member_name
from msb.asset.zip_records import (
    CENTRAL,
    DESCRIPTOR,
    ENCRYPTED,
    END,
    END64,
    EXTRA_ZIP64,
    FULL16,
    FULL32,
    LOCAL,
    LOCATOR,
)
from msb.errors import AssetError, shorten

MAX_MEMBERS = 65
"""manifest.json and the 64 buffers a manifest can declare."""
MAX_EXTRA = 128
"""Padding to 64 bytes plus one ZIP64 record need fewer; more could hide data."""

_DOS_FOLDER = 0x10
_EXTRA_NAME = 0x7075
"""Info-ZIP's Unicode path: some readers take the member's name from here."""


@dataclass(frozen=True)
class Member:
    """One stored member: its bytes are `data_offset : data_offset + size` of the file."""

    name: str
    crc: int
    size: int
    header_offset: int
    data_offset: int


class _Parser:
    """Parse one packed asset; every method raises `AssetError` naming the file and the byte."""

    def __init__(self, data: Any, size: int, file: object) -> None:
        self.data, self.size, self.file = data, size, file

    def refuse(self, code: str, message: str, at: int, value: Any = None, limit: Any = None) -> NoReturn:
        raise AssetError(code, message, file=self.file, pointer=f"byte {at}", value=value, limit=limit)

    def record(self, layout: struct.Struct, at: int, signature: bytes, what: str) -> tuple[Any, ...]:
        """Return the fields of the record at byte `at`, its signature checked and left out."""
        if at < 0 or at + layout.size > self.size:
            self.refuse("TRIASSET_ZIP_DIRECTORY", f"{what} at byte {at} does not fit into the file", at)
        found, *fields = layout.unpack_from(self.data, at)
        if found != signature:
            self.refuse("TRIASSET_ZIP_DIRECTORY", f"there is no {what} at byte {at}", at)
        return tuple(fields)

    def members(self) -> dict[str, Member]:
        """Return the members by name, in file order."""
        count, start, end = self.directory()
        if count > MAX_MEMBERS:
            self.refuse(
                "TRIASSET_ZIP_TOO_MANY_MEMBERS",
                f"the ZIP has {count} members; an asset has at most {MAX_MEMBERS}",
                start,
                count,
                MAX_MEMBERS,
            )
        found: list[Member] = []
        position = start
        for _ in range(count):
            member, position = self.central_entry(position, end)
            found.append(member)
        if position != end:
            self.refuse(
                "TRIASSET_ZIP_DIRECTORY",
                f"the central directory ends at byte {position}, its size says {end}",
                position,
            )
        self.check_names(found)
        found.sort(key=lambda member: member.header_offset)
        self.check_tiling(found, start)
        return {member.name: member for member in found}

    def directory(self) -> tuple[int, int, int]:
        """Return the number of entries, and where the central directory starts and ends."""
        at = self.size - END.size
        if at < 0 or self.data[at : at + 4] != b"PK\x05\x06":
            first = max(0, self.size - END.size - FULL16)
            found = self.data[first : self.size].rfind(b"PK\x05\x06")
            after = first + found + END.size
            if found >= 0 and after <= self.size:
                self.refuse("TRIASSET_ZIP_FOREIGN_DATA", "there is data after the end of the ZIP", after)
            self.refuse("TRIASSET_ZIP_TRUNCATED", "the ZIP's end record is missing: the file is cut off", at)
        disk, first_disk, here, count, length, start, comment = self.record(
            END, at, b"PK\x05\x06", "end record"
        )
        if comment:
            self.refuse("TRIASSET_ZIP_FOREIGN_DATA", f"the end record announces {comment} more bytes", at)
        end = at
        locator = at - LOCATOR.size
        if locator >= 0 and self.data[locator : locator + 4] == b"PK\x06\x07":
            plain = (here, count, length, start)
            here, count, length, start, end = self.end64(locator, plain)
        elif FULL16 in (here, count) or FULL32 in (length, start):
            self.refuse("TRIASSET_ZIP_ZIP64", "the end record needs a ZIP64 record that is missing", at)
        if disk or first_disk or here != count:
            self.refuse("TRIASSET_ZIP_DIRECTORY", "the ZIP is split over several files", at)
        if start + length != end:
            # A prefix (say, of a self-extracting program) shifts the directory from where it says it is.
            code = "TRIASSET_ZIP_FOREIGN_DATA" if start + length < end else "TRIASSET_ZIP_DIRECTORY"
            self.refuse(
                code, f"the central directory should end at byte {end}, but ends at {start + length}", at
            )
        return count, start, end

    def end64(self, locator: int, plain: tuple[int, int, int, int]) -> tuple[int, int, int, int, int]:
        _, at, disks = self.record(LOCATOR, locator, b"PK\x06\x07", "ZIP64 locator")
        if at != locator - END64.size or disks != 1:
            self.refuse("TRIASSET_ZIP_ZIP64", "the ZIP64 locator does not point just before itself", locator)
        size, *_, disk, first_disk, here, count, length, start = self.record(
            END64, at, b"PK\x06\x06", "ZIP64 end record"
        )
        if size != END64.size - 12 or disk or first_disk:
            self.refuse("TRIASSET_ZIP_ZIP64", "the ZIP64 end record is not well formed", at)
        for short, full, saturated in zip(
            plain, (here, count, length, start), (FULL16, FULL16, FULL32, FULL32), strict=True
        ):
            if short not in (full, saturated):
                self.refuse(
                    "TRIASSET_ZIP_ZIP64", f"the end records contradict each other: {short} and {full}", at
                )
        return here, count, length, start, at

    def central_entry(self, at: int, end: int) -> tuple[Member, int]:
        """Return the member whose central header is at byte `at`, and where the next header starts."""
        fields = self.record(CENTRAL, at, b"PK\x01\x02", "central header")
        _, _, flags, method, _, _, crc, packed, size, n_name, n_extra, n_comment, disk = fields[:13]
        attributes, header = fields[14:]
        after = at + CENTRAL.size + n_name + n_extra + n_comment
        if after > end:
            self.refuse("TRIASSET_ZIP_DIRECTORY", f"the central header at byte {at} runs over the end", at)
        name = self.name(at + CENTRAL.size, n_name, flags)
        if n_comment or disk or n_extra > MAX_EXTRA:
            self.refuse("TRIASSET_ZIP_DIRECTORY", f"{name}: comments and extra data are not allowed", at)
        if flags & ENCRYPTED:
            self.refuse("TRIASSET_ZIP_ENCRYPTED", f"{name} is encrypted", at)
        if method != 0:
            self.refuse("TRIASSET_ZIP_COMPRESSED", f"{name} is compressed (method {method}); store it", at)
        self.check_kind(name, attributes, at)
        extra = at + CENTRAL.size + n_name
        size, packed, header = self.sizes64(extra, n_extra, (size, packed, header), name)
        if packed != size:
            self.refuse("TRIASSET_ZIP_HEADER_MISMATCH", f"{name}: a stored member has one size, not two", at)
        return Member(name, crc, size, header, self.data_offset(name, flags, crc, size, header)), after

    def check_kind(self, name: str, attributes: int, at: int) -> None:
        """Refuse what some extractor would make a link, folder or device of, whatever system wrote it."""
        kind = stat.S_IFMT(attributes >> 16)
        if kind == stat.S_IFLNK:
            self.refuse("TRIASSET_PATH_LINK", f"{name} is a symbolic link", at)
        if kind not in (0, stat.S_IFREG) or attributes & _DOS_FOLDER:
            self.refuse("TRIASSET_PATH_NOT_FILE", f"{name} is marked as a folder or device", at)

    def data_offset(self, name: str, flags: int, crc: int, size: int, header: int) -> int:
        """Check the local header at byte `header` against the central one; return where the data starts."""
        fields = self.record(LOCAL, header, b"PK\x03\x04", "local header")
        _, local_flags, method, _, _, local_crc, packed, local_size, n_name, n_extra = fields
        start: int = header + LOCAL.size + n_name + n_extra
        if start + size > self.size:
            self.refuse("TRIASSET_ZIP_DIRECTORY", f"{name} runs over the end of the file", header)
        if flags & DESCRIPTOR or local_flags & DESCRIPTOR:
            self.refuse(
                "TRIASSET_ZIP_HEADER_MISMATCH", f"{name} keeps its sizes behind its data, not before", header
            )
        extra = header + LOCAL.size + n_name
        local_size, packed, _ = self.sizes64(extra, n_extra, (local_size, packed, 0), name)
        same_name = self.data[header + LOCAL.size : extra] == name.encode()
        if not same_name or (local_flags, method, local_crc, local_size, packed) != (
            flags,
            0,
            crc,
            size,
            size,
        ):
            self.refuse("TRIASSET_ZIP_HEADER_MISMATCH", f"{name}: local and central header disagree", header)
        if n_extra > MAX_EXTRA:
            self.refuse(
                "TRIASSET_ZIP_FOREIGN_DATA",
                f"{name} has {n_extra} bytes of extra data",
                extra,
                n_extra,
                MAX_EXTRA,
            )
        if start % ALIGNMENT:
            self.refuse(
                "TRIASSET_ZIP_MISALIGNED",
                f"{name} starts at byte {start}; it must be a multiple of {ALIGNMENT}",
                start,
                start,
                ALIGNMENT,
            )
        return start

    def name(self, at: int, length: int, flags: int) -> str:
        raw = bytes(self.data[at : at + length])
        text = raw.decode("utf-8" if flags & 0x0800 else "cp437", "replace")
        if not is_member_name(text) or text.encode() != raw:
            self.refuse(
                "TRIASSET_ZIP_NAME",
                f'the member "{shorten(text)}" is neither {MANIFEST_NAME} nor buffers/NAME.bin',
                at,
                shorten(text),
            )
        return text

    def sizes64(self, at: int, length: int, short: tuple[int, int, int], name: str) -> tuple[int, int, int]:
        """Return size, packed size and header offset, read from the ZIP64 extra where they do not fit.

        A second ZIP64 record, or values in it that no field asks for, would be read by some and not by
        others.
        """
        end, wanted = at + length, short.count(FULL32)
        wide: tuple[int, ...] | None = None
        while at + 4 <= end:
            kind, size = struct.unpack_from("<2H", self.data, at)
            if at + 4 + size > end:
                self.refuse("TRIASSET_ZIP_DIRECTORY", f"{name}: an extra record runs over its field", at)
            if kind == _EXTRA_NAME:
                self.refuse("TRIASSET_ZIP_NAME", f"{name} has a second name in its extra field", at)
            if kind == EXTRA_ZIP64:
                if wide is not None or size != 8 * wanted:
                    text = f"{name} has a ZIP64 record of {size} bytes where {8 * wanted} are needed"
                    self.refuse("TRIASSET_ZIP_ZIP64", text, at, size, 8 * wanted)
                wide = struct.unpack_from(f"<{wanted}Q", self.data, at + 4)
            at += 4 + size
        if wanted and wide is None:
            self.refuse("TRIASSET_ZIP_ZIP64", f"{name} needs a ZIP64 record and has none", at)
        values = iter(wide or ())
        size, packed, header = (next(values) if value == FULL32 else value for value in short)
        return size, packed, header

    def check_names(self, members: list[Member]) -> None:
        seen: dict[str, str] = {}
        for member in members:
            twin = seen.setdefault(member.name.casefold(), member.name)
            if twin is member.name:
                continue
            code = "TRIASSET_ZIP_DUPLICATE_MEMBER" if twin == member.name else "TRIASSET_PATH_DUPLICATE"
            self.refuse(code, f"{member.name} and {twin} are the same name", member.header_offset)

    def check_tiling(self, members: list[Member], directory: int) -> None:
        """Check that the members fill the file from byte 0 to the central directory."""
        position = 0
        for member in members:
            if member.header_offset < position:
                self.refuse(
                    "TRIASSET_ZIP_DIRECTORY", f"{member.name} overlaps the member before it", position
                )
            if member.header_offset > position:
                self.refuse(
                    "TRIASSET_ZIP_FOREIGN_DATA",
                    f"bytes {position} to {member.header_offset} belong to no member",
                    position,
                )
            position = member.data_offset + member.size
        if position != directory:
            self.refuse(
                "TRIASSET_ZIP_FOREIGN_DATA", f"bytes {position} to {directory} belong to no member", position
            )


def parse_packed(data: Any, *, file: object) -> dict[str, Member]:
    """Return the members of a packed asset by name, in file order.

    Parameters
    ----------
    data : mmap or bytes
        The whole file.
    file : path-like
        Named in errors.

    Raises
    ------
    AssetError
        `TRIASSET_ZIP_...` or `TRIASSET_PATH_...`, with the byte at fault as pointer.
    """
    return _Parser(data, len(data), file).members()

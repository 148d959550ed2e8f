"""A strict reader of ZIP files with stored members: `.triasset`, and what torch writes.

Local headers tile the file from byte 0, the central directory follows, then the end record, and nothing else
is in the file. The standard library's reader tolerates duplicate names, data before or between members, and
headers that contradict each other. Such a file shows different content to different readers, so each of these
is refused. Where the two kinds of archive differ, a `Policy` says so. Record layouts: PKWARE APPNOTE 6.3.10,
sections 4.3.7, 4.3.9, 4.3.12, 4.3.14 to 4.3.16, 4.4.4 and 4.5.3.
"""

import struct
from dataclasses import dataclass
from typing import Any, NoReturn

from msb.errors import shorten

# Each layout starts with the record's four-byte signature.
LOCAL = struct.Struct("<4s5H3I2H")
CENTRAL = struct.Struct("<4s6H3I5H2I")
END = struct.Struct("<4s4H2IH")
END64 = struct.Struct("<4sQ2H2I4Q")
LOCATOR = struct.Struct("<4sIQI")
# Layouts of the record behind a member's data: the usual one, and that of ZIP64.
_DESCRIPTORS = (struct.Struct("<4sI2I"), struct.Struct("<4sI2Q"))

# These stand in place of a value that is in the ZIP64 record.
FULL16, FULL32 = 0xFFFF, 0xFFFFFFFF
# Flags of encrypted data, strong encryption and a masked header.
ENCRYPTED = 0x0001 | 0x0040 | 0x2000
# Flag: sizes and CRC follow the data.
DESCRIPTOR = 0x0008
# Flag: the name is UTF-8.
UTF8 = 0x0800
EXTRA_ZIP64 = 0x0001
# Info-ZIP's Unicode path: some readers take the member's name from here.
_EXTRA_NAME = 0x7075


@dataclass(frozen=True)
class Member:
    """One stored member: its bytes are `offset : offset + size` of the file, the next starts at `end`."""

    name: str
    crc: int
    size: int
    header: int
    offset: int
    end: int


class Policy:
    """What one kind of archive may hold. The checks here allow everything."""

    max_members: int
    # Sizes and checksum may stand behind the data, and a local header repeat the central ZIP64 record, as
    # torch writes both.
    descriptors = False

    def refuse(self, code: str, message: str, at: int) -> NoReturn:  # pragma: no cover
        """Raise the error about byte `at`. `code` is without the prefix of the kind: FORM."""
        raise NotImplementedError

    def name(self, raw: bytes, flags: int, at: int) -> str:
        """Return the name that a central header spells, or refuse it."""
        raise NotImplementedError

    def same_name(self, name: str) -> str:
        """Return the form of a name that no two members of one archive may share."""
        return name

    def compressed(self, name: str, method: int, at: int) -> NoReturn:
        """Refuse a member that is not stored."""
        text = f"{shorten(name)} is compressed (method {method}); it must be stored"
        self.refuse("FORM", text, at)

    def check_entry(self, name: str, extra: int, attributes: int, at: int) -> None:
        """Check the length of a central header's extra field, and its external attributes."""

    def check_place(self, name: str, start: int, extra: int) -> None:
        """Check where a member's data starts, behind `extra` bytes of extra field."""


def read_members(data: Any, policy: Policy) -> dict[str, Member]:
    """Return the members of the archive `data`, a whole file, by name, in file order."""
    return _Parser(data, policy).members()


class _Parser:
    """Parse one archive."""

    def __init__(self, data: Any, policy: Policy) -> None:
        self.data, self.size, self.policy, self.refuse = data, len(data), policy, policy.refuse

    def part(self, start: int, end: int) -> bytes:
        return bytes(self.data[start:end])

    def record(self, layout: struct.Struct, at: int, signature: bytes, what: str) -> tuple[Any, ...]:
        """Return the fields of the record at byte `at`, its signature checked and left out."""
        if at < 0 or at + layout.size > self.size:
            self.refuse("DAMAGED", f"{what} at byte {at} does not fit into the file", at)
        start, *fields = layout.unpack_from(self.data, at)
        if start != signature:
            self.refuse("DAMAGED", f"there is no {what} at byte {at}", at)
        return tuple(fields)

    def members(self) -> dict[str, Member]:
        count, start, end = self.directory()
        most = self.policy.max_members
        if count > most:
            text = f"the archive has {count} members; there may be {most}"
            self.refuse("FORM", text, start)
        members: list[Member] = []
        position = start
        for _ in range(count):
            member, position = self.central_entry(position, end)
            members.append(member)
        if position != end:
            text = f"the central directory ends at byte {position}, its size says {end}"
            self.refuse("DAMAGED", text, position)
        self.check_names(members)
        members.sort(key=lambda member: member.header)
        self.check_tiling(members, start)
        return {member.name: member for member in members}

    def directory(self) -> tuple[int, int, int]:
        """Return the number of entries, and where the central directory starts and ends."""
        at = self.size - END.size
        if at < 0 or self.part(at, at + 4) != b"PK\x05\x06":
            first = max(0, at - FULL16)
            end_at = self.part(first, self.size).rfind(b"PK\x05\x06")
            after = first + end_at + END.size
            if end_at >= 0 and after <= self.size:
                self.refuse("HOSTILE", "there is data after the end of the archive", after)
            self.refuse("DAMAGED", "the archive's end record is missing: the file is cut off", max(0, at))
        disk, first_disk, here, count, length, start, comment = self.record(
            END, at, b"PK\x05\x06", "end record"
        )
        if comment:
            self.refuse("HOSTILE", f"the end record announces {comment} more bytes", at)
        end = at
        locator = at - LOCATOR.size
        if locator >= 0 and self.part(locator, locator + 4) == b"PK\x06\x07":
            here, count, length, start, end = self.end64(locator, (here, count, length, start))
        elif FULL16 in (here, count) or FULL32 in (length, start):
            self.refuse("HOSTILE", "the end record needs a ZIP64 record that is missing", at)
        if disk or first_disk or here != count:
            self.refuse("DAMAGED", "the archive is split over several files", at)
        if start + length != end:
            # A prefix (say, of a self-extracting program) shifts the directory from where it says it is.
            code = "HOSTILE" if start + length < end else "DAMAGED"
            text = f"the central directory should end at byte {end}, but ends at {start + length}"
            self.refuse(code, text, at)
        return count, start, end

    def end64(self, locator: int, plain: tuple[int, int, int, int]) -> tuple[int, int, int, int, int]:
        _, at, disks = self.record(LOCATOR, locator, b"PK\x06\x07", "ZIP64 locator")
        if at != locator - END64.size or disks != 1:
            self.refuse("HOSTILE", "the ZIP64 locator does not point just before itself", locator)
        size, *_, disk, first_disk, here, count, length, start = self.record(
            END64, at, b"PK\x06\x06", "ZIP64 end record"
        )
        if size != END64.size - 12 or disk or first_disk:
            self.refuse("HOSTILE", "the ZIP64 end record is not well formed", at)
        wide = (here, count, length, start)
        for short, full, saturated in zip(plain, wide, (FULL16, FULL16, FULL32, FULL32), strict=True):
            if short not in (full, saturated):
                self.refuse("HOSTILE", f"the end records contradict each other: {short} and {full}", at)
        return here, count, length, start, at

    def central_entry(self, at: int, end: int) -> tuple[Member, int]:
        """Return the member whose central header is at byte `at`, and where the next header starts."""
        fields = self.record(CENTRAL, at, b"PK\x01\x02", "central header")
        _, _, flags, method, _, _, crc, packed, size, n_name, n_extra, n_comment, disk = fields[:13]
        attributes, header = fields[14:]
        extra = at + CENTRAL.size + n_name
        after = extra + n_extra + n_comment
        if after > end:
            text = f"the central header at byte {at} runs over the directory's end"
            self.refuse("DAMAGED", text, at)
        raw = self.part(at + CENTRAL.size, extra)
        name = self.policy.name(raw, flags, at)
        shown = shorten(name)
        if n_comment or disk:
            self.refuse("DAMAGED", f"{shown} has a comment or is in another file", at)
        if flags & ENCRYPTED:
            self.refuse("FORM", f"{shown} is encrypted", at)
        if method != 0:
            self.policy.compressed(name, method, at)
        self.policy.check_entry(name, n_extra, attributes, at)
        size, packed, header = self.sizes64(extra, n_extra, (size, packed, header), shown)
        if packed != size:
            self.refuse("HOSTILE", f"{shown}: a stored member has one size, not two", at)
        start = self.local_entry(name, raw, flags, (crc, size, header))
        data_end = start + size
        if flags & DESCRIPTOR:
            data_end += self.descriptor_length(data_end, crc, size, shown)
        return Member(name, crc, size, header, start, data_end), after

    def local_entry(self, name: str, raw: bytes, flags: int, central: tuple[int, int, int]) -> int:
        """Check the local header against the central one; return where the data starts."""
        crc, size, header = central
        shown = shorten(name)
        fields = self.record(LOCAL, header, b"PK\x03\x04", "local header")
        _, local_flags, method, _, _, local_crc, packed, local_size, n_name, n_extra = fields
        extra = header + LOCAL.size + n_name
        start: int = extra + n_extra
        if start + size > self.size:
            self.refuse("DAMAGED", f"{shown} runs over the end of the file", header)
        if (flags | local_flags) & DESCRIPTOR and not self.policy.descriptors:
            text = f"{shown} keeps its sizes behind its data, not before"
            self.refuse("HOSTILE", text, header)
        if self.part(header + LOCAL.size, extra) != raw or (local_flags, method) != (flags, 0):
            self.refuse("HOSTILE", f"{shown}: local and central header disagree", header)
        if self.policy.descriptors:
            local_size, packed = self.repeated_sizes64(
                extra, n_extra, (local_size, packed), central, flags, shown
            )
        else:
            local_size, packed, _ = self.sizes64(extra, n_extra, (local_size, packed, 0), shown)
        plain = (local_crc, packed, local_size)
        if plain != (crc, size, size) and not (flags & DESCRIPTOR and plain == (0, 0, 0)):
            text = f"{shown}: local and central header disagree on its size or checksum"
            self.refuse("HOSTILE", text, header)
        self.policy.check_place(name, start, n_extra)
        return start

    def repeated_sizes64(
        self,
        at: int,
        length: int,
        short: tuple[int, int],
        central: tuple[int, int, int],
        flags: int,
        shown: str,
    ) -> tuple[int, int]:
        """Return size and packed size of a local header as torch writes it.

        Beyond 4 GiB the local header has sizes of 0 and repeats the central record, with the packed size
        still 0 and with the offset, for which a local header has no field. Every value in it must be true.
        """
        _, size, header = central
        wide = self.zip64(at, length, shown)
        sizes = [(size, size), (size, 0)] if flags & DESCRIPTOR else [(size, size)]
        if wide is not None and wide not in (*sizes, *((*pair, header) for pair in sizes), (header,)):
            self.refuse("HOSTILE", f"{shown}: its local ZIP64 record contradicts the directory", at)
        if wide is not None and wide[:2] == (size, size):
            return (size if short[0] == FULL32 else short[0]), (size if short[1] == FULL32 else short[1])
        return short

    def descriptor_length(self, at: int, crc: int, size: int, shown: str) -> int:
        """Check the sizes behind the data, and return how many bytes they take."""
        wanted = b"PK\x07\x08", crc, size, size
        for layout in _DESCRIPTORS:
            if at + layout.size <= self.size and layout.unpack_from(self.data, at) == wanted:
                return layout.size
        text = f"{shown}: what stands behind its data is not its size and checksum"
        return self.refuse("HOSTILE", text, at)

    def sizes64(self, at: int, length: int, short: tuple[int, int, int], shown: str) -> tuple[int, int, int]:
        """Return size, packed size and header offset, read from the ZIP64 record where they do not fit.

        Values in the record that no field asks for are refused, because only some readers would read them.
        """
        wanted = short.count(FULL32)
        wide = self.zip64(at, length, shown)
        if len(wide or ()) != wanted or (wide is not None and not wanted):
            text = f"{shown} has a ZIP64 record of {len(wide or ())} numbers where {wanted} are needed"
            self.refuse("HOSTILE", text, at)
        values = iter(wide or ())
        size, packed, header = (next(values) if value == FULL32 else value for value in short)
        return size, packed, header

    def zip64(self, at: int, length: int, shown: str) -> tuple[int, ...] | None:
        """Return the numbers of an extra field's ZIP64 record, None without one; others are padding."""
        wide: tuple[int, ...] | None = None
        end = at + length
        while at + 4 <= end:
            kind, size = struct.unpack_from("<2H", self.data, at)
            if at + 4 + size > end:
                self.refuse("DAMAGED", f"{shown}: an extra record runs over its field", at)
            if kind == _EXTRA_NAME:
                self.refuse("FORM", f"{shown} has a second name in its extra field", at)
            if kind == EXTRA_ZIP64:
                if wide is not None or size not in (0, 8, 16, 24):
                    text = f"{shown} has two ZIP64 records, or one of {size} bytes"
                    self.refuse("HOSTILE", text, at)
                wide = struct.unpack_from(f"<{size // 8}Q", self.data, at + 4)
            at += 4 + size
        return wide

    def check_names(self, members: list[Member]) -> None:
        seen: dict[str, str] = {}
        for member in members:
            key = self.policy.same_name(member.name)
            if key not in seen:
                seen[key] = member.name
                continue
            twin = seen[key]
            code = "HOSTILE" if twin == member.name else "PATH"
            text = f"{shorten(member.name)} and {shorten(twin)} are the same name"
            self.refuse(code, text, member.header)

    def check_tiling(self, members: list[Member], directory: int) -> None:
        """Check that the members fill the file from byte 0 to the central directory."""
        position = 0
        for member in members:
            if member.header < position:
                text = f"{shorten(member.name)} overlaps the member before it"
                self.refuse("DAMAGED", text, position)
            if member.header > position:
                text = f"bytes {position} to {member.header} belong to no member"
                self.refuse("HOSTILE", text, position)
            position = member.end
        if position != directory:
            text = f"bytes {position} to {directory} belong to no member"
            self.refuse("HOSTILE", text, position)

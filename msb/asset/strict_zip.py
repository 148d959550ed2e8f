"""A strict reader of ZIP files with stored (uncompressed) members: `.triasset` files and checkpoints of
torch.

The file begins with the local headers and their data, without gaps. The central directory and the end record
follow. The standard library tolerates duplicate names, data before or between members, and contradictory
headers. This reader rejects a file if different readers could find different content. A `Policy` contains the
rules that differ between assets and checkpoints. Record layouts: PKWARE APPNOTE 6.3.10, sections 4.3.7,
4.3.9, 4.3.12, 4.3.14 to 4.3.16, 4.4.4 and 4.5.3.
"""

import struct
from dataclasses import dataclass
from typing import Any, NoReturn

from msb.errors import shorten

# Layouts of the ZIP records. Each ZIP record begins with a signature of four bytes.
LOCAL = struct.Struct("<4s5H3I2H")
CENTRAL = struct.Struct("<4s6H3I5H2I")
END = struct.Struct("<4s4H2IH")
END64 = struct.Struct("<4sQ2H2I4Q")
LOCATOR = struct.Struct("<4sIQI")
# Layouts of the ZIP record after the data of a member, without and with ZIP64.
_DESCRIPTORS = (struct.Struct("<4sI2I"), struct.Struct("<4sI2Q"))

# These placeholders mean that the value is in the ZIP64 record.
FULL16, FULL32 = 0xFFFF, 0xFFFFFFFF
# Flags of encrypted data, strong encryption and a masked header.
ENCRYPTED = 0x0001 | 0x0040 | 0x2000
# Flag: sizes and CRC-32 follow the data.
DESCRIPTOR = 0x0008
# Flag: the member name is UTF-8.
UTF8 = 0x0800
EXTRA_ZIP64 = 0x0001
# Extra record of Info-ZIP with a Unicode path. Some readers use this path as the name of the member.
_EXTRA_NAME = 0x7075


@dataclass(frozen=True)
class Member:
    """A stored member: the position `header` of its local header, the position `offset` of its data, and its
    `end`.

    The next member starts at byte `end`.
    """

    name: str
    crc: int
    size: int
    header: int
    offset: int
    end: int


class Policy:
    """The rules of one kind of archive. This base class accepts every archive."""

    max_members: int
    # Whether the archive may have the form that torch writes. In the form of torch, sizes and checksums may
    # follow the data. Local headers in this form may repeat the ZIP64 record of the central directory.
    descriptors = False

    def refuse(self, code: str, message: str, at: int) -> NoReturn:  # pragma: no cover
        """Raise an error about byte `at`.

        The argument `code` is the error code without the prefix of the archive, for example FORM.
        """
        raise NotImplementedError

    def name(self, raw: bytes, flags: int, at: int) -> str:
        """Return the member name in a central header, or reject the name."""
        raise NotImplementedError

    def same_name(self, name: str) -> str:
        """Return the normal form of a member name. Two members must not have the same normal form."""
        return name

    def compressed(self, name: str, method: int, at: int) -> NoReturn:
        """Reject a member that is compressed."""
        text = f"{shorten(name)} is compressed (method {method}); it must be stored"
        self.refuse("FORM", text, at)

    def check_entry(self, name: str, extra: int, attributes: int, at: int) -> None:
        """Check the length of a central header's extra field, and its external attributes."""

    def check_place(self, name: str, start: int, extra: int) -> None:
        """Check the start of a member's data. The extra field before the data has `extra` bytes."""


def read_members(data: Any, policy: Policy) -> dict[str, Member]:
    """Return the members of the archive `data` by name, in the order of the file."""
    return _Parser(data, policy).members()


class _Parser:
    """The parser of a single archive."""

    def __init__(self, data: Any, policy: Policy) -> None:
        self.data, self.size, self.policy, self.refuse = data, len(data), policy, policy.refuse

    def part(self, start: int, end: int) -> bytes:
        return bytes(self.data[start:end])

    def record(self, layout: struct.Struct, at: int, signature: bytes, what: str) -> tuple[Any, ...]:
        """Check the signature of the record at byte `at`, and return the fields after it."""
        if at < 0 or at + layout.size > self.size:
            self.refuse("DAMAGED", f"the {what} at byte {at} does not fit into the file", at)
        start, *fields = layout.unpack_from(self.data, at)
        if start != signature:
            self.refuse("DAMAGED", f"the {what} at byte {at} is missing", at)
        return tuple(fields)

    def members(self) -> dict[str, Member]:
        """Check the whole archive, and return its members by name."""
        count, start, end = self.directory()
        most = self.policy.max_members
        if count > most:
            text = f"the archive has {count} members; at most {most} are allowed"
            self.refuse("FORM", text, start)
        members: list[Member] = []
        position = start
        for _ in range(count):
            member, position = self.central_entry(position, end)
            members.append(member)
        if position != end:
            text = f"the central directory ends at byte {position}, but at {end} according to its size"
            self.refuse("DAMAGED", text, position)
        self.check_names(members)
        members.sort(key=lambda member: member.header)
        self.check_tiling(members, start)
        return {member.name: member for member in members}

    def directory(self) -> tuple[int, int, int]:
        """Return the number of entries, and the start and end of the central directory."""
        # The end record must be at the very end of the file, without a comment.
        at = self.size - END.size
        if at < 0 or self.part(at, at + 4) != b"PK\x05\x06":
            first = max(0, at - FULL16)
            end_at = self.part(first, self.size).rfind(b"PK\x05\x06")
            after = first + end_at + END.size
            if end_at >= 0 and after <= self.size:
                self.refuse("HOSTILE", "it has data after the end of the archive", after)
            self.refuse(
                "DAMAGED", "the end record of the archive is missing: the file is truncated", max(0, at)
            )
        disk, first_disk, here, count, length, start, comment = self.record(
            END, at, b"PK\x05\x06", "end record"
        )
        if comment:
            self.refuse("HOSTILE", f"the end record declares {comment} more bytes", at)
        # A ZIP64 end record may precede the end record. The ZIP64 record contains the large values.
        end = at
        locator = at - LOCATOR.size
        if locator >= 0 and self.part(locator, locator + 4) == b"PK\x06\x07":
            here, count, length, start, end = self.end64(locator, (here, count, length, start))
        elif FULL16 in (here, count) or FULL32 in (length, start):
            self.refuse("HOSTILE", "the ZIP64 record for the end record is missing", at)
        if disk or first_disk or here != count:
            self.refuse("DAMAGED", "the archive is split over several files", at)
        if start + length != end:
            # If a program precedes the archive, for example in a self-extracting file, the directory is
            # shifted.
            code = "HOSTILE" if start + length < end else "DAMAGED"
            text = f"the central directory should end at byte {end}, but ends at {start + length}"
            self.refuse(code, text, at)
        return count, start, end

    def end64(self, locator: int, plain: tuple[int, int, int, int]) -> tuple[int, int, int, int, int]:
        """Return the values of the ZIP64 end record, and its position.

        The values must agree with the `plain` end record.
        """
        _, at, disks = self.record(LOCATOR, locator, b"PK\x06\x07", "ZIP64 locator")
        if at != locator - END64.size or disks != 1:
            self.refuse("HOSTILE", "the ZIP64 locator does not point to the record just before it", locator)
        size, *_, disk, first_disk, here, count, length, start = self.record(
            END64, at, b"PK\x06\x06", "ZIP64 end record"
        )
        if size != END64.size - 12 or disk or first_disk:
            self.refuse("HOSTILE", "the ZIP64 end record is invalid", at)
        wide = (here, count, length, start)
        for short, full, saturated in zip(plain, wide, (FULL16, FULL16, FULL32, FULL32), strict=True):
            if short not in (full, saturated):
                self.refuse("HOSTILE", f"the end records contradict each other: {short} and {full}", at)
        return here, count, length, start, at

    def central_entry(self, at: int, end: int) -> tuple[Member, int]:
        """Return the member whose central header is at byte `at`, and the start of the next header."""
        fields = self.record(CENTRAL, at, b"PK\x01\x02", "central header")
        _, _, flags, method, _, _, crc, packed, size, n_name, n_extra, n_comment, disk = fields[:13]
        attributes, header = fields[14:]
        extra = at + CENTRAL.size + n_name
        after = extra + n_extra + n_comment
        if after > end:
            text = f"the central header at byte {at} extends beyond the directory"
            self.refuse("DAMAGED", text, at)
        raw = self.part(at + CENTRAL.size, extra)
        name = self.policy.name(raw, flags, at)
        label = shorten(name)
        if n_comment or disk:
            self.refuse("DAMAGED", f"{label} has a comment or is in another file", at)
        if flags & ENCRYPTED:
            self.refuse("FORM", f"{label} is encrypted", at)
        if method != 0:
            self.policy.compressed(name, method, at)
        self.policy.check_entry(name, n_extra, attributes, at)
        size, packed, header = self.sizes64(extra, n_extra, (size, packed, header), label)
        if packed != size:
            self.refuse("HOSTILE", f"{label}: the sizes of a stored member must be equal", at)
        start = self.local_entry(name, raw, flags, (crc, size, header))
        data_end = start + size
        if flags & DESCRIPTOR:
            data_end += self.descriptor_length(data_end, crc, size, label)
        return Member(name, crc, size, header, start, data_end), after

    def local_entry(self, name: str, raw: bytes, flags: int, central: tuple[int, int, int]) -> int:
        """Check the local header against the central header. Return the position of the member's data."""
        crc, size, header = central
        label = shorten(name)
        fields = self.record(LOCAL, header, b"PK\x03\x04", "local header")
        _, local_flags, method, _, _, local_crc, packed, local_size, n_name, n_extra = fields
        extra = header + LOCAL.size + n_name
        start: int = extra + n_extra
        if start + size > self.size:
            self.refuse("DAMAGED", f"{label} extends beyond the end of the file", header)
        if (flags | local_flags) & DESCRIPTOR and not self.policy.descriptors:
            text = f"{label} has its sizes after its data, not before"
            self.refuse("HOSTILE", text, header)
        if self.part(header + LOCAL.size, extra) != raw or (local_flags, method) != (flags, 0):
            self.refuse("HOSTILE", f"{label}: local and central header disagree", header)
        if self.policy.descriptors:
            local_size, packed = self.repeated_sizes64(
                extra, n_extra, (local_size, packed), central, flags, label
            )
        else:
            local_size, packed, _ = self.sizes64(extra, n_extra, (local_size, packed, 0), label)
        plain = (local_crc, packed, local_size)
        if plain != (crc, size, size) and not (flags & DESCRIPTOR and plain == (0, 0, 0)):
            text = f"{label}: local and central header disagree on size or checksum"
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
        label: str,
    ) -> tuple[int, int]:
        """Return the size and the packed size from a local header written by torch.

        For members beyond 4 GiB, torch writes 0 for both sizes. The ZIP64 record of the local header then
        repeats the ZIP64 record of the central directory. This record contains the size, a packed size of 0,
        and an offset. All these values are checked.
        """
        _, size, header = central
        wide = self.zip64(at, length, label)
        sizes = [(size, size), (size, 0)] if flags & DESCRIPTOR else [(size, size)]
        if wide is not None and wide not in (*sizes, *((*pair, header) for pair in sizes), (header,)):
            self.refuse("HOSTILE", f"{label}: its local ZIP64 record contradicts the directory", at)
        if wide is not None and wide[:2] == (size, size):
            return (size if short[0] == FULL32 else short[0]), (size if short[1] == FULL32 else short[1])
        return short

    def descriptor_length(self, at: int, crc: int, size: int, label: str) -> int:
        """Check the ZIP record after the data, and return its length in bytes."""
        wanted = b"PK\x07\x08", crc, size, size
        for layout in _DESCRIPTORS:
            if at + layout.size <= self.size and layout.unpack_from(self.data, at) == wanted:
                return layout.size
        text = f"{label}: the record after its data does not have its size and checksum"
        return self.refuse("HOSTILE", text, at)

    def sizes64(self, at: int, length: int, short: tuple[int, int, int], label: str) -> tuple[int, int, int]:
        """Return the size, the packed size and the header offset. Large values come from the ZIP64 record.

        Reject additional values in the ZIP64 record, because readers interpret such values differently.
        """
        wanted = short.count(FULL32)
        wide = self.zip64(at, length, label)
        if len(wide or ()) != wanted or (wide is not None and not wanted):
            text = f"{label} has a ZIP64 record of {len(wide or ())} numbers; {wanted} are needed"
            self.refuse("HOSTILE", text, at)
        values = iter(wide or ())
        size, packed, header = (next(values) if value == FULL32 else value for value in short)
        return size, packed, header

    def zip64(self, at: int, length: int, label: str) -> tuple[int, ...] | None:
        """Return the numbers in the ZIP64 record of an extra field, or None without such a record.

        All other extra records are ignored as padding.
        """
        wide: tuple[int, ...] | None = None
        end = at + length
        while at + 4 <= end:
            kind, size = struct.unpack_from("<2H", self.data, at)
            if at + 4 + size > end:
                self.refuse("DAMAGED", f"{label}: an extra record extends beyond its field", at)
            if kind == _EXTRA_NAME:
                self.refuse("FORM", f"{label} has a second name in its extra field", at)
            if kind == EXTRA_ZIP64:
                if wide is not None or size not in (0, 8, 16, 24):
                    text = f"{label} has two ZIP64 records, or one of {size} bytes"
                    self.refuse("HOSTILE", text, at)
                wide = struct.unpack_from(f"<{size // 8}Q", self.data, at + 4)
            at += 4 + size
        return wide

    def check_names(self, members: list[Member]) -> None:
        """Reject two members with equal names."""
        seen: dict[str, str] = {}
        for member in members:
            key = self.policy.same_name(member.name)
            if key not in seen:
                seen[key] = member.name
                continue
            twin = seen[key]
            code = "HOSTILE" if twin == member.name else "PATH"
            text = f"{shorten(member.name)} and {shorten(twin)} are equal names"
            self.refuse(code, text, member.header)

    def check_tiling(self, members: list[Member], directory: int) -> None:
        """Check that the members fill the file from byte 0 to the central directory."""
        position = 0
        for member in members:
            if member.header < position:
                text = f"{shorten(member.name)} overlaps the member before it"
                self.refuse("DAMAGED", text, position)
            if member.header > position:
                text = f"bytes {position} to {member.header} do not belong to a member"
                self.refuse("HOSTILE", text, position)
            position = member.end
        if position != directory:
            text = f"bytes {position} to {directory} do not belong to a member"
            self.refuse("HOSTILE", text, position)

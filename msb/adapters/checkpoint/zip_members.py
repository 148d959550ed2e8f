"""Where the members of a torch archive are: a strict reader of stored ZIP members.

torch's ZIP files differ from a packed `.triasset` in what they may hold: sizes and checksum also come behind
the data (bit 3 of the flags), the end record always has a ZIP64 twin, and the local header's extra field is
filled up so that data starts on a 64-byte boundary. As there, members have to tile the file, so that no two
readers see different content. Facts: pytorch/pytorch `caffe2/serialize/inline_container.cc`; PKWARE APPNOTE
6.3.10, sections 4.3.7, 4.3.9, 4.3.12, 4.3.14 to 4.3.16 and 4.5.3.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, NoReturn

from msb.adapters.checkpoint.refusal import Refusal
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
from msb.errors import shorten

MAX_MEMBERS = 20_000
"""One per tensor and a handful more: the methods' files have below 30, large models thousands."""
MAX_NAME = 500


@dataclass(frozen=True)
class Member:
    """One stored member: its bytes are `offset : offset + size` of the file, the next starts at `end`."""

    name: str
    crc: int
    size: int
    header: int
    offset: int
    end: int


def _refuse(code: str, message: str, at: int, **more: Any) -> NoReturn:
    raise Refusal(f"CHECKPOINT_ZIP_{code}", message, at=f"byte {at}", **more)


def is_script(name: str) -> bool:
    """Return whether a member belongs to a TorchScript program: its constants or source code."""
    return name.endswith("/constants.pkl") or "/code/" in name


def refuse_script(name: str) -> NoReturn:
    """Say that the archive is a program."""
    text = f"it holds a TorchScript program ({shorten(name, 40)}); a saved state is needed"
    raise Refusal("CHECKPOINT_TORCHSCRIPT", text)


def read_members(view: memoryview) -> dict[str, Member]:
    """Return the members of the archive by name, in file order.

    Raises
    ------
    Refusal
        `CHECKPOINT_ZIP_...`.
    """
    count, start, end = _directory(view)
    if count > MAX_MEMBERS:
        text = f"the archive has {count} members; at most {MAX_MEMBERS} are read"
        _refuse("TOO_MANY_MEMBERS", text, start, value=count, limit=MAX_MEMBERS)
    members: dict[str, Member] = {}
    position = start
    for _ in range(count):
        member, position = _central_entry(view, position, end)
        if member.name in members:
            _refuse("DUPLICATE_MEMBER", f"{shorten(member.name)} is in the archive twice", member.header)
        members[member.name] = member
    if position != end:
        _refuse("DIRECTORY", f"the directory ends at byte {position}, its size says {end}", position)
    ordered = sorted(members.values(), key=lambda member: member.header)
    _check_tiling(ordered, start)
    return {member.name: member for member in ordered}


def _record(view: memoryview, layout: struct.Struct, at: int, signature: bytes, what: str) -> tuple[Any, ...]:
    """Return the fields of the record at byte `at`, its signature checked and left out."""
    if at < 0 or at + layout.size > len(view):
        _refuse("DIRECTORY", f"{what} at byte {at} does not fit into the file", at)
    found, *fields = layout.unpack_from(view, at)
    if found != signature:
        _refuse("DIRECTORY", f"there is no {what} at byte {at}", at)
    return tuple(fields)


def _directory(view: memoryview) -> tuple[int, int, int]:
    """Return the number of entries, and where the central directory starts and ends."""
    at = len(view) - END.size
    if at < 0 or bytes(view[at : at + 4]) != b"PK\x05\x06":
        tail = bytes(view[max(0, at - FULL16) :])
        found = tail.rfind(b"PK\x05\x06")
        if 0 <= found <= len(tail) - END.size:
            after = len(view) - len(tail) + found + END.size
            _refuse("FOREIGN_DATA", "there is data after the end of the archive", after)
        _refuse("TRUNCATED", "the archive's end record is missing: the file is cut off", max(0, at))
    disk, first_disk, here, count, length, start, comment = _record(
        view, END, at, b"PK\x05\x06", "end record"
    )
    if comment:
        _refuse("FOREIGN_DATA", f"the end record announces {comment} more bytes", at)
    end = at
    locator = at - LOCATOR.size
    if locator >= 0 and bytes(view[locator : locator + 4]) == b"PK\x06\x07":
        here, count, length, start, end = _end64(view, locator, (here, count, length, start))
    elif FULL16 in (here, count) or FULL32 in (length, start):
        _refuse("ZIP64", "the end record needs a ZIP64 record that is missing", at)
    if disk or first_disk or here != count:
        _refuse("DIRECTORY", "the archive is split over several files", at)
    if start + length != end:
        # A prefix (say, of a self-extracting program) shifts the directory from where it says it is.
        code = "FOREIGN_DATA" if start + length < end else "DIRECTORY"
        _refuse(code, f"the directory should end at byte {end}, but ends at {start + length}", at)
    return count, start, end


def _end64(
    view: memoryview, locator: int, plain: tuple[int, int, int, int]
) -> tuple[int, int, int, int, int]:
    _, at, disks = _record(view, LOCATOR, locator, b"PK\x06\x07", "ZIP64 locator")
    if at != locator - END64.size or disks != 1:
        _refuse("ZIP64", "the ZIP64 locator does not point just before itself", locator)
    size, *_, disk, first_disk, here, count, length, start = _record(
        view, END64, at, b"PK\x06\x06", "ZIP64 end record"
    )
    if size != END64.size - 12 or disk or first_disk:
        _refuse("ZIP64", "the ZIP64 end record is not well formed", at)
    wide = (here, count, length, start)
    for short, full, saturated in zip(plain, wide, (FULL16, FULL16, FULL32, FULL32), strict=True):
        if short not in (full, saturated):
            _refuse("ZIP64", f"the end records contradict each other: {short} and {full}", at)
    return here, count, length, start, at


def _central_entry(view: memoryview, at: int, end: int) -> tuple[Member, int]:
    """Return the member whose central header is at byte `at`, and where the next header starts."""
    fields = _record(view, CENTRAL, at, b"PK\x01\x02", "central header")
    _, _, flags, method, _, _, crc, packed, size, n_name, n_extra, n_comment, disk = fields[:13]
    header = fields[15]
    extra = at + CENTRAL.size + n_name
    after = extra + n_extra + n_comment
    if after > end:
        _refuse("DIRECTORY", f"the central header at byte {at} runs over the directory's end", at)
    raw = bytes(view[at + CENTRAL.size : extra])
    name = _name(raw, at)
    shown = shorten(name)
    if n_comment or disk:
        _refuse("DIRECTORY", f"{shown} has a comment or is in another file", at)
    if flags & ENCRYPTED:
        _refuse("ENCRYPTED", f"{shown} is encrypted", at)
    if method != 0 and is_script(name):  # torch compresses source code: say what it is, not how it is packed
        refuse_script(name)
    if method != 0:
        _refuse("COMPRESSED", f"{shown} is compressed (method {method}); it must be stored", at)
    size, packed, header = _sizes64(view[extra : extra + n_extra], (size, packed, header), shown, extra)
    if packed != size:
        _refuse("HEADER_MISMATCH", f"{shown}: a stored member has one size, not two", at)
    offset = _local_entry(view, raw, shown, flags, (crc, size, header))
    data_end = offset + size
    if flags & DESCRIPTOR:
        data_end += _descriptor_length(view, data_end, crc, size, shown)
    return Member(name, crc, size, header, offset, data_end), after


def _name(raw: bytes, at: int) -> str:
    try:
        name = raw.decode()
    except UnicodeDecodeError:
        name = ""
    if not name or len(name) > MAX_NAME or not name.isprintable():
        _refuse("NAME", "a member's name is empty, too long or not printable UTF-8", at)
    return name


def _local_entry(view: memoryview, name: bytes, shown: str, flags: int, central: tuple[int, int, int]) -> int:
    """Check the local header against the central one; return where the data starts."""
    crc, size, header = central
    fields = _record(view, LOCAL, header, b"PK\x03\x04", "local header")
    _, local_flags, method, _, _, local_crc, packed, local_size, n_name, n_extra = fields
    extra = header + LOCAL.size + n_name
    start: int = extra + n_extra
    if start + size > len(view):
        _refuse("DIRECTORY", f"{shown} runs over the end of the file", header)
    if bytes(view[header + LOCAL.size : extra]) != name or (local_flags, method) != (flags, 0):
        _refuse("HEADER_MISMATCH", f"{shown}: local and central header disagree", header)
    # Beyond 4 GiB torch repeats the central record here, beside sizes of 0, with the packed size still 0 and
    # with the offset, for which a local header has no field. Whatever it says must be true.
    wide = _zip64_record(view[extra:start], shown, extra)
    sizes = [(size, size), (size, 0)] if flags & DESCRIPTOR else [(size, size)]
    if wide is not None and wide not in (*sizes, *((*pair, header) for pair in sizes), (header,)):
        _refuse("ZIP64", f"{shown}: its local ZIP64 record contradicts the directory", extra)
    if wide is not None and wide[:2] == (size, size):
        local_size, packed = (size if n == FULL32 else n for n in (local_size, packed))
    plain = (local_crc, packed, local_size)
    if plain != (crc, size, size) and not (flags & DESCRIPTOR and plain == (0, 0, 0)):
        _refuse("HEADER_MISMATCH", f"{shown}: local and central header disagree on its size", header)
    return start


def _descriptor_length(view: memoryview, at: int, crc: int, size: int, shown: str) -> int:
    """Check the sizes behind the data, and return how many bytes they take: 16, or 24 in ZIP64 form."""
    for layout in (struct.Struct("<4sI2I"), struct.Struct("<4sI2Q")):
        if at + layout.size <= len(view) and layout.unpack_from(view, at) == (
            b"PK\x07\x08",
            crc,
            size,
            size,
        ):
            return layout.size
    _refuse("HEADER_MISMATCH", f"{shown}: what stands behind its data is not its size and checksum", at)


def _sizes64(extra: memoryview, short: tuple[int, int, int], shown: str, where: int) -> tuple[int, int, int]:
    """Return size, packed size and header offset, read from the ZIP64 record where they do not fit."""
    wanted = short.count(FULL32)
    wide = _zip64_record(extra, shown, where)
    if len(wide or ()) != wanted or (wide is not None and not wanted):
        text = f"{shown} has a ZIP64 record of {len(wide or ())} numbers where {wanted} are needed"
        _refuse("ZIP64", text, where)
    values = iter(wide or ())
    size, packed, header = (next(values) if value == FULL32 else value for value in short)
    return size, packed, header


def _zip64_record(extra: memoryview, shown: str, where: int) -> tuple[int, ...] | None:
    """Return the numbers of an extra field's ZIP64 record, None without one; other records are padding."""
    wide: tuple[int, ...] | None = None
    at = 0
    while at + 4 <= len(extra):
        kind, length = struct.unpack_from("<2H", extra, at)
        if at + 4 + length > len(extra):
            _refuse("DIRECTORY", f"{shown}: an extra record runs over its field", where + at)
        if kind == EXTRA_ZIP64:
            if wide is not None or length not in (0, 8, 16, 24):
                _refuse("ZIP64", f"{shown} has two ZIP64 records, or one of {length} bytes", where + at)
            wide = struct.unpack_from(f"<{length // 8}Q", extra, at + 4)
        at += 4 + length
    return wide


def _check_tiling(members: list[Member], directory: int) -> None:
    """Check that the members fill the file from byte 0 to the central directory."""
    position = 0
    for member in members:
        if member.header < position:
            _refuse("DIRECTORY", f"{shorten(member.name)} overlaps the member before it", position)
        if member.header > position:
            _refuse("FOREIGN_DATA", f"bytes {position} to {member.header} belong to no member", position)
        position = member.end
    if position != directory:
        _refuse("FOREIGN_DATA", f"bytes {position} to {directory} belong to no member", position)

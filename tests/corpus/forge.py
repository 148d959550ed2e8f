"""Write ZIP files and PNGs field by field, so that each field can have a wrong value."""

import struct
import zlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ALIGNMENT = 64
FULL32 = 0xFFFFFFFF
PADDING_ID = 0xD935

Fields = dict[str, Any]


@dataclass
class Entry:
    """One member of a ZIP.

    `local` overrides fields of the local header, `central` fields of the central header, and `both` fields of
    both. Fields are version, flags, method, time, date, crc, packed, size, name (bytes) and extra (bytes).
    The central header also has made_by, comment (bytes), disk, internal, attributes and offset.
    """

    name: str
    data: bytes
    both: Fields = field(default_factory=dict)
    local: Fields = field(default_factory=dict)
    central: Fields = field(default_factory=dict)
    before: bytes = b""
    """Bytes between the previous member and the local header."""
    after: bytes = b""
    """Bytes after the data, such as a data descriptor."""
    aligned: bool = True
    listed_only: bool = False
    """Whether the member has a central header only, without a local header and data."""

    def fields(self) -> Fields:
        """Return the fields of both headers before `local` and `central` are applied."""
        return {
            "version": 20,
            "flags": 0,
            "method": 0,
            "time": 0,
            "date": 0x21,
            "crc": zlib.crc32(self.data),
            "packed": len(self.data),
            "size": len(self.data),
            "name": self.name.encode(),
            "extra": b"",
            **self.both,
        }


def forge(
    entries: list[Entry],
    *,
    before_directory: bytes = b"",
    end: Fields | None = None,
    end64: Fields | None = None,
) -> bytes:
    """Return a ZIP of `entries`, with `before_directory` between the last member and the central directory.

    `end` replaces fields of the end record: disk, first_disk, here, count, length, start, comment. With
    `end64`, a ZIP64 end record and locator are written as well. `end64` replaces fields of these two: the
    fields of `end`, and record_size, at and disks.
    """
    out = bytearray()
    offsets = []
    for entry in entries:
        out += entry.before
        offsets.append(len(out))
        if not entry.listed_only:
            out += local_header(entry, len(out)) + entry.data + entry.after
    out += before_directory
    start = len(out)
    for entry, offset in zip(entries, offsets, strict=True):
        out += central_header(entry, offset)
    length = len(out) - start
    plain = {"disk": 0, "first_disk": 0, "here": len(entries), "count": len(entries)}
    plain |= {"length": length, "start": start, "comment": b""}
    if end64 is not None:
        out += end64_records({**plain, "record_size": 44, "at": len(out), "disks": 1, **end64})
    out += end_record({**plain, **(end or {})})
    return bytes(out)


def local_header(entry: Entry, at: int) -> bytes:
    """Return the local header of an entry that starts at byte `at`."""
    f = {**entry.fields(), **entry.local}
    if entry.aligned and "extra" not in {**entry.both, **entry.local}:
        f["extra"] = padding(at + 30 + len(f["name"]))
    numbers = [f[key] for key in ("version", "flags", "method", "time", "date", "crc", "packed", "size")]
    signature = f.get("signature", b"PK\x03\x04")
    header = struct.pack("<4s5H3I2H", signature, *numbers, len(f["name"]), len(f["extra"]))
    return bytes(header + f["name"] + f["extra"])


def central_header(entry: Entry, offset: int) -> bytes:
    """Return the central header of an entry whose local header is at byte `offset`."""
    more = {"made_by": 20, "comment": b"", "disk": 0, "internal": 0, "attributes": 0, "offset": offset}
    f = {**entry.fields(), **more, **entry.central}
    numbers = [f[key] for key in ("made_by", "version", "flags", "method", "time", "date")]
    numbers += [f["crc"], f["packed"], f["size"], len(f["name"]), len(f["extra"]), len(f["comment"])]
    numbers += [f[key] for key in ("disk", "internal", "attributes", "offset")]
    header = struct.pack("<4s6H3I5H2I", f.get("signature", b"PK\x01\x02"), *numbers)
    return bytes(header + f["name"] + f["extra"] + f["comment"])


def end_record(f: Fields) -> bytes:
    """Return an end record with the fields `f`."""
    numbers = [f[key] for key in ("disk", "first_disk", "here", "count", "length", "start")]
    return bytes(struct.pack("<4s4H2IH", b"PK\x05\x06", *numbers, len(f["comment"])) + f["comment"])


def end64_records(f: Fields) -> bytes:
    """Return a ZIP64 end record and its locator with the fields `f`."""
    numbers = [f[key] for key in ("disk", "first_disk", "here", "count", "length", "start")]
    record = struct.pack("<4sQ2H2I4Q", b"PK\x06\x06", f["record_size"], 45, 45, *numbers)
    return record + struct.pack("<4sIQI", b"PK\x06\x07", 0, f["at"], f["disks"])


def padding(start: int) -> bytes:
    """Return an extra field that moves data from byte `start` to the next multiple of 64."""
    missing = -start % ALIGNMENT
    if 0 < missing < 4:
        missing += ALIGNMENT
    return extra(PADDING_ID, bytes(missing - 4)) if missing else b""


def extra(kind: int, data: bytes) -> bytes:
    """Return one record of an extra field."""
    return struct.pack("<2H", kind, len(data)) + data


def zip64(*values: int) -> bytes:
    """Return a ZIP64 extra record with `values`."""
    return extra(1, struct.pack(f"<{len(values)}Q", *values))


def write_sparse(
    path: Path, members: Iterable[tuple[str, bytes, int]], make: Callable[[str, bytes, int, int], Entry]
) -> None:
    """Write a sparse archive with ZIP64 records.

    Parameters
    ----------
    path : Path
    members : iterable of (str, bytes, int)
        Name, data, and the length of the hole after the data.
    make : callable
        Returns the entry for a name, its data, its total size and its offset.
    """
    directory, members = b"", list(members)
    with path.open("wb") as file:
        for name, data, hole in members:
            at = file.tell()
            entry = make(name, data, len(data) + hole, at)
            file.write(local_header(entry, at) + data)
            file.seek(hole, 1)
            file.write(entry.after)
            directory += central_header(entry, at)
        start = file.tell()
        f = {"disk": 0, "first_disk": 0, "here": len(members), "count": len(members), "comment": b""}
        f |= {"length": len(directory), "start": start}
        more = {"record_size": 44, "at": start + len(directory), "disks": 1}
        file.write(directory + end64_records(f | more) + end_record(f | {"start": min(start, FULL32)}))


def chunk(kind: bytes, body: bytes) -> bytes:
    """Return a chunk of a PNG with its checksum."""
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(
    width: int, height: int, *, depth: int = 8, kind: int = 2, rows: bytes = b"", more: bytes = b""
) -> bytes:
    """Return a PNG with this header and the uncompressed `rows`. They need not match."""
    head = chunk(b"IHDR", struct.pack(">2I5B", width, height, depth, kind, 0, 0, 0))
    end = chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + head + more + end

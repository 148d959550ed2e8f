"""Bad assets in ZIP files with compression, contradictory headers, or foreign bytes, names or records."""

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

from tests.corpus.case import Case
from tests.corpus.forge import PADDING_ID, Entry, extra, forge, zip64
from tests.corpus.good import mesh, parts

_FULL16, _FULL32 = 0xFFFF, 0xFFFFFFFF
_POSITIONS = "buffers/positions.bin"


def good_entries() -> list[Entry]:
    """Return the members of a good asset: the manifest, positions, indices and color."""
    return parts(mesh()).entries()


def from_bytes(name: str, code: str, make: Callable[[], bytes], **more: Any) -> Case:
    """Return a case whose file holds the bytes returned by `make`."""
    return Case(name, code, lambda path: path.write_bytes(make()), **more)


def _zip(name: str, code: str, make: Callable[[], bytes], **more: Any) -> Case:
    return from_bytes(f"zip_{name}", f"TRIASSET_{code}", make, **more)


def _forged(name: str, code: str, **spoil: Any) -> Case:
    """Return a case of good members, packed by `forge` with further arguments."""
    return _zip(name, code, lambda: forge(good_entries(), **spoil))


def _patched(name: str, code: str, patch: Callable[[bytes], bytes], **more: Any) -> Case:
    """Return a case that consists of a good file, changed by `patch`."""
    return _zip(name, code, lambda: patch(forge(good_entries())), **more)


def _member(name: str, code: str, which: int = 1, /, more: Any = None, **changes: Any) -> Case:
    """Return a case in which a member (default: positions) has other attributes of `Entry`."""

    def make() -> bytes:
        entries = good_entries()
        for key, value in changes.items():
            setattr(entries[which], key, value)
        return forge(entries)

    return _zip(name, code, make, **(more or {}))


def _added(name: str, code: str, entry: Entry) -> Case:
    """Return a case with a further member."""
    return _zip(name, code, lambda: forge([*good_entries(), entry]))


def _bomb() -> bytes:
    """Return a ZIP of 49 kB that unpacks to 50 MB."""
    squeezer = zlib.compressobj(9, wbits=-15)
    data = bytes(50_000_000)
    squeezed = squeezer.compress(data) + squeezer.flush()
    fields = {"method": 8, "crc": zlib.crc32(data), "packed": len(squeezed), "size": len(data)}
    return forge([*good_entries(), Entry("buffers/bomb.bin", squeezed, both=fields)])


def _by_zipfile(method: int) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for entry in good_entries():
            archive.writestr(zipfile.ZipInfo(entry.name), entry.data, method)
    return stream.getvalue()


def _descriptor() -> bytes:
    """Return a ZIP of a streaming writer. In it, sizes and CRC follow the data."""
    entries = good_entries()
    data = entries[1].data
    entries[1].both = {"flags": 8}
    entries[1].local = {"crc": 0, "packed": 0, "size": 0}
    entries[1].after = struct.pack("<4s3I", b"PK\x07\x08", zlib.crc32(data), len(data), len(data))
    return forge(entries)


def _bit_rot(data: bytes) -> bytes:
    color = good_entries()[3].data
    return data.replace(color, color[:5] + bytes([color[5] ^ 16]) + color[6:])


def _hidden_member() -> bytes:
    """Return a ZIP whose first member is not listed. A streaming reader would read another manifest."""
    entries = good_entries()
    hidden = forge([Entry("manifest.json", b"{}")])
    entries[0].before = hidden[: hidden.index(b"PK\x01\x02")]
    return forge(entries)


def _inside_another() -> bytes:
    """Return a ZIP with a member inside the data of another member."""
    entries = good_entries()
    inner = forge([Entry("buffers/inner.bin", b"secret" * 20)])
    entries[1].data = inner[: inner.index(b"PK\x01\x02")]
    offset = forge(entries).index(entries[1].data)
    entries.append(Entry("buffers/inner.bin", b"secret" * 20, central={"offset": offset}, listed_only=True))
    return forge(entries)


def _listed_twice(name: str) -> Entry:
    """Return a directory entry called `name` for the first member, the manifest."""
    return Entry(name, good_entries()[0].data, central={"offset": 0}, listed_only=True)


def _many(count: int, **end: Any) -> Callable[[], bytes]:
    """Return a function that makes a ZIP of a good asset and `count` empty members."""

    def make() -> bytes:
        members = (Entry(f"buffers/{i}.bin", b"", aligned=False) for i in range(count))
        return forge([*good_entries(), *members], **end)

    return make


_CRC = {"crc": 0x12345678}
_VALIDATED = {"found_by": "validate"}
STORED_CASES = [
    _zip("deflated", "FORM", lambda: _by_zipfile(zipfile.ZIP_DEFLATED)),
    _zip("bomb", "FORM", _bomb),
    _member("method_99", "FORM", both={"method": 99}),
    _member("encrypted", "FORM", both={"flags": 0x01}),
    _zip("descriptor", "HOSTILE", _descriptor),
    _member("crc", "DAMAGED", both=_CRC, more=_VALIDATED),
    _patched("bit_rot", "DAMAGED", _bit_rot, found_by="validate", also=("TRIASSET_DAMAGED",)),
    _zip("unaligned", "FORM", lambda: _by_zipfile(zipfile.ZIP_STORED)),
]
HEADER_CASES = [
    _member("local_name", "HOSTILE", local={"name": b"buffers/positionz.bin"}),
    _member("local_size", "HOSTILE", local={"size": 49}),
    _member("two_sizes", "HOSTILE", both={"packed": 40}),
    _member("offset_inside", "DAMAGED", central={"offset": 100}),
    _member("offset_past_end", "DAMAGED", central={"offset": 0x7FFFFFFF}),
    _member("central_signature", "DAMAGED", central={"signature": b"PK\1\3"}),
    _member("size_past_end", "DAMAGED", both={"size": 10**9, "packed": 10**9}),
    _member("size_into_next", "DAMAGED", both={"size": 100, "packed": 100}),
    _member("member_comment", "DAMAGED", central={"comment": b"hello"}),
    _member("extra_overrun", "DAMAGED", local={"extra": b"\x35\xd9\xff\x00"}),
    _member("extra_64_kb", "HOSTILE", local={"extra": extra(PADDING_ID, bytes(65_000))}),
    _forged("count_less", "DAMAGED", end={"here": 3, "count": 3}),
    _forged("disk", "DAMAGED", end={"disk": 1}),
    _forged("directory_late", "DAMAGED", end={"start": 10**9}),
]
FOREIGN_CASES = [
    _patched("prefix_program", "HOSTILE", lambda z: b"MZ" + bytes(62) + z),
    _zip("hidden_member", "HOSTILE", _hidden_member),
    _forged("before_directory", "HOSTILE", before_directory=b"secret"),
    _patched("twice", "HOSTILE", lambda z: z + z),
    _forged("comment", "HOSTILE", end={"comment": b"hello"}),
    _patched("comment_lie", "HOSTILE", lambda z: z[:-2] + b"\5\0"),
]
_NAMES = [
    "buffers/../../../../etc/cron.d/x.bin",
    "buffers\\x.bin",
    "manifest.json\0",
    "buffers/\u202enib.bin",
    "buffers/x\x1b[2J.bin",
    "",
]
_SECOND_NAME = extra(0x7075, b"\1" + struct.pack("<I", zlib.crc32(_POSITIONS.encode())) + b"../x")
_LINK = 0o120777 << 16
NAME_CASES = [
    *(_added(f"name_{i:02}", "FORM", Entry(name, b"x")) for i, name in enumerate(_NAMES)),
    _added("name_not_utf8", "FORM", Entry("", b"x", both={"name": b"buffers/\xff.bin", "flags": 0x800})),
    _member("second_name", "FORM", central={"extra": _SECOND_NAME}),
    _added("manifest_twice", "HOSTILE", Entry("manifest.json", b"{}")),
    _added("case_twins", "PATH", Entry("buffers/Positions.bin", b"x")),
    _added("nested", "FILE_UNDECLARED", Entry("buffers/inner.bin", forge([]))),
    _zip("no_manifest", "MANIFEST_MISSING", lambda: forge(good_entries()[1:])),
    _zip("no_members", "MANIFEST_MISSING", lambda: forge([])),
    *(
        _member(f"kind_{name}", "PATH", central={"made_by": made_by, "attributes": attributes})
        for name, made_by, attributes in (
            ("link", 3 << 8 | 20, _LINK),
            ("device", 3 << 8 | 20, 0o060644 << 16),
            ("folder_dos", 20, 0x10),
        )
    ),
    _zip("70000_members", "FORM", _many(70_000, end64={}, end={"here": _FULL16, "count": _FULL16})),
    _zip("inside_another", "DAMAGED", _inside_another),
    _added("listed_twice", "HOSTILE", _listed_twice("manifest.json")),
    _added("listed_renamed", "HOSTILE", _listed_twice("buffers/x.bin")),
]
_LONG = {"size": _FULL32, "packed": _FULL32}
_COUNTED = {"here": _FULL16, "count": _FULL16}
ZIP64_CASES = [
    _forged("zip64_end_missing", "HOSTILE", end=_COUNTED),
    _forged("zip64_end_differs", "HOSTILE", end64={"count": 3}),
    _forged("zip64_locator", "HOSTILE", end64={"at": 0}),
    _forged("zip64_huge_record", "HOSTILE", end64={"record_size": 2**63}),
    _forged("zip64_count", "FORM", end=_COUNTED, end64={"here": 2**40, "count": 2**40}),
    _forged("zip64_start", "DAMAGED", end={"start": _FULL32}, end64={"start": 2**64 - 1}),
    _member("zip64_missing", "HOSTILE", central=_LONG),
    _member("zip64_short", "HOSTILE", central={**_LONG, "extra": zip64(48)}),
    _member("zip64_twice", "HOSTILE", central={**_LONG, "extra": zip64(48, 48) * 2}),
    _member("zip64_local_differs", "HOSTILE", local={**_LONG, "extra": zip64(49, 49)}),
]

# --- other files, and truncated ZIPs -----------------------------------------------------------------------


FILE_CASES = [
    from_bytes("not_zip_zero_bytes", "FILE_NOT_RECOGNISED", lambda: b""),
    from_bytes("not_zip_manifest_alone", "FILE_NOT_RECOGNISED", lambda: parts(mesh()).text()),
    from_bytes("cut_half", "TRIASSET_DAMAGED", lambda: forge(good_entries())[:1024]),
    from_bytes("cut_last_byte", "TRIASSET_DAMAGED", lambda: forge(good_entries())[:-1]),
]

CASES = [*STORED_CASES, *HEADER_CASES, *FOREIGN_CASES, *NAME_CASES, *ZIP64_CASES, *FILE_CASES]

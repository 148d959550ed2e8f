"""Packed assets that are not stored as they are, contradict themselves or hold more (class 33)."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from typing import TYPE_CHECKING, Any

from tests.corpus.case import Case
from tests.corpus.forge import PADDING_ID, Entry, extra, forge
from tests.corpus.good import mesh, parts

if TYPE_CHECKING:
    from collections.abc import Callable


def good_entries() -> list[Entry]:
    """Return the members of a good asset: the manifest, positions, indices and color."""
    return parts(mesh()).entries()


def from_bytes(name: str, title: str, code: str, make: Callable[[], bytes], **more: Any) -> Case:
    """Return a case whose file holds the bytes that `make` returns."""
    return Case(name, title, code, lambda path: path.write_bytes(make()) and None, **more)


def zip_case(name: str, title: str, code: str, make: Callable[[], bytes], **more: Any) -> Case:
    return from_bytes(f"zip_{name}", title, f"TRIASSET_{code}", make, **more)


def forged(name: str, title: str, code: str, **spoil: Any) -> Case:
    """Return a case of good members and keywords of `forge`."""
    return zip_case(name, title, code, lambda: forge(good_entries(), **spoil))


def patched(name: str, title: str, code: str, patch: Callable[[bytes], bytes]) -> Case:
    """Return a case that is `patch` of a good file."""
    return zip_case(name, title, code, lambda: patch(forge(good_entries())))


def member(name: str, title: str, code: str, which: int = 1, /, more: Any = None, **changes: Any) -> Case:
    """Return a case in which one member (positions, if not said) has other attributes of `Entry`."""

    def make() -> bytes:
        entries = good_entries()
        for key, value in changes.items():
            setattr(entries[which], key, value)
        return forge(entries)

    return zip_case(name, title, code, make, **(more or {}))


def added(name: str, title: str, code: str, *entries: Entry) -> Case:
    """Return a case with further members."""
    return zip_case(name, title, code, lambda: forge(good_entries() + list(entries)))


# --- members that are not stored as they are -----------------------------------------------------------


def _deflated(data: bytes) -> Entry:
    squeezer = zlib.compressobj(9, wbits=-15)
    squeezed = squeezer.compress(data) + squeezer.flush()
    fields = {"method": 8, "crc": zlib.crc32(data), "packed": len(squeezed), "size": len(data)}
    return Entry("buffers/bomb.bin", squeezed, both=fields)


def _bomb() -> bytes:
    """Return 50 MB in 49 kB."""
    return forge([*good_entries(), _deflated(bytes(50_000_000))])


def _by_zipfile(method: int) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for entry in good_entries():
            archive.writestr(zipfile.ZipInfo(entry.name), entry.data, method)
    return stream.getvalue()


def _descriptor() -> bytes:
    """Return a ZIP as streaming writers make it: sizes and CRC behind the data."""
    entries = good_entries()
    data = entries[1].data
    entries[1].both = {"flags": 8}
    entries[1].local = {"crc": 0, "packed": 0, "size": 0}
    entries[1].after = struct.pack("<4s3I", b"PK\x07\x08", zlib.crc32(data), len(data), len(data))
    return forge(entries)


def _bit_rot() -> bytes:
    color = good_entries()[3].data
    return forge(good_entries()).replace(color, color[:5] + bytes([color[5] ^ 16]) + color[6:])


_CRC = {"crc": 0x12345678}
_BOTH_SUMS = ("TRIASSET_CHECKSUM_MISMATCH",)

STORED_CASES = [
    zip_case("deflated", "a compressed archive", "ZIP_COMPRESSED", lambda: _by_zipfile(zipfile.ZIP_DEFLATED)),
    zip_case("bomb", "50 MB in 49 kB", "ZIP_COMPRESSED", _bomb),
    member("method_8", "stored data said to be deflated", "ZIP_COMPRESSED", both={"method": 8}),
    member("method_99", "a method that stands for AES", "ZIP_COMPRESSED", both={"method": 99}),
    member("manifest_lzma", "a manifest said to be LZMA", "ZIP_COMPRESSED", 0, both={"method": 14}),
    member("encrypted", "the flag of old encryption", "ZIP_ENCRYPTED", both={"flags": 0x01}),
    member("encrypted_strongly", "the flags of strong encryption", "ZIP_ENCRYPTED", both={"flags": 0x41}),
    member("masked", "the flag of masked headers", "ZIP_ENCRYPTED", both={"flags": 0x2000}),
    zip_case("descriptor", "sizes behind the data", "ZIP_HEADER_MISMATCH", _descriptor),
    member("crc", "a wrong CRC-32", "ZIP_CRC", both=_CRC, more={"found_by": "validate"}),
    member(
        "crc_manifest",
        "a wrong CRC-32 of the manifest",
        "ZIP_CRC",
        0,
        both=_CRC,
        more={"found_by": "validate"},
    ),
    zip_case("bit_rot", "one changed bit", "ZIP_CRC", _bit_rot, found_by="validate", also=_BOTH_SUMS),
    zip_case(
        "unaligned",
        "an archive as zipfile stores it",
        "ZIP_MISALIGNED",
        lambda: _by_zipfile(zipfile.ZIP_STORED),
    ),
    member("unaligned_buffer", "one buffer off the boundary", "ZIP_MISALIGNED", aligned=False),
    member(
        "unaligned_by_4",
        "a buffer on a 4-byte boundary",
        "ZIP_MISALIGNED",
        local={"extra": extra(PADDING_ID, bytes(9))},
    ),
]

# --- headers that contradict each other ----------------------------------------------------------------

_LOCAL_LIES: dict[str, Any] = {
    "name": b"buffers/positionz.bin",
    "size": 49,
    "packed": 47,
    "crc": 1,
    "method": 8,
    "flags": 0x800,
}

HEADER_CASES = [
    *(
        member(
            f"local_{key}", f"a local header with another {key}", "ZIP_HEADER_MISMATCH", local={key: value}
        )
        for key, value in _LOCAL_LIES.items()
    ),
    member(
        "local_encrypted", "only the local header says encrypted", "ZIP_HEADER_MISMATCH", local={"flags": 1}
    ),
    member(
        "local_descriptor",
        "only the local header has a descriptor",
        "ZIP_HEADER_MISMATCH",
        local={"flags": 8},
    ),
    member("local_short_name", "a local name cut short", "ZIP_HEADER_MISMATCH", local={"name": b"buffers/p"}),
    member("two_sizes", "a stored member of two sizes", "ZIP_HEADER_MISMATCH", both={"packed": 40}),
    member("offset_of_other", "the header of another member", "ZIP_HEADER_MISMATCH", central={"offset": 0}),
    member("offset_inside", "an offset into data", "ZIP_DIRECTORY", central={"offset": 100}),
    member("offset_past_end", "an offset behind the file", "ZIP_DIRECTORY", central={"offset": 0x7FFFFFFF}),
    member("local_signature", "a local header that is none", "ZIP_DIRECTORY", local={"signature": b"PK\3\5"}),
    member(
        "central_signature",
        "a central header that is none",
        "ZIP_DIRECTORY",
        central={"signature": b"PK\1\3"},
    ),
    member("size_past_end", "a size behind the file", "ZIP_DIRECTORY", both={"size": 10**9, "packed": 10**9}),
    member(
        "size_into_next", "a size into the next member", "ZIP_DIRECTORY", both={"size": 100, "packed": 100}
    ),
    member("size_less", "a size that leaves bytes over", "ZIP_FOREIGN_DATA", both={"size": 40, "packed": 40}),
    member("member_comment", "a comment on a member", "ZIP_DIRECTORY", central={"comment": b"hello"}),
    member("member_disk", "a member on another disk", "ZIP_DIRECTORY", central={"disk": 1}),
    member(
        "extra_overrun",
        "an extra record longer than its field",
        "ZIP_DIRECTORY",
        local={"extra": b"\x35\xd9\xff\x00"},
    ),
    member(
        "extra_central",
        "200 bytes of extra data, centrally",
        "ZIP_DIRECTORY",
        central={"extra": extra(PADDING_ID, bytes(200))},
    ),
    member(
        "extra_64_kb",
        "64 kB of extra data",
        "ZIP_FOREIGN_DATA",
        local={"extra": extra(PADDING_ID, bytes(65_000))},
    ),
    forged("count_less", "fewer members than there are", "ZIP_DIRECTORY", end={"here": 3, "count": 3}),
    forged("count_more", "more members than there are", "ZIP_DIRECTORY", end={"here": 5, "count": 5}),
    forged("count_here", "members on another disk", "ZIP_DIRECTORY", end={"here": 3}),
    forged("disk", "the second of two disks", "ZIP_DIRECTORY", end={"disk": 1}),
    forged("first_disk", "a directory on another disk", "ZIP_DIRECTORY", end={"first_disk": 1}),
    forged("directory_late", "a directory after the file", "ZIP_DIRECTORY", end={"start": 10**9}),
    forged("directory_early", "a directory at byte 0", "ZIP_FOREIGN_DATA", end={"start": 0}),
    forged("directory_long", "a directory longer than the file", "ZIP_DIRECTORY", end={"length": 10**9}),
    forged("directory_short", "a directory of 0 bytes", "ZIP_FOREIGN_DATA", end={"length": 0}),
]

# --- bytes that belong to nobody -----------------------------------------------------------------------


def _hidden_member() -> bytes:
    """Return a ZIP whose first member is in no directory: a streaming reader sees another manifest."""
    entries = good_entries()
    hidden = forge([Entry("manifest.json", b"{}")])
    entries[0].before = hidden[: hidden.index(b"PK\x01\x02")]
    return forge(entries)


FOREIGN = "ZIP_FOREIGN_DATA"

FOREIGN_CASES = [
    patched("prefix_program", "a program before the ZIP", FOREIGN, lambda z: b"MZ" + bytes(62) + z),
    patched("prefix_pdf", "a PDF that is also a ZIP", FOREIGN, lambda z: b"%PDF-1.7\n" + z),
    patched("prefix_spanned", "the mark of a split archive", FOREIGN, lambda z: b"PK\x07\x08" + z),
    member("prefix_offsets", "a prefix with corrected offsets", FOREIGN, 0, before=b"#!/bin/sh\n".ljust(64)),
    zip_case("hidden_member", "a member in no directory", FOREIGN, _hidden_member),
    member("between", "a byte between two members", FOREIGN, 2, before=b"\0"),
    member("between_64", "64 bytes between two members", FOREIGN, 2, before=bytes(64)),
    forged("before_directory", "data before the directory", FOREIGN, before_directory=b"secret"),
    patched("suffix_byte", "a byte behind the ZIP", FOREIGN, lambda z: z + b"\0"),
    patched("suffix_line_break", "a line break behind the ZIP", FOREIGN, lambda z: z + b"\n"),
    patched("suffix_64_kb", "64 kB behind the ZIP", FOREIGN, lambda z: z + bytes(65_535)),
    patched("twice", "two assets in one file", FOREIGN, lambda z: z + z),
    patched("end_twice", "two end records", FOREIGN, lambda z: z + z[-22:]),
    forged("comment", "a comment", FOREIGN, end={"comment": b"hello"}),
    patched("comment_lie", "the length of a comment that is not there", FOREIGN, lambda z: z[:-2] + b"\5\0"),
]

CASES = [*STORED_CASES, *HEADER_CASES, *FOREIGN_CASES]

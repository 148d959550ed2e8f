"""Packed assets that are not stored as they are, contradict themselves or hold more (class 33)."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

from tests.corpus.case import Case
from tests.corpus.forge import PADDING_ID, Entry, extra, forge
from tests.corpus.good import mesh, parts


def good_entries() -> list[Entry]:
    """Return the members of a good asset: the manifest, positions, indices and color."""
    return parts(mesh()).entries()


def from_bytes(name: str, code: str, make: Callable[[], bytes], **more: Any) -> Case:
    """Return a case whose file holds the bytes that `make` returns."""
    return Case(name, code, lambda path: path.write_bytes(make()) and None, **more)


def zip_case(name: str, code: str, make: Callable[[], bytes], **more: Any) -> Case:
    return from_bytes(f"zip_{name}", f"TRIASSET_{code}", make, **more)


def forged(name: str, code: str, **spoil: Any) -> Case:
    """Return a case of good members and keywords of `forge`."""
    return zip_case(name, code, lambda: forge(good_entries(), **spoil))


def patched(name: str, code: str, patch: Callable[[bytes], bytes]) -> Case:
    """Return a case that is `patch` of a good file."""
    return zip_case(name, code, lambda: patch(forge(good_entries())))


def member(name: str, code: str, which: int = 1, /, more: Any = None, **changes: Any) -> Case:
    """Return a case in which one member (positions, if not said) has other attributes of `Entry`."""

    def make() -> bytes:
        entries = good_entries()
        for key, value in changes.items():
            setattr(entries[which], key, value)
        return forge(entries)

    return zip_case(name, code, make, **(more or {}))


def added(name: str, code: str, *entries: Entry) -> Case:
    """Return a case with further members."""
    return zip_case(name, code, lambda: forge(good_entries() + list(entries)))


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
_BOTH_SUMS = ("TRIASSET_DAMAGED",)

STORED_CASES = [
    zip_case("deflated", "FORM", lambda: _by_zipfile(zipfile.ZIP_DEFLATED)),
    zip_case("bomb", "FORM", _bomb),
    member("method_8", "FORM", both={"method": 8}),
    member("method_99", "FORM", both={"method": 99}),
    member("manifest_lzma", "FORM", 0, both={"method": 14}),
    member("encrypted", "FORM", both={"flags": 0x01}),
    member("encrypted_strongly", "FORM", both={"flags": 0x41}),
    member("masked", "FORM", both={"flags": 0x2000}),
    zip_case("descriptor", "HOSTILE", _descriptor),
    member("crc", "DAMAGED", both=_CRC, more={"found_by": "validate"}),
    member("crc_manifest", "DAMAGED", 0, both=_CRC, more={"found_by": "validate"}),
    zip_case("bit_rot", "DAMAGED", _bit_rot, found_by="validate", also=_BOTH_SUMS),
    zip_case("unaligned", "FORM", lambda: _by_zipfile(zipfile.ZIP_STORED)),
    member("unaligned_buffer", "FORM", aligned=False),
    member("unaligned_by_4", "FORM", local={"extra": extra(PADDING_ID, bytes(9))}),
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
    *(member(f"local_{key}", "HOSTILE", local={key: value}) for key, value in _LOCAL_LIES.items()),
    member("local_encrypted", "HOSTILE", local={"flags": 1}),
    member("local_descriptor", "HOSTILE", local={"flags": 8}),
    member("local_short_name", "HOSTILE", local={"name": b"buffers/p"}),
    member("two_sizes", "HOSTILE", both={"packed": 40}),
    member("offset_of_other", "HOSTILE", central={"offset": 0}),
    member("offset_inside", "DAMAGED", central={"offset": 100}),
    member("offset_past_end", "DAMAGED", central={"offset": 0x7FFFFFFF}),
    member("local_signature", "DAMAGED", local={"signature": b"PK\3\5"}),
    member("central_signature", "DAMAGED", central={"signature": b"PK\1\3"}),
    member("size_past_end", "DAMAGED", both={"size": 10**9, "packed": 10**9}),
    member("size_into_next", "DAMAGED", both={"size": 100, "packed": 100}),
    member("size_less", "HOSTILE", both={"size": 40, "packed": 40}),
    member("member_comment", "DAMAGED", central={"comment": b"hello"}),
    member("member_disk", "DAMAGED", central={"disk": 1}),
    member("extra_overrun", "DAMAGED", local={"extra": b"\x35\xd9\xff\x00"}),
    member("extra_central", "DAMAGED", central={"extra": extra(PADDING_ID, bytes(200))}),
    member("extra_64_kb", "HOSTILE", local={"extra": extra(PADDING_ID, bytes(65_000))}),
    forged("count_less", "DAMAGED", end={"here": 3, "count": 3}),
    forged("count_more", "DAMAGED", end={"here": 5, "count": 5}),
    forged("count_here", "DAMAGED", end={"here": 3}),
    forged("disk", "DAMAGED", end={"disk": 1}),
    forged("first_disk", "DAMAGED", end={"first_disk": 1}),
    forged("directory_late", "DAMAGED", end={"start": 10**9}),
    forged("directory_early", "HOSTILE", end={"start": 0}),
    forged("directory_long", "DAMAGED", end={"length": 10**9}),
    forged("directory_short", "HOSTILE", end={"length": 0}),
]

# --- bytes that belong to nobody -----------------------------------------------------------------------


def _hidden_member() -> bytes:
    """Return a ZIP whose first member is in no directory: a streaming reader sees another manifest."""
    entries = good_entries()
    hidden = forge([Entry("manifest.json", b"{}")])
    entries[0].before = hidden[: hidden.index(b"PK\x01\x02")]
    return forge(entries)


FOREIGN = "HOSTILE"

FOREIGN_CASES = [
    patched("prefix_program", FOREIGN, lambda z: b"MZ" + bytes(62) + z),
    patched("prefix_pdf", FOREIGN, lambda z: b"%PDF-1.7\n" + z),
    patched("prefix_spanned", FOREIGN, lambda z: b"PK\x07\x08" + z),
    member("prefix_offsets", FOREIGN, 0, before=b"#!/bin/sh\n".ljust(64)),
    zip_case("hidden_member", FOREIGN, _hidden_member),
    member("between", FOREIGN, 2, before=b"\0"),
    member("between_64", FOREIGN, 2, before=bytes(64)),
    forged("before_directory", FOREIGN, before_directory=b"secret"),
    patched("suffix_byte", FOREIGN, lambda z: z + b"\0"),
    patched("suffix_line_break", FOREIGN, lambda z: z + b"\n"),
    patched("suffix_64_kb", FOREIGN, lambda z: z + bytes(65_535)),
    patched("twice", FOREIGN, lambda z: z + z),
    patched("end_twice", FOREIGN, lambda z: z + z[-22:]),
    forged("comment", FOREIGN, end={"comment": b"hello"}),
    patched("comment_lie", FOREIGN, lambda z: z[:-2] + b"\5\0"),
]

CASES = [*STORED_CASES, *HEADER_CASES, *FOREIGN_CASES]

"""Packed assets with names, kinds, numbers of members or ZIP64 records that none has (class 33)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import Any

from tests.corpus.bad_zips import added, forged, good_entries, member, zip_case
from tests.corpus.case import Case
from tests.corpus.forge import Entry, extra, forge, zip64

_FULL16, _FULL32 = 0xFFFF, 0xFFFFFFFF

# --- names ---------------------------------------------------------------------------------------------

_NAMES = [
    "buffers/",
    "/buffers/x.bin",
    "../x.bin",
    "buffers/../x.bin",
    "buffers/../../../../etc/cron.d/x.bin",
    "buffers\\x.bin",
    "C:/x.bin",
    "//host/share/x.bin",
    "./manifest.json",
    "manifest.json/",
    "manifest.json\0",
    "manifest.json\n",
    "manifest.json ",
    "MANIFEST.JSON",
    "buffers/a/b.bin",
    "buffers/.x.bin",
    "buffers/\uff0e\uff0e.bin",
    "buffers/\u202enib.bin",
    "buffers/x\x1b[2J.bin",
    "__MACOSX/._manifest.json",
    "META-INF/MANIFEST.MF",
    "inner.zip",
    "asset.triasset",
    "",
    "x" * 60_000,
]


def _name_code(name: str) -> Case:
    shown = f"{_NAMES.index(name):02}"
    return added(f"name_{shown}", "FORM", Entry(name, b"x"))


def _raw_name(raw: bytes, flags: int) -> Entry:
    return Entry("", b"x", both={"name": raw, "flags": flags})


_UNICODE_PATH = extra(0x7075, b"\1" + struct.pack("<I", zlib.crc32(b"buffers/positions.bin")) + b"../x")
_POSITIONS = "buffers/positions.bin"

NAME_CASES = [
    *(_name_code(name) for name in _NAMES),
    added("name_cp437", "FORM", _raw_name(b"buffers/\x82.bin", 0)),
    added("name_not_utf8", "FORM", _raw_name(b"buffers/\xff.bin", 0x800)),
    member("second_name", "FORM", central={"extra": _UNICODE_PATH}),
    member("second_local_name", "FORM", local={"extra": _UNICODE_PATH}),
    added("manifest_twice", "HOSTILE", Entry("manifest.json", b"{}")),
    added("buffer_twice", "HOSTILE", Entry(_POSITIONS, bytes(48))),
    added("case_twins", "PATH", Entry("buffers/Positions.bin", b"x")),
    added("nested", "FILE_UNDECLARED", Entry("buffers/inner.bin", forge([]))),
    added("device_name", "FILE_UNDECLARED", Entry("buffers/con.bin", b"x")),
    zip_case("no_manifest", "MANIFEST_MISSING", lambda: forge(good_entries()[1:])),
    zip_case("no_members", "MANIFEST_MISSING", lambda: forge([])),
    member("manifest_is_zip", "MANIFEST", 0, data=forge([Entry("\xff", b"\xff")])),
    member("manifest_2_mib", "MANIFEST", 0, data=b" " * (2 << 20)),
    member("manifest_no_bytes", "MANIFEST", 0, data=b""),
]

# --- kinds, counts, overlaps ---------------------------------------------------------------------------

_UNIX, _MACOS, _DOS = 3 << 8 | 20, 19 << 8 | 20, 20


def _kind(name: str, code: str, made_by: int, attributes: int) -> Case:
    return member(name, code, central={"made_by": made_by, "attributes": attributes})


def _many(count: int, **end: Any) -> Callable[[], bytes]:
    """Return a function that makes a ZIP of a good asset and `count` empty members."""

    def make() -> bytes:
        members = (Entry(f"buffers/{i}.bin", b"", aligned=False) for i in range(count))
        return forge([*good_entries(), *members], **end)

    return make


def _inside_another() -> bytes:
    """Return a ZIP with a member inside the data of another: its bytes have two meanings."""
    entries = good_entries()
    inner = forge([Entry("buffers/inner.bin", b"secret" * 20)])
    entries[1].data = inner[: inner.index(b"PK\x01\x02")]
    offset = forge(entries).index(entries[1].data)
    entries.append(Entry("buffers/inner.bin", b"secret" * 20, central={"offset": offset}, listed_only=True))
    return forge(entries)


def _listed_twice(name: str) -> Entry:
    """Return a directory entry called `name` for the first member, the manifest."""
    manifest = good_entries()[0]
    return Entry(name, manifest.data, central={"offset": 0}, listed_only=True)


KIND_CASES = [
    _kind("link", "PATH", _UNIX, 0o120777 << 16),
    _kind("link_macos", "PATH", _MACOS, 0o120777 << 16),
    _kind("link_dos", "PATH", _DOS, 0o120777 << 16),
    _kind("pipe", "PATH", _UNIX, 0o010644 << 16),
    _kind("device", "PATH", _UNIX, 0o060644 << 16),
    _kind("folder_unix", "PATH", _UNIX, 0o040755 << 16),
    _kind("folder_dos", "PATH", _DOS, 0x10),
    zip_case("66_members", "FORM", _many(62)),
    zip_case(
        "70000_members",
        "FORM",
        _many(70_000, end64={}, end={"here": _FULL16, "count": _FULL16}),
    ),
    zip_case("inside_another", "DAMAGED", _inside_another),
    added("listed_twice", "HOSTILE", _listed_twice("manifest.json")),
    added("listed_renamed", "HOSTILE", _listed_twice("buffers/x.bin")),
]

# --- ZIP64 ---------------------------------------------------------------------------------------------

_LONG = {"size": _FULL32, "packed": _FULL32}
_MANY = {"here": _FULL16, "count": _FULL16}


def _lie64(name: str, code: str = "HOSTILE", **headers: Any) -> Case:
    return member(f"zip64_{name}", code, **headers)


ZIP64_CASES = [
    forged("zip64_end_missing", "HOSTILE", end=_MANY),
    forged("zip64_start_missing", "HOSTILE", end={"start": _FULL32}),
    forged("zip64_end_differs", "HOSTILE", end64={"count": 3}),
    forged("zip64_start_differs", "HOSTILE", end64={"start": 0}),
    forged("zip64_locator", "HOSTILE", end64={"at": 0}),
    forged("zip64_disks", "HOSTILE", end64={"disks": 2}),
    forged("zip64_disk", "HOSTILE", end64={"disk": 1}),
    forged("zip64_record_size", "HOSTILE", end64={"record_size": 45}),
    forged("zip64_huge_record", "HOSTILE", end64={"record_size": 2**63}),
    forged("zip64_count", "FORM", end=_MANY, end64={"here": 2**40, "count": 2**40}),
    forged("zip64_length", "DAMAGED", end={"length": _FULL32}, end64={"length": 2**63}),
    forged("zip64_start", "DAMAGED", end={"start": _FULL32}, end64={"start": 2**64 - 1}),
    _lie64("record_missing", central=_LONG),
    _lie64("record_short", central={**_LONG, "extra": zip64(48)}),
    _lie64("record_long", central={**_LONG, "extra": zip64(48, 48, 0)}),
    _lie64("record_twice", central={**_LONG, "extra": zip64(48, 48) * 2}),
    _lie64("record_unasked", central={"extra": zip64(48, 48)}),
    _lie64("record_odd", central={**_LONG, "extra": extra(1, bytes(17))}),
    _lie64("local_missing", local=_LONG),
    _lie64("local_differs", "HOSTILE", local={**_LONG, "extra": zip64(49, 49)}),
    _lie64("sizes_differ", "HOSTILE", central={**_LONG, "extra": zip64(48, 49)}),
    _lie64("size_2_63", "DAMAGED", central={**_LONG, "extra": zip64(2**63, 2**63)}),
    _lie64("offset_2_63", "DAMAGED", central={"offset": _FULL32, "extra": zip64(2**63)}),
]

CASES = [*NAME_CASES, *KIND_CASES, *ZIP64_CASES]

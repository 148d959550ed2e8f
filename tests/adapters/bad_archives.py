"""Checkpoints that are something else, archives that lie, and files of before torch 1.6 that do."""

from __future__ import annotations

import io
import struct
import tarfile
import zipfile
from collections.abc import Callable
from typing import Any

from msb.adapters.checkpoint.archive import MAX_MEMBERS
from tests.adapters.assemble import (
    GOOD,
    MAGIC,
    SYSTEM,
    VALUES,
    Case,
    archive,
    described,
    entries,
    legacy,
    name,
    program,
    storage,
    tensor,
    text,
    torch_entry,
)
from tests.corpus.forge import Entry, Fields, extra, forge, local_header, zip64


def bad(label: str, code: str, make: bytes | Callable[[], bytes]) -> Case:
    return Case(label, f"CHECKPOINT_{code}", make if callable(make) else lambda: make)


def zipped(label: str, code: str, members: Any = None, **spoil: Any) -> Case:
    """Return a case made by `forge`, from the members of a good archive or those that a function makes."""
    make = entries if members is None else members
    return bad(f"zip_{label}", code, lambda: forge(make(), **{"end64": {}, **spoil}))


def member(label: str, code: str, which: int = 0, **changes: Fields) -> Case:
    """Return a case in which fields of one member's headers (data.pkl, if not said) are others."""

    def make() -> list[Entry]:
        parts = entries()
        for key, value in changes.items():
            attribute = getattr(parts[which], key)
            setattr(parts[which], key, {**attribute, **value} if isinstance(value, dict) else value)
        return parts

    return zipped(label, code, make)


def added(label: str, code: str, *more: Entry) -> Case:
    return bad(label, code, lambda: forge([*entries(), *more], end64={}))


def without(label: str, code: str, *gone: str) -> Case:
    return bad(label, code, lambda: forge([e for e in entries() if not e.name.endswith(gone)], end64={}))


# --- other kinds of file ------------------------------------------------------------------------------


def tar() -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as file:
        for part in ("storages", "tensors", "pickle"):
            file.addfile(tarfile.TarInfo(part), io.BytesIO())
    return out.getvalue()


def safetensors() -> bytes:
    head = b'{"w":{"dtype":"F32","shape":[6],"data_offsets":[0,24]}}'
    return struct.pack("<Q", len(head)) + head + VALUES


def by_zipfile(method: int) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as file:
        for entry in entries():
            file.writestr(zipfile.ZipInfo(entry.name), entry.data, method)
    return out.getvalue()


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1234\n"
KIND_CASES = [
    bad("empty", "DAMAGED", b""),
    bad("zeros", "NOT_RECOGNISED", bytes(4096)),
    bad("one_byte", "NOT_RECOGNISED", b"P"),
    bad("words", "NOT_RECOGNISED", b"<!DOCTYPE html><html>404</html>"),
    bad("lfs_pointer", "NOT_RECOGNISED", LFS),
    bad("text_pickle", "NOT_RECOGNISED", b"cos\nsystem\n(S'id'\ntR."),
    bad("bare_pickle", "FORM", program(b"}")),
    bad("bare_pickle_5", "FORM", b"\x80\x05N."),
    bad("bare_attack", "FORM", program(name("os", "system"))),
    bad("tar", "FORM", tar),
    bad("safetensors", "NOT_RECOGNISED", safetensors),
    added("torchscript_constants", "NOT_RECOGNISED", torch_entry("archive/constants.pkl", GOOD)),
    added("torchscript_code", "NOT_RECOGNISED", torch_entry("archive/code/__torch__.py", b"")),
    without("no_pickle", "NOT_RECOGNISED", "data.pkl"),
    bad("npz", "NOT_RECOGNISED", lambda: forge([Entry("a.npy", b"")])),
    bad("no_members", "NOT_RECOGNISED", lambda: forge([])),
    added("two_pickles", "HOSTILE", torch_entry("other/data.pkl", GOOD)),
    added("pickle_as_storage", "HOSTILE", torch_entry("archive/data/data.pkl", GOOD)),
    without("no_version", "FORM", "/version"),
    *(
        bad(f"version_{label}", "FORM", archive(version=value))
        for label, value in (
            ("zero", b"0\n"),
            ("one", b"1\n"),
            ("eleven", b"11\n"),
            ("negative", b"-3"),
            ("text", b"three"),
            ("empty", b""),
            ("long", b"3" * 5000),
            ("arabic", "٣".encode()),
        )
    ),
    *(
        bad(f"byteorder_{label}", "FORM", archive(byteorder=value))
        for label, value in (("big", b"big"), ("empty", b""), ("native", b"native"), ("upper", b"LITTLE"))
    ),
]


def nested() -> list[Entry]:
    """Return an archive with a member whose headers and bytes are those of another member's data."""
    inner = Entry("archive/data/0", VALUES, aligned=False)
    outer = Entry("archive/data/1", local_header(inner, 0) + VALUES, aligned=False)
    inner.listed_only, inner.central = True, {"offset": 30 + len(outer.name)}
    return [outer, inner, *entries(data={})]


# --- the archive --------------------------------------------------------------------------------------

ZIP_CASES = [
    bad("zip_cut_in_half", "DAMAGED", lambda: archive()[: len(archive()) // 2]),
    bad("zip_cut_by_one", "DAMAGED", lambda: archive()[:-1]),
    bad("zip_prefix", "HOSTILE", lambda: b"#!/bin/sh\n" + archive()),
    zipped("suffix", "HOSTILE", suffix=b"\0"),
    zipped("comment", "HOSTILE", end={"comment": b"hello"}, suffix=b""),
    zipped("gap", "HOSTILE", before_directory=b"hidden"),
    member("gap_between", "HOSTILE", 1, before=b"hidden"),
    bad("zip_deflated", "FORM", lambda: by_zipfile(zipfile.ZIP_DEFLATED)),
    member("lzma", "FORM", both={"method": 14}),
    member("encrypted", "FORM", both={"flags": 0x809}),
    member("encrypted_storage", "FORM", 4, both={"flags": 0x849}),
    added("zip_twice", "HOSTILE", torch_entry("archive/data.pkl", GOOD)),
    added("zip_letter_twice", "HOSTILE", torch_entry("a", b""), torch_entry("a", b"")),
    added("zip_storage_twice", "HOSTILE", torch_entry("archive/data/0", VALUES)),
    added("zip_name_control", "FORM", torch_entry("archive/\x1b[2J", b"")),
    added("zip_name_long", "FORM", torch_entry("a" * 600, b"")),
    added("zip_name_empty", "FORM", torch_entry("", b"")),
    member("name_latin", "FORM", 1, both={"name": b"archive/\xe9"}),
    *(
        bad(f"zip_root_{label}", "FORM", archive(root=root))
        for label, root in (("deep", "a/b"), ("up", ".."), ("here", "."), ("absolute", ""))
    ),
    bad("zip_no_root", "FORM", lambda: forge([torch_entry("data.pkl", GOOD)])),
    member("local_name", "HOSTILE", local={"name": b"archive/data.pkI"}),
    member("local_method", "HOSTILE", local={"method": 8}),
    member("local_flags", "HOSTILE", local={"flags": 0}),
    member("local_size", "HOSTILE", local={"size": 7}),
    member("two_sizes", "HOSTILE", central={"packed": 7}),
    member("no_descriptor", "HOSTILE", after=b""),
    member("descriptor_size", "HOSTILE", 4, after=described(0, 24)),
    member("crc", "DAMAGED", both={"crc": 5}, after=described(5, len(GOOD))),
    bad("zip_bit_rot", "DAMAGED", lambda: archive().replace(b"w", b"v", 1)),
    zipped("central_signature", "DAMAGED", lambda: [Entry("a/b", b"", central={"signature": b"PK\1\3"})]),
    zipped(
        "local_signature",
        "DAMAGED",
        lambda: [*entries(), Entry("a/b", b"", local={"signature": b"PK\3\5"})],
    ),
    member("offset_far", "DAMAGED", central={"offset": 1 << 30}),
    member("size_far", "DAMAGED", 4, central={"size": 3 << 30, "packed": 3 << 30}),
    bad("zip_overlap", "DAMAGED", lambda: forge(nested(), end64={})),
    member("member_comment", "DAMAGED", central={"comment": b"x"}),
    member("disk", "DAMAGED", central={"disk": 1}),
    member("extra_over", "DAMAGED", central={"extra": b"FB\xff\xff"}),
    zipped("disks", "DAMAGED", end64={"disk": 0, "here": 3}, end={"here": 3}),
    zipped("length", "DAMAGED", end64={"length": 9999}, end={"length": 9999}),
    zipped("count_more", "DAMAGED", end64={"count": 9, "here": 9}, end={"count": 9, "here": 9}),
    zipped("count_less", "DAMAGED", end64={"count": 3, "here": 3}, end={"count": 3, "here": 3}),
    zipped(
        "many_declared",
        "FORM",
        end64={"count": 1 << 60, "here": 1 << 60},
        end={"count": 0xFFFF, "here": 0xFFFF},
    ),
    zipped("many", "FORM", lambda: [Entry(f"archive/data/{n}", b"") for n in range(MAX_MEMBERS + 1)]),
    zipped("end_contradicts", "HOSTILE", end64={"count": 3}),
    zipped("end64_missing", "HOSTILE", end64=None, end={"start": 0xFFFFFFFF}),
    zipped("end64_elsewhere", "HOSTILE", end64={"at": 0}),
    zipped("end64_size", "HOSTILE", end64={"record_size": 1000}),
    member("zip64_missing", "HOSTILE", central={"size": 0xFFFFFFFF}),
    member("zip64_unasked", "HOSTILE", central={"extra": zip64(len(GOOD))}),
    member("zip64_odd", "HOSTILE", central={"extra": extra(1, bytes(5))}),
    member("zip64_local", "HOSTILE", local={"extra": zip64(7, 7)}),
    member(
        "zip64_huge",
        "DAMAGED",
        4,
        central={"size": 0xFFFFFFFF, "packed": 0xFFFFFFFF, "extra": zip64(1 << 62, 1 << 62)},
    ),
    member(
        "zip64_twice",
        "HOSTILE",
        4,
        central={"size": 0xFFFFFFFF, "packed": 0xFFFFFFFF, "extra": zip64(24, 24) + extra(1, bytes(16))},
    ),
]

# --- files of before torch 1.6 ------------------------------------------------------------------------

SIX = struct.pack("<q", 6) + VALUES
KEYS = b"\x80\x02](" + text("0") + b"e."


def old(label: str, code: str, make: bytes | Callable[[], bytes]) -> Case:
    return bad(f"legacy_{label}", code, make)


LEGACY_CASES = [
    old("magic_more", "HOSTILE", legacy(magic=b"\x80\x02" + MAGIC + b"N.")),
    old("magic_sign", "DAMAGED", legacy(magic=b"\x80\x02" + MAGIC + b"\x85.")),
    old("version", "DAMAGED", legacy(version=b"\x80\x02M\xea\x03.")),
    old("version_text", "DAMAGED", legacy(version=program(text("1001")))),
    old("system", "DAMAGED", legacy(system=program(b"}"))),
    old("system_list", "DAMAGED", legacy(system=program(b"]"))),
    old("big", "FORM", legacy(system=SYSTEM.replace(b"\x88", b"\x89"))),
    old("attack_header", "HOSTILE", legacy(system=program(name("os", "system")))),
    old("attack", "HOSTILE", legacy(program(name("os", "system"), b")R"))),
    old("attack_keys", "HOSTILE", legacy(keys=program(name("os", "system")))),
    old("view", "HOSTILE", legacy(program(storage(more=b"}")))),
    old("cut_magic", "DAMAGED", legacy()[:15]),
    old("cut_value", "DAMAGED", lambda: legacy()[:120]),
    old("keys_none", "DAMAGED", legacy(keys=program(b"N"))),
    old("keys_empty", "DAMAGED", legacy(keys=program(b"]"))),
    old("keys_other", "DAMAGED", legacy(keys=KEYS.replace(b"0", b"7"))),
    old("keys_numbers", "DAMAGED", legacy(keys=program(b"](K\0e"))),
    old(
        "keys_twice",
        "DAMAGED",
        legacy(
            program(b"]", tensor(), b"a", tensor(storage(key="1")), b"a"),
            keys=program(b"](" + text("0") * 2 + b"e"),
            storages=SIX * 2,
        ),
    ),
    old("trailing", "DAMAGED", legacy(storages=SIX + b"\0")),
    old("cut_storage", "DAMAGED", legacy(storages=SIX[:-1])),
    old("no_storage", "DAMAGED", legacy(storages=b"")),
    old("count", "DAMAGED", legacy(storages=struct.pack("<q", 5) + VALUES)),
    old("count_negative", "DAMAGED", legacy(storages=b"\xff" * 8 + VALUES)),
    old("huge", "DAMAGED", legacy(program(tensor(storage(count=1 << 62))))),
    old("outside", "HOSTILE", legacy(program(tensor(size=(3, 3))))),
    old("deep", "HOSTILE", legacy(program(b"]q\0", tensor(), b"ah\0a"))),
    old("too_large", "FORM", lambda: legacy(program(text(b"x" * (16 << 20))))),
]

CASES = [*KIND_CASES, *ZIP_CASES, *LEGACY_CASES]

"""Bad checkpoints: other kinds of files, invalid archives, and invalid files in the layout of
torch before version 1.6.
"""

import io
import struct
import tarfile
import zipfile
from collections.abc import Callable

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
    text,
    torch_entry,
)
from tests.corpus.forge import Entry, Fields, forge


def bad(label: str, code: str, make: bytes | Callable[[], bytes]) -> Case:
    return Case(label, f"CHECKPOINT_{code}", make if callable(make) else lambda: make)


def member(label: str, code: str, which: int = 0, **changes: Fields) -> Case:
    """Return a case in which header fields of a member, by default data.pkl, are changed."""

    def make() -> list[Entry]:
        parts = entries()
        for key, value in changes.items():
            attribute = getattr(parts[which], key)
            setattr(parts[which], key, {**attribute, **value} if isinstance(value, dict) else value)
        return parts

    return bad(f"zip_{label}", code, lambda: forge(make(), end64={}))


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


KIND_CASES = [
    bad("empty", "DAMAGED", b""),
    bad("zeros", "NOT_RECOGNISED", bytes(4096)),
    bad("bare_pickle", "FORM", program(b"}")),
    bad("tar", "FORM", tar),
    bad("safetensors", "NOT_RECOGNISED", safetensors),
    added("torchscript_code", "NOT_RECOGNISED", torch_entry("archive/code/__torch__.py", b"")),
    added("pickle_as_storage", "HOSTILE", torch_entry("archive/data/data.pkl", GOOD)),
    without("no_version", "FORM", "/version"),
    *(
        bad(f"version_{label}", "FORM", archive(version=value))
        for label, value in (
            ("empty", b""),
            ("arabic", "٣".encode()),
        )
    ),
    *(
        bad(f"byteorder_{label}", "FORM", archive(byteorder=value))
        for label, value in (
            ("big", b"big"),
            ("empty", b""),
        )
    ),
]


# --- the archive --------------------------------------------------------------------------------------

ZIP_CASES = [
    bad("zip_deflated", "FORM", lambda: by_zipfile(zipfile.ZIP_DEFLATED)),
    added("zip_storage_twice", "HOSTILE", torch_entry("archive/data/0", VALUES)),
    added("zip_name_control", "FORM", torch_entry("archive/\x1b[2J", b"")),
    bad("zip_root_up", "FORM", archive(root="..")),
    bad("zip_no_root", "FORM", lambda: forge([torch_entry("data.pkl", GOOD)])),
    member("descriptor_size", "HOSTILE", 4, after=described(0, 24)),
    member("crc", "DAMAGED", both={"crc": 5}, after=described(5, len(GOOD))),
    bad(
        "zip_many",
        "FORM",
        lambda: forge([Entry(f"archive/data/{n}", b"") for n in range(MAX_MEMBERS + 1)], end64={}),
    ),
]

# --- files in the older layout ------------------------------------------------------------------------

SIX = struct.pack("<q", 6) + VALUES
KEYS = b"\x80\x02](" + text("0") + b"e."


def old(label: str, code: str, make: bytes | Callable[[], bytes]) -> Case:
    return bad(f"legacy_{label}", code, make)


LEGACY_CASES = [
    old("magic_more", "HOSTILE", legacy(magic=b"\x80\x02" + MAGIC + b"N.")),
    old("version", "DAMAGED", legacy(version=b"\x80\x02M\xea\x03.")),
    old("system", "DAMAGED", legacy(system=program(b"}"))),
    old("big", "FORM", legacy(system=SYSTEM.replace(b"\x88", b"\x89"))),
    old("attack_header", "HOSTILE", legacy(system=program(name("os", "system")))),
    old("view", "HOSTILE", legacy(program(storage(more=b"}")))),
    old("cut_value", "DAMAGED", lambda: legacy()[:120]),
    old("keys_other", "DAMAGED", legacy(keys=KEYS.replace(b"0", b"7"))),
    old("trailing", "DAMAGED", legacy(storages=SIX + b"\0")),
    old("cut_storage", "DAMAGED", legacy(storages=SIX[:-1])),
    old("count", "DAMAGED", legacy(storages=struct.pack("<q", 5) + VALUES)),
]

CASES = [*KIND_CASES, *ZIP_CASES, *LEGACY_CASES]

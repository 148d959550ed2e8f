"""The archive `torch.save` writes since torch 1.6: its members and what they say.

All names start with one folder, which is called like the file's stem, or
``archive`` when saved into an open file. It holds ``data.pkl``, ``data/0``, ``data/1`` ... (one per storage),
``version`` and, in newer files, ``byteorder``. We need none of its other members (``.format_version``,
``.storage_alignment``, ``.data/serialization_id``). Source: pytorch/pytorch `torch/serialization.py`,
`caffe2/serialize/versions.h`.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, Any

from msb.adapters.checkpoint.pickle_machine import run_pickle
from msb.adapters.checkpoint.refusal import Refusal
from msb.adapters.checkpoint.tensors import Extent, Storages
from msb.adapters.checkpoint.zip_members import is_script, read_members, refuse_script
from msb.errors import shorten

if TYPE_CHECKING:
    from msb.asset.strict_zip import Member

MAX_PICKLE = 16 << 20
"""Most bytes of data.pkl. It holds no tensor's values, so it has kilobytes in practice; a million losses take
9 MiB."""
VERSIONS = range(2, 11)
"""Versions that are read. torch accepts versions up to 10 and writes 3; version 1 had another layout."""
_PICKLE, _DATA = "data.pkl", "data/"


def read_archive(view: memoryview) -> Any:
    """Return what is saved in the archive `view`."""
    members = read_members(view)
    root = _root(members)
    _check_version(view, members.get(f"{root}version"))
    _check_byte_order(view, members.get(f"{root}byteorder"))
    prefix = root + _DATA
    places = {
        name[len(prefix) :]: Extent(member.offset, member.size)
        for name, member in members.items()
        if name.startswith(prefix)
    }
    program = _program(view, members[root + _PICKLE])
    value, end = run_pickle(program, Storages(view, places), where="data.pkl ")
    if end != len(program):
        text = f"data.pkl goes on for {len(program) - end} bytes after its end"
        raise Refusal("CHECKPOINT_HOSTILE", text, at=f"data.pkl byte {end}")
    return value


def _root(members: dict[str, Member]) -> str:
    """Return the folder of the only data.pkl, with its slash."""
    roots = [name[: -len(_PICKLE)] for name in members if name == _PICKLE or name.endswith("/" + _PICKLE)]
    for name in filter(is_script, members):
        refuse_script(name)
    if not roots:
        raise Refusal(
            "CHECKPOINT_NOT_RECOGNISED", "it is an archive without data.pkl, so not from torch.save"
        )
    if len(roots) > 1:
        raise Refusal("CHECKPOINT_HOSTILE", f"it holds {len(roots)} files data.pkl; torch writes one")
    root = roots[0]
    if root.count("/") != 1 or root in ("/", "./", "../"):
        text = f"data.pkl is in {shorten(repr(root), 40)}; it has to be in one folder"
        raise Refusal("CHECKPOINT_FORM", text)
    return root


def _program(view: memoryview, member: Member) -> bytes:
    if member.size > MAX_PICKLE:
        text = f"data.pkl has {member.size} bytes; at most {MAX_PICKLE} are read"
        raise Refusal("CHECKPOINT_FORM", text)
    program = bytes(view[member.offset : member.offset + member.size])
    # torch can be told not to compute checksums; it then writes 0.
    if member.crc and zlib.crc32(program) != member.crc:
        text = f"data.pkl has CRC-32 {zlib.crc32(program):08x}; the archive says {member.crc:08x}"
        raise Refusal("CHECKPOINT_DAMAGED", text, at=f"byte {member.offset}")
    return program


def _small_text(view: memoryview, member: Member) -> str:
    raw = bytes(view[member.offset : member.offset + min(member.size, 20)])
    return raw.decode("ascii", "replace").strip()


def _check_version(view: memoryview, member: Member | None) -> None:
    text = _small_text(view, member) if member else ""
    if not (text.isascii() and text.isdigit() and len(text) < 4 and int(text) in VERSIONS):
        found = f'"{shorten(text)}"' if member else "missing"
        what = f"its version is {found}; {VERSIONS.start} to {VERSIONS.stop - 1} are read"
        raise Refusal("CHECKPOINT_FORM", what)


def _check_byte_order(view: memoryview, member: Member | None) -> None:
    """Older files do not say; they come from little-endian machines."""
    text = _small_text(view, member) if member else "little"
    if text != "little":
        raise Refusal("CHECKPOINT_FORM", f'its byte order is "{shorten(text)}"; only little is read')

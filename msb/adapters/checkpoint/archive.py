"""Read the archives that `torch.save` writes since torch 1.6.

All members of the archive are in one folder, which has the name of the file or ``archive``. The reader needs
the members ``data.pkl``, ``version`` and one member ``data/N`` per storage. In newer files, the reader also
needs the member ``byteorder``. The reader ignores other members (``.format_version``, ``.storage_alignment``,
``.data/serialization_id``). As in a packed `.triasset`, padding in the extra field of local headers aligns
the data to 64 bytes. Unlike in a `.triasset`, a ZIP64 end record always exists, and a copy of sizes and
checksum follows the data (bit 3 of the flags).

Sources: pytorch/pytorch `torch/serialization.py`, `caffe2/serialize/versions.h`,
`caffe2/serialize/inline_container.cc`.
"""

import zlib
from typing import Any, NoReturn

from msb.adapters.checkpoint.pickle_machine import run_pickle
from msb.adapters.checkpoint.tensors import Extent, Refusal, Storages
from msb.asset.strict_zip import Member, Policy, read_members
from msb.errors import shorten

# Maximum size of data.pkl in bytes. data.pkl does not contain the values of tensors, so some kilobytes are
# usual. A list with the losses of a million training steps takes 9 MiB.
MAX_PICKLE = 16 << 20
# Maximum number of members of an archive. An archive has one member per tensor, and a few others. Files of
# the methods have fewer than 30 members, and files of other large models have thousands.
MAX_MEMBERS = 20_000
# Maximum length of a member's name in characters.
MAX_NAME = 500
# Supported archive versions. torch accepts versions up to 10 and writes 3; version 1 had another layout.
VERSIONS = range(2, 11)
_PICKLE, _DATA = "data.pkl", "data/"


def _is_script(name: str) -> bool:
    """Return whether a member (constants or source code) belongs to a TorchScript program."""
    return name.endswith("/constants.pkl") or "/code/" in name


def _refuse_script(name: str) -> NoReturn:
    """Raise an error, because the archive is a TorchScript program."""
    text = f"the file contains a TorchScript program ({shorten(name, 40)}); a saved state is needed"
    raise Refusal("CHECKPOINT_NOT_RECOGNISED", text)


class _Torch(Policy):
    """The rules for archives of torch."""

    max_members = MAX_MEMBERS
    descriptors = True

    def refuse(self, code: str, message: str, at: int) -> NoReturn:
        raise Refusal(f"CHECKPOINT_{code}", message, at=f"byte {at}")

    def name(self, raw: bytes, flags: int, at: int) -> str:
        try:
            name = raw.decode()
        except UnicodeDecodeError:
            name = ""
        if not name or len(name) > MAX_NAME or not name.isprintable():
            self.refuse("FORM", "a member's name is empty, too long or not printable UTF-8", at)
        return name

    def compressed(self, name: str, method: int, at: int) -> NoReturn:
        """Reject a compressed member.

        If the member contains source code, the error says that the file is a TorchScript program.
        """
        if _is_script(name):
            _refuse_script(name)
        super().compressed(name, method, at)


def read_archive(view: memoryview) -> Any:
    """Return the value that was saved in the archive `view`."""
    members = read_members(view, _Torch())
    root = _root(members)
    _check_version(view, members.get(f"{root}version"))
    _check_byte_order(view, members.get(f"{root}byteorder"))
    # For each storage key, the position of the storage's bytes. The pickle refers to storages (arrays of
    # tensor values) by key.
    prefix = root + _DATA
    places = {
        name[len(prefix) :]: Extent(member.offset, member.size)
        for name, member in members.items()
        if name.startswith(prefix)
    }
    program = _program(view, members[root + _PICKLE])
    value, end = run_pickle(program, Storages(view, places), where="data.pkl ")
    if end != len(program):
        text = f"data.pkl has {len(program) - end} bytes after its end"
        raise Refusal("CHECKPOINT_HOSTILE", text, at=f"data.pkl byte {end}")
    return value


def _root(members: dict[str, Member]) -> str:
    """Return the folder of data.pkl, with a slash at the end.

    Exactly one folder of the archive must contain data.pkl.
    """
    roots = [name[: -len(_PICKLE)] for name in members if name == _PICKLE or name.endswith("/" + _PICKLE)]
    for name in filter(_is_script, members):
        _refuse_script(name)
    if not roots:
        raise Refusal("CHECKPOINT_NOT_RECOGNISED", "the archive has no data.pkl, which torch always writes")
    if len(roots) > 1:
        raise Refusal(
            "CHECKPOINT_HOSTILE", f"the archive contains {len(roots)} files data.pkl; torch writes one"
        )
    root = roots[0]
    if root.count("/") != 1 or root in ("/", "./", "../"):
        text = f"data.pkl is in {shorten(repr(root), 40)}; it must be in a single folder"
        raise Refusal("CHECKPOINT_FORM", text)
    return root


def _program(view: memoryview, member: Member) -> bytes:
    if member.size > MAX_PICKLE:
        text = f"data.pkl has {member.size} bytes; at most {MAX_PICKLE} are read"
        raise Refusal("CHECKPOINT_FORM", text)
    program = bytes(view[member.offset : member.offset + member.size])
    # torch can omit checksums. If torch omits checksums, it writes 0.
    if member.crc and zlib.crc32(program) != member.crc:
        text = f"data.pkl has CRC-32 {zlib.crc32(program):08x}, but the archive states {member.crc:08x}"
        raise Refusal("CHECKPOINT_DAMAGED", text, at=f"byte {member.offset}")
    return program


def _small_text(view: memoryview, member: Member) -> str:
    raw = bytes(view[member.offset : member.offset + min(member.size, 20)])
    return raw.decode("ascii", "replace").strip()


def _check_version(view: memoryview, member: Member | None) -> None:
    text = _small_text(view, member) if member else ""
    if not (text.isascii() and text.isdigit() and len(text) < 4 and int(text) in VERSIONS):
        version = f'"{shorten(text)}"' if member else "missing"
        what = f"the archive version is {version}; {VERSIONS.start} to {VERSIONS.stop - 1} are supported"
        raise Refusal("CHECKPOINT_FORM", what)


def _check_byte_order(view: memoryview, member: Member | None) -> None:
    """Check the byte order. Older files do not state a byte order. They are little-endian."""
    text = _small_text(view, member) if member else "little"
    if text != "little":
        raise Refusal("CHECKPOINT_FORM", f'the byte order is "{shorten(text)}"; only little is supported')

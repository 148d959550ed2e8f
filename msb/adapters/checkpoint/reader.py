"""Recognise the kind of a checkpoint file, and read it: the one function that the adapters call."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from msb.adapters.checkpoint.archive import read_archive
from msb.adapters.checkpoint.legacy import is_legacy, read_legacy
from msb.adapters.checkpoint.refusal import Refusal
from msb.adapters.checkpoint.structure import check_structure
from msb.base.files import map_file
from msb.errors import CheckpointError

_END_RECORD = b"PK\x05\x06"
_LONGEST_TAIL = 22 + 0xFFFF
"""Bytes of a ZIP's end record and the longest comment behind it."""


def read_checkpoint(path: str | os.PathLike[str]) -> Any:
    """Return what `torch.save` wrote to `path`, without torch and without executing anything in it.

    That is dictionaries (an OrderedDict becomes a dict), lists, tuples, text, bytes, numbers, bools and
    None. A tensor or Parameter is a read-only NumPy view on the mapped file, of the saved shape and strides;
    bfloat16 is a `BFloat16Array`. A NumPy scalar is a Python number.
    """
    path = Path(path)
    data = map_file(path)
    try:
        value = _read(memoryview(data))
        check_structure(value)
    except Refusal as refusal:
        raise CheckpointError(refusal.code, refusal.message, file=path, pointer=refusal.at) from None
    return value


def _read(view: memoryview) -> Any:
    head = bytes(view[:512])
    if head[:4] in (b"PK\x03\x04", _END_RECORD):
        return read_archive(view)
    if is_legacy(head):
        return read_legacy(view)
    raise _stranger(view, head)


def _stranger(view: memoryview, head: bytes) -> Refusal:
    """Return why a file that is of neither layout is refused: what it is, if that can be told."""
    if not head:
        return Refusal("CHECKPOINT_DAMAGED", "the file is empty")
    if head[257:262] == b"ustar":
        text = "it is a tar file, as torch wrote before 2017; load it with torch and save it again"
        return Refusal("CHECKPOINT_FORM", text)
    if _is_safetensors(view, head):
        text = "it is a safetensors file; the .pt or .ckpt file of the method is needed"
        return Refusal("CHECKPOINT_NOT_RECOGNISED", text)
    if head[0] == 0x80 and head[1:2] <= b"\x05":
        text = "it is a pickle that torch.save did not write; load it where it is trusted and torch.save it"
        return Refusal("CHECKPOINT_FORM", text)
    if _END_RECORD in bytes(view[-_LONGEST_TAIL:]):
        text = "there is data before the archive's first member"
        return Refusal("CHECKPOINT_HOSTILE", text, at="byte 0")
    what = (
        "it is a Git LFS pointer, not the file itself" if head.startswith(b"version https://git-lfs") else ""
    )
    return Refusal("CHECKPOINT_NOT_RECOGNISED", what or "it does not start like a file of torch.save")


def _is_safetensors(view: memoryview, head: bytes) -> bool:
    """A 64-bit length, then that many bytes of a JSON object."""
    length = int.from_bytes(head[:8], "little")
    return len(head) > 8 and head[8:9] == b"{" and length <= len(view) - 8

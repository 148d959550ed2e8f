"""Recognise the kind of a checkpoint file, and read it: the one function that the adapters call."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from msb.adapters.checkpoint.archive import read_archive
from msb.adapters.checkpoint.legacy import is_legacy, read_legacy
from msb.adapters.checkpoint.tensors import BFloat16Array, Refusal
from msb.base.files import map_file
from msb.errors import CheckpointError

_END_RECORD = b"PK\x05\x06"
# Bytes of a ZIP's end record and the longest comment behind it.
_LONGEST_TAIL = 22 + 0xFFFF
# Most levels of containers in containers. The methods' files nest 5 deep; recursive code may go 1000
# deep.
MAX_DEPTH = 64
# Most values that a walk may meet which does not remember where it was.
#
# A list may hold a second list twice, that list a third one twice, and so on: 30 levels are 10^9 values
# in 200 bytes ("billion laughs"). No file that we read shares lists or dictionaries at all.
MAX_VALUES = 1_000_000

# What is said of a file of which nothing else is known.
STRANGE = "it does not start like a file of torch.save"

_LEAVES = (str, bytes, int, float, bool, type(None), np.ndarray, BFloat16Array)
_CONTAINERS = (dict, list, tuple)


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
        _check_structure(value)
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
    if head.startswith(b"version https://git-lfs"):
        return Refusal("CHECKPOINT_NOT_RECOGNISED", "it is a Git LFS pointer, not the file itself")
    return Refusal("CHECKPOINT_NOT_RECOGNISED", STRANGE)


def _is_safetensors(view: memoryview, head: bytes) -> bool:
    """A 64-bit length, then that many bytes of a JSON object."""
    length = int.from_bytes(head[:8], "little")
    return len(head) > 8 and head[8:9] == b"{" and length <= len(view) - 8


class _Node:
    """A container on the path from the root: the values not yet visited, and its depth and size so far."""

    def __init__(self, container: Any) -> None:
        self.container = container
        values = container.values() if type(container) is dict else container
        self.rest: Iterator[Any] = iter(values)
        self.height, self.count = 1, 1

    def add(self, height: int, count: int) -> None:
        self.height = max(self.height, height + 1)
        self.count += count


def _check_structure(root: Any) -> None:
    """Refuse a result that is no plain data or that a naive walk would not survive.

    Time and memory are linear in the number of distinct containers, whatever they share.
    """
    path = [_Node([root])]
    known: dict[int, _Node] = {}
    open_now: set[int] = set()
    while path:
        node = path[-1]
        for value in node.rest:
            if type(value) in _LEAVES:
                node.add(0, 1)
            elif type(value) not in _CONTAINERS:
                text = f"the file holds a bare {type(value).__name__.lower()} where data should be"
                raise Refusal("CHECKPOINT_FORM", text)
            elif id(value) in open_now:
                raise Refusal("CHECKPOINT_HOSTILE", f"a {type(value).__name__} contains itself")
            elif id(value) in known:
                node.add(known[id(value)].height, known[id(value)].count)
            else:
                open_now.add(id(value))
                path.append(_Node(value))
                break
        else:
            path.pop()
            open_now.discard(id(node.container))
            known[id(node.container)] = node
            if path:
                path[-1].add(node.height, node.count)
        _check_limits(node, len(path))


def _check_limits(node: _Node, above: int) -> None:
    # The outermost list is ours, hence one more of everything.
    if max(node.height, above) > MAX_DEPTH + 1:
        text = f"lists, tuples and dictionaries nest more than {MAX_DEPTH} deep"
        raise Refusal("CHECKPOINT_HOSTILE", text)
    if node.count > MAX_VALUES + 1:
        text = f"shared lists or dictionaries amount to more than {MAX_VALUES} values"
        raise Refusal("CHECKPOINT_HOSTILE", text)

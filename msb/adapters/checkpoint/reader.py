"""The function `read_checkpoint`, which detects the layout of a checkpoint file and reads the file."""

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
# Size in bytes of a ZIP end record with the longest comment.
_LONGEST_TAIL = 22 + 0xFFFF
# Maximum nesting of lists, tuples and dictionaries. Files of the methods have 5 levels of nesting. Recursive
# code fails at 1000 levels.
MAX_DEPTH = 64
# Maximum number of values in a checkpoint. A list or dictionary that occurs several times counts each time.
# Nested lists that repeat each other can contain 10^9 values with 30 levels in 200 bytes ("billion laughs").
# Files of the methods do not share lists or dictionaries.
MAX_VALUES = 1_000_000

# The message for files of an unknown kind.
STRANGE = "the file was not written by torch.save"

_LEAVES = (str, bytes, int, float, bool, type(None), np.ndarray, BFloat16Array)
_CONTAINERS = (dict, list, tuple)


def read_checkpoint(path: str | os.PathLike[str]) -> Any:
    """Return the value that `torch.save` wrote to `path`, without torch and without executing code of the
    file.

    The value consists of dictionaries, lists, tuples, text, bytes, numbers, bools and None. A tensor or
    Parameter is a read-only NumPy view of the mapped file, with the saved shape and strides. A bfloat16
    tensor is a `BFloat16Array`. An OrderedDict becomes a dict, and a NumPy scalar becomes a Python number.
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
    raise _unknown_file(view, head)


def _unknown_file(view: memoryview, head: bytes) -> Refusal:
    """Return the error for a file with an unknown layout. The message names the kind of file, if
    recognised."""
    if not head:
        return Refusal("CHECKPOINT_DAMAGED", "the file is empty")
    if head[257:262] == b"ustar":
        text = "the file is a tar file, as torch wrote before 2017; load it with torch and save it again"
        return Refusal("CHECKPOINT_FORM", text)
    if _is_safetensors(view, head):
        text = "the file is a safetensors file; the .pt or .ckpt file of the method is needed"
        return Refusal("CHECKPOINT_NOT_RECOGNISED", text)
    if head[0] == 0x80 and head[1:2] <= b"\x05":
        text = "torch.save did not write this pickle; if you trust the file, load it and use torch.save"
        return Refusal("CHECKPOINT_FORM", text)
    if _END_RECORD in bytes(view[-_LONGEST_TAIL:]):
        text = "the file has data before the first member of the archive"
        return Refusal("CHECKPOINT_HOSTILE", text, at="byte 0")
    if head.startswith(b"version https://git-lfs"):
        return Refusal("CHECKPOINT_NOT_RECOGNISED", "the file is a Git LFS pointer, not the file itself")
    return Refusal("CHECKPOINT_NOT_RECOGNISED", STRANGE)


def _is_safetensors(view: memoryview, head: bytes) -> bool:
    """Return whether a file begins with a 64-bit length, followed by a JSON object of this length."""
    length = int.from_bytes(head[:8], "little")
    return len(head) > 8 and head[8:9] == b"{" and length <= len(view) - 8


class _Node:
    """A container on the path from the root to the current value.

    `rest` iterates over the values that have not been visited yet. `height` is the number of nested levels
    visited so far, and `count` is the number of values visited so far.
    """

    def __init__(self, container: Any) -> None:
        self.container = container
        values = container.values() if type(container) is dict else container
        self.rest: Iterator[Any] = iter(values)
        self.height, self.count = 1, 1

    def add(self, height: int, count: int) -> None:
        self.height = max(self.height, height + 1)
        self.count += count


def _check_structure(root: Any) -> None:
    """Reject a value that is not plain data, contains itself, or is too large or too deep for recursive code.

    Time and memory are linear in the number of different containers, even if containers are shared.
    """
    # The function searches depth-first, without recursion. `known` has the finished containers by id.
    # `open_now` has the ids of the containers on the path.
    path = [_Node([root])]
    known: dict[int, _Node] = {}
    open_now: set[int] = set()
    while path:
        node = path[-1]
        for value in node.rest:
            if type(value) in _LEAVES:
                node.add(0, 1)
            elif type(value) not in _CONTAINERS:
                text = f"the file contains a {type(value).__name__.lower()}, which is not plain data"
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
    # `_check_structure` has added an outer list, so both limits are one higher here.
    if max(node.height, above) > MAX_DEPTH + 1:
        text = f"lists, tuples and dictionaries have more than {MAX_DEPTH} levels of nesting"
        raise Refusal("CHECKPOINT_HOSTILE", text)
    if node.count > MAX_VALUES + 1:
        text = f"shared lists and dictionaries contain more than {MAX_VALUES} values"
        raise Refusal("CHECKPOINT_HOSTILE", text)

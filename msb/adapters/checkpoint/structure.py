"""The last check of a pickle's result: it must be plain data, finite, not too deep, and safe to walk."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from msb.adapters.checkpoint.refusal import Refusal
from msb.adapters.checkpoint.tensors import BFloat16Array

MAX_DEPTH = 64
"""Most levels of containers in containers. The methods' files nest 5 deep; recursive code may go 1000
deep."""
MAX_VALUES = 1_000_000
"""Most values that a walk may meet which does not remember where it was.

A list may hold a second list twice, that list a third one twice, and so on: 30 levels are a thousand million
values in 200 bytes ("billion laughs"). No file that we read shares lists or dictionaries at all.
"""

_LEAVES = (str, bytes, int, float, bool, type(None), np.ndarray, BFloat16Array)
_CONTAINERS = (dict, list, tuple)


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


def check_structure(root: Any) -> None:
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

"""Sort a renderer's device memory from its own names of uses into the four groups of a record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import get_args

from msb.bench.records import Memory
from msb.render.backend import Group


def grouped(
    uses: Mapping[str, int], groups: Mapping[str, str], driver: tuple[int | None, str | None] = (None, None)
) -> Memory:
    """Return group -> bytes of the memory a renderer reports; a use without a group counts as scratch.

    Parameters
    ----------
    uses : mapping of str to int
        `Renderer.memory`.
    groups : mapping of str to str
        `Renderer.memory_groups`.
    driver : pair of int and str, optional
        The bytes that the driver tells (`driver_memory`), or the reason why it does not.
    """
    sums = dict.fromkeys(get_args(Group), 0)
    for use, size in uses.items():
        group = groups.get(use)
        sums[group if group in sums else "scratch"] += size
    return Memory(**sums, uses=dict(uses), driver_bytes=driver[0], driver_reason=driver[1])

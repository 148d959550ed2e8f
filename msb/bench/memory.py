"""Sort a renderer's device memory from its own names of uses into the four groups of a record."""

from __future__ import annotations

from collections.abc import Mapping
from typing import get_args

from msb.bench.records import Memory
from msb.render.backend import Group


def grouped(
    uses: Mapping[str, int], groups: Mapping[str, str], driver: tuple[int | None, str | None] = (None, None)
) -> Memory:
    """Return a renderer's `memory` by its `memory_groups`; a use without a group counts as scratch.

    `driver` is what `driver_memory` gives.
    """
    sums = dict.fromkeys(get_args(Group), 0)
    for use, size in uses.items():
        group = groups.get(use)
        sums[group if group in sums else "scratch"] += size
    return Memory(**sums, uses=dict(uses), driver_bytes=driver[0], driver_reason=driver[1])

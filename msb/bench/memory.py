"""What a renderer's device memory is for: from its own names of uses to the four groups of a record."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Literal

from msb.bench.records import Memory

if TYPE_CHECKING:
    from collections.abc import Mapping

Group = Literal["geometry", "appearance", "scratch", "targets"]

_USES: dict[Group, tuple[str, ...]] = {
    "geometry": (
        *("positions", "indices", "bounds", "groups", "numbers", "coverage"),
        *("opaque faces", "standard triangles", "standard boxes"),
    ),
    "appearance": (
        *("f_dc", "f_rest", "opacity", "falloff", "decoder"),
        *("standard colors", "lattice features", "lattice opacity", "vertex colors"),
    ),
    "targets": (
        *("image", "depth", "face ids"),  # of engines
        # z-buffers of packed depth and face are targets, too
        *("standard image", "standard alpha", "standard depth", "standard face ids", "standard pixels"),
        *("splat image", "splat alpha", "splat depth", "splat face id", "splat median", "splat normal"),
        *("lattice image", "lattice depth", "lattice face id", "lattice keys"),
        *("lattice bary01", "lattice ndc depth"),
    ),
    "scratch": (
        *("standard view", "standard rectangles", "standard group rectangles", "standard nearest"),
        *("standard next tile", "standard tiles", "standard listed", "standard list lengths"),
        *(
            "splat view",
            "splat faces",
            "splat keys",
            "splat listed",
            "splat listed before",
            "splat visible",
            "splat visible by number",
            "splat unsettled",
            "splat order keys",
            "splat order points",
            "splat vertex colors",
        ),
        *("splat tiles", "splat ordered tiles", "splat tiles of ordered faces", "splat tile counts"),
        *("splat tile counts of chunks", "splat tile totals", "splat tile starts", "splat tile lists"),
        *("splat depth keys", "splat depth order", "splat pair numbers", "splat pair offsets"),
        *("splat pair tiles", "splat pair places", "splat planes", "splat band"),
        *("lattice frame", "lattice corners", "lattice columns", "lattice first rows", "lattice last rows"),
        *("lattice ndc x", "lattice ndc y", "lattice fragments", "lattice visible", "lattice plane b0"),
        *("lattice plane b1", "lattice plane face", "lattice plane ndc", "lattice plane w"),
        *("lattice features seen", "lattice harmonics"),
    ),
}
_GROUP_OF: dict[str, Group] = {use: group for group, uses in _USES.items() for use in uses}
_PASSING = re.compile(r"(scan|splat \w+ sort|standard \w+ sort) ")
"""Buffers of a prefix sum or a sort: scratch, whatever is sorted."""


def group_of(use: str) -> Group | None:
    """Return which group the bytes for `use` belong to, None if no renderer of ours has such a use."""
    return "scratch" if _PASSING.match(use) else _GROUP_OF.get(use)


def grouped(uses: Mapping[str, int]) -> Memory:
    """Return the memory a renderer reports (`Renderer.memory`) by group; the unknown counts as scratch."""
    sums: dict[Group, int] = dict.fromkeys(_USES, 0)
    for use, size in uses.items():
        sums[group_of(use) or "scratch"] += size
    return Memory(**sums, uses=dict(uses))

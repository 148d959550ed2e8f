"""Rows over the scenes of a dataset, in its groups, and their means."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

from msb.bench.aggregate import scene_groups
from msb.report.layout import Line
from msb.report.numbers import MEAN, MEANS, scene_title

if TYPE_CHECKING:
    from msb.report.numbers import Key, Numbers

INDOOR_FIRST = ("indoor_mean", "outdoor_mean")
OUTDOOR_FIRST = ("outdoor_mean", "indoor_mean")
_GROUPS = {"indoor_mean": "indoor scenes", "outdoor_mean": "outdoor scenes"}


def scene_lines(
    numbers: Numbers,
    dataset: str,
    keys_of: Callable[[str], Iterable[Key]],
    *,
    groups: Sequence[str] = INDOOR_FIRST,
    group_means: bool = True,
    bold_mean: bool = False,
    prefix: str = "",
) -> tuple[Line, ...]:
    """Return a line per scene and per mean; without any scene of a dataset, the mean alone.

    Parameters
    ----------
    numbers : Numbers
    dataset : str
    keys_of : function
        Scene or mean -> the places of its cells.
    groups : sequence of str
        The order of a dataset's groups of scenes.
    group_means : bool
        End each group with its mean.
    bold_mean : bool
        Print the last row bold.
    prefix : str
        Starts each section's name.
    """
    scenes = numbers.scenes(dataset)
    members = scene_groups(dataset)
    lines: list[Line] = []

    def add(scene: str, section: str, *, bold: bool = False) -> None:
        label = scene_title(scene)
        heading = ", ".join(filter(None, (prefix, section)))
        lines.append(Line((label,), tuple(keys_of(scene)), heading, scene in MEANS, bold))

    for group in groups if members else ():
        own = [scene for scene in scenes if scene in members[group]]
        for scene in own:
            add(scene, _GROUPS[group])
        if own and group_means:
            add(group, _GROUPS[group])
    grouped = {scene for group in members.values() for scene in group}
    for scene in scenes:
        if scene not in grouped:
            add(scene, "other scenes" if members else "")
    add(MEAN, "all scenes" if members and prefix else "", bold=bold_mean)
    return tuple(lines)

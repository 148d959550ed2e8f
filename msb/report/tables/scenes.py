"""Rows over the scenes of a dataset, in its groups, and their means."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from msb.bench.aggregate import scene_groups
from msb.report.layout import Line
from msb.report.numbers import MEAN, MEANS, Numbers, scene_title

_GROUPS = {"indoor_mean": "indoor scenes", "outdoor_mean": "outdoor scenes"}


def scene_lines(
    numbers: Numbers,
    dataset: str,
    *,
    groups: Sequence[str] = tuple(_GROUPS),
    group_means: bool = True,
    prefix: str = "",
    of: Mapping[str, str] | None = None,
) -> Iterator[Line]:
    """Yield a line per scene and per mean; without any scene of a dataset, the mean alone.

    `groups` is the order of a dataset's groups, each of which ends with its mean, or else (`group_means`) the
    last row is bold. `prefix` starts each section's name; `of` are fields of all keys.
    """
    members = scene_groups(dataset)

    def line(scene: str, *section: str, bold: bool = False) -> Line:
        heading = ", ".join(filter(None, (prefix, *section)))
        return Line((scene_title(scene),), {"scene": scene, **(of or {})}, heading, scene in MEANS, bold)

    left = numbers.scenes(dataset)
    for group in groups if members else ():
        own = [scene for scene in left if scene in members[group]]
        left = [scene for scene in left if scene not in own]
        for name in (*own, *([group] if own and group_means else [])):
            yield line(name, _GROUPS[group])
    for scene in left:
        yield line(scene, "other scenes" if members else "")
    yield line(MEAN, "all scenes" if members and prefix else "", bold=not group_means)

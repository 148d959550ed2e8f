"""What the loss from Dedicated to Standard is made of, from records: colours, faces, blending.

Between the two stand bakes of the same model, drawn on the standard tier with one sample a pixel: the same
triangles in the best static colours (the ceiling of what an exporter can reach), and triangles made anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

from msb.bench.aggregate import mean_over
from msb.bench.gaps import Gap, gap_between
from msb.bench.records import BAKED

if TYPE_CHECKING:
    from msb.bench.gaps import Conditions

StepName = Literal["colors", "faces", "blending"]
# What is lost from ceiling to Standard, from the best bake to the ceiling, from Dedicated to that bake.
STEPS: tuple[StepName, ...] = ("colors", "faces", "blending")


@dataclass(frozen=True)
class Split:
    """The parts of one loss; over the same scenes they add up to `total`.

    Attributes
    ----------
    total : Gap or None
        From Dedicated to Standard; None where the method has not both.
    steps : mapping of StepName to Gap
        Signed as all losses: positive where the better end is Dedicated's.
    within : mapping of StepName to StepName
        A part without a bake of its own -> the part whose gap has both.
    ceiling, baked : str or None
        The bakes at which the parts meet, as conditions.
    """

    total: Gap | None
    steps: Mapping[StepName, Gap]
    within: Mapping[StepName, StepName]
    ceiling: str | None
    baked: str | None


def loss_split(metric: str, results: Mapping[str, Conditions], scenes: Iterable[str]) -> Split | None:
    """Return the parts of the loss in `metric` of one method on a dataset; None without a bake to split by.

    `results` are the records by scene and condition, `scenes` those that there should be. The best by PSNR of
    the bakes that kept the triangles is the ceiling, the best of the others the bake.
    """
    wanted = tuple(scenes)
    ceiling = _best(results, wanted, kept=True)
    baked = _best(results, wanted, kept=False)
    if ceiling is None and baked is None:
        return None
    there = {name for own in results.values() for name, one in own.items() if one.status == "done"}
    # From the lossy end; the parts lie between neighbours.
    ends = ["standard", ceiling, baked, "dedicated"]
    known = [place for place, name in enumerate(ends) if name in there]
    pairs = {places: (ends[places[1]], ends[places[0]]) for places in pairwise(known)}
    common = wanted
    for better, worse in pairs.values():
        assert better is not None
        assert worse is not None
        common = tuple(s for s in common if s in gap_between(metric, results, wanted, better, worse)[1])
    over = common or wanted  # where nothing is common, each part says why it is not there

    def gap(better: str, worse: str) -> Gap:
        return replace(gap_between(metric, results, over, better, worse)[0], expected=len(wanted))

    steps: dict[StepName, Gap] = {}
    within: dict[StepName, StepName] = {}
    for (low, high), (better, worse) in pairs.items():
        assert better is not None
        assert worse is not None
        own = STEPS[low:high]
        steps[own[-1]] = gap(better, worse)
        within |= dict.fromkeys(own[:-1], own[-1])
    both = {"standard", "dedicated"} <= there
    return Split(gap("dedicated", "standard") if both else None, steps, within, ceiling, baked)


def _best(results: Mapping[str, Conditions], scenes: tuple[str, ...], *, kept: bool) -> str | None:
    """Return the bake with the best mean PSNR on the most scenes, of those that kept all triangles or not."""
    values: dict[str, dict[str, float | None]] = {}
    moved: set[str] = set()
    for scene in scenes:
        for condition, one in results.get(scene, {}).items():
            if condition.startswith(f"{BAKED}/") and one.bake is not None and one.quality is not None:
                values.setdefault(condition, {})[scene] = one.quality.values["psnr"]
                if one.bake.geometry != "kept":
                    moved.add(condition)
    means = {name: mean_over(own, scenes) for name, own in values.items() if (name in moved) is not kept}
    ranked = [(mean.present, mean.value, name) for name, mean in means.items() if mean.value is not None]
    return max(ranked, default=(0, 0.0, None))[2]

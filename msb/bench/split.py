"""The loss of quality from Dedicated to Standard, split into three parts: colours, faces and blending.

Two bakes of the same model separate the parts of the loss. Both baked meshes are rendered on the standard
tier with one sample per pixel. The first bake (the ceiling) keeps the triangles and has the best static
colours. No exporter that keeps the triangles can lose less quality than the ceiling. The second bake has new
triangles.
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
# Colours: the loss from the ceiling to Standard. Faces: the loss from the second bake to the ceiling.
# Blending: the loss from Dedicated to the second bake.
STEPS: tuple[StepName, ...] = ("colors", "faces", "blending")


@dataclass(frozen=True)
class Split:
    """The parts of the loss. All parts cover the same scenes, and their sum is `total`.

    Attributes
    ----------
    total : Gap or None
        The loss from Dedicated to Standard; None if the method lacks one of these conditions.
    steps : mapping of StepName to Gap
        The loss of each part. The value is positive if the condition nearer to Dedicated is better.
    within : mapping of StepName to StepName
        For a part that was not measured separately, the part that includes its loss.
    ceiling, baked : str or None
        The conditions of the two bakes that separate the parts.
    """

    total: Gap | None
    steps: Mapping[StepName, Gap]
    within: Mapping[StepName, StepName]
    ceiling: str | None
    baked: str | None


def loss_split(metric: str, results: Mapping[str, Conditions], scenes: Iterable[str]) -> Split | None:
    """Return the parts of a method's loss in `metric` on a dataset. If there is no bake, return None.

    `results` contains the records by scene, then by condition. `scenes` names all scenes that the dataset
    should have. The ceiling is the bake with the best PSNR among the bakes that keep all triangles. The
    second bake has the best PSNR among the bakes with new triangles.
    """
    expected = tuple(scenes)
    ceiling = _find_best_bake(results, expected, kept=True)
    baked = _find_best_bake(results, expected, kept=False)
    if ceiling is None and baked is None:
        return None
    finished = {
        name
        for conditions in results.values()
        for name, record in conditions.items()
        if record.status == "done"
    }
    # The four conditions, sorted by decreasing loss. Each part of the loss is the difference between two
    # successive conditions.
    ends = ["standard", ceiling, baked, "dedicated"]
    known = [place for place, name in enumerate(ends) if name in finished]
    pairs = {places: (ends[places[1]], ends[places[0]]) for places in pairwise(known)}
    # All parts are computed over the same scenes, so that they add up to the whole loss.
    common = expected
    for better, worse in pairs.values():
        assert better is not None
        assert worse is not None
        covered = gap_between(metric, results, expected, better, worse)[1]
        common = tuple(scene for scene in common if scene in covered)
    over = common or expected  # if no scene has all conditions, each gap states its reason

    def gap(better: str, worse: str) -> Gap:
        return replace(gap_between(metric, results, over, better, worse)[0], expected=len(expected))

    # If a bake is missing, compute one gap for the two parts that this bake would separate.
    steps: dict[StepName, Gap] = {}
    within: dict[StepName, StepName] = {}
    for (low, high), (better, worse) in pairs.items():
        assert better is not None
        assert worse is not None
        spanned = STEPS[low:high]
        steps[spanned[-1]] = gap(better, worse)
        within |= dict.fromkeys(spanned[:-1], spanned[-1])
    has_total = {"standard", "dedicated"} <= finished
    return Split(gap("dedicated", "standard") if has_total else None, steps, within, ceiling, baked)


def _find_best_bake(results: Mapping[str, Conditions], scenes: tuple[str, ...], *, kept: bool) -> str | None:
    """Return the bake that covers the most scenes.

    If several bakes cover equally many scenes, return the bake with the best average PSNR.

    If `kept` is true, only bakes that keep all triangles are compared, otherwise only bakes with new
    triangles.
    """
    values: dict[str, dict[str, float | None]] = {}
    changed: set[str] = set()
    for scene in scenes:
        for condition, record in results.get(scene, {}).items():
            if condition.startswith(f"{BAKED}/") and record.bake is not None and record.quality is not None:
                values.setdefault(condition, {})[scene] = record.quality.values["psnr"]
                if record.bake.geometry != "kept":
                    changed.add(condition)
    means = {
        name: mean_over(by_scene, scenes)
        for name, by_scene in values.items()
        if (name in changed) is not kept
    }
    ranked = [(mean.present, mean.value, name) for name, mean in means.items() if mean.value is not None]
    return max(ranked, default=(0, 0.0, None))[2]

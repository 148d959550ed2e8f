"""The verdict on one asset: its suitability for each use, with the number behind each judgement."""

import math
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from msb import metrics
from msb.bench.aggregate import METRICS, why_unsteady
from msb.bench.records import BAKED, ImageQuality, Result
from msb.errors import MsbError
from msb.metrics.images import PSNR_CAP
from msb.metrics.likeness import ALIKE, NEARLY, decibels
from msb.report.collect import NOT_RUN, REFERENCE
from msb.report.mesh_trials import TaskOutcome, read_task_outcomes
from msb.report.metric_format import format_change, format_digits, format_value
from msb.report.numbers import GapKey, Key, Numbers, condition_title, dataset_title, method_title, scene_title
from msb.report.results import LoadedResult, Place
from msb.report.safe_names import plain_text
from msb.report.table import NOT_SUPPORTED

Mark = Literal["YES", "WITH CARE", "NO", "UNKNOWN", "NOTE"]

# Minimum PSNR in dB of native renderings against the photographs. Native renderings with a lower PSNR cannot
# serve as a reference.
MIN_NATIVE_PSNR = 15.0
# Minimum PSNR in dB between two renderings for each verdict, with the verdict's mark and text.
_SIMILARITIES: tuple[tuple[float, Mark, str], ...] = (
    (ALIKE, "YES", "Matches"),
    (NEARLY, "WITH CARE", "Nearly matches"),
    (0.0, "NO", "Differs from"),
)
# Maximum PSNR loss in dB for each verdict, with the verdict's mark and text. A loss below 1 dB is hard to
# see, and 3 dB is obvious.
_LOSSES: tuple[tuple[float, Mark, str], ...] = (
    (1.0, "YES", "Matches"),
    (3.0, "WITH CARE", "Visibly worse than"),
    (math.inf, "NO", "Differs from"),
)
# Maximum P95 of the frame time, in milliseconds, for 60 and for 30 frames per second.
SMOOTH_MS, USABLE_MS = 1000 / 60, 1000 / 30
# Maximum number of views on which the renderings of two conditions are compared. The compared views are
# evenly spread over all views. A comparison of more views would take minutes in a complete benchmark.
_MAX_VIEWS = 8
_LEVELS: dict[str, Mark] = {"ok": "YES", "limited": "WITH CARE", "bad": "NO"}


@dataclass(frozen=True)
class Statement:
    """A judgement on the suitability of an asset for one use.

    `why` explains the judgement and contains the measured number. `short` is the name of the use in tables.
    """

    mark: Mark
    use: str
    why: str
    short: str = ""

    def to_dict(self) -> dict[str, str]:
        """Return the judgement as JSON data."""
        return {"mark": self.mark, "use": self.use, "why": self.why}


@dataclass(frozen=True)
class Verdict:
    """The judgements on one asset, and the outcomes of trial tasks on its mesh."""

    place: Place
    statements: tuple[Statement, ...]
    outcomes: tuple[TaskOutcome, ...] = ()

    @property
    def title(self) -> str:
        """The heading: method, scene and dataset."""
        dataset, scene, method = self.place
        return f"{method_title(method)} on {scene_title(scene)} ({dataset_title(dataset)})"

    def marks(self) -> list[tuple[Mark, list[str]]]:
        """Return each mark with its uses. The worst mark comes first.

        If all uses have the same mark, the list of uses is ["all"].

        Uses without a mark (notes) are left out.
        """
        order: tuple[Mark, ...] = ("NO", "WITH CARE", "UNKNOWN", "YES")
        named = [(mark, [s.short for s in self.statements if s.mark == mark]) for mark in order]
        marked = [(mark, uses) for mark, uses in named if uses]
        return [(marked[0][0], ["all"])] if len(marked) == 1 else marked


def judge(place: Place, loaded: Mapping[str, LoadedResult], numbers: Numbers) -> Verdict:
    """Return the verdict on an asset.

    Parameters
    ----------
    place : Place
    loaded : mapping of str to LoadedResult
        The record of each condition, with its files.
    numbers : Numbers
        The numbers and gaps of all results.
    """
    records = {name: record.result for name, record in loaded.items()}
    variants = [name for name in numbers.variants(place.dataset, "dedicated") if name in records]
    dedicated = ["dedicated", *variants]
    bakes = [name for name in numbers.variants(place.dataset, BAKED) if name in records]
    # Describe the use that each condition with renderings represents.
    uses = {"standard": "Standard-tier mesh, any engine"}
    uses |= {name: f"Model with its native shaders ({condition_title(name)})" for name in dedicated}
    uses |= {name: f"Baked mesh, any engine ({plain_text(name.partition('/')[2])})" for name in bakes}
    # Judge the frame rates of supported conditions only.
    supported = {name for name, record in records.items() if record.status != "unsupported"}
    timed = [name for name in ("standard", *dedicated) if name in supported]
    statements = [
        *(
            replace(_judge_appearance(place, numbers, name, use, loaded), short=condition_title(name))
            for name, use in uses.items()
        ),
        *(
            replace(_judge_speed(name, records[name]), short=f"real time {condition_title(name)}")
            for name in timed
        ),
        replace(_judge_structure(records.get("exported_mesh")), short="editing"),
        *(_judge_bake(name, records[name]) for name in bakes),
        *_make_notes(place, numbers, records),
    ]
    outcomes = read_task_outcomes(loaded.get("exported_mesh"), pictures=False)
    return Verdict(place, tuple(statements), tuple(outcomes))


def _judge_appearance(
    place: Place, numbers: Numbers, condition: str, use: str, loaded: Mapping[str, LoadedResult]
) -> Statement:
    """Compare the renderings of a condition with the native renderings, and judge the PSNR between them.

    If image files are missing, the difference in PSNR against the photographs is used. Without native
    renderings, the Standard condition is compared with the Dedicated condition.
    """
    number = numbers.number(Key(*place, condition, "psnr"))
    if number.value is None:
        reason = number.reason or NOT_RUN
        if number.absent == NOT_SUPPORTED:
            return Statement("NO", use, f"Not supported: {reason}.")
        return Statement("UNKNOWN", use, f"{_capitalize(reason)}.")

    # Find the reference renderings. Use native renderings as the reference if they are comparable. If native
    # renderings are missing, compare the Standard condition with the Dedicated condition.
    tier = "dedicated" if condition.startswith("dedicated") else "standard"
    gaps = numbers.gaps.get(GapKey(*place, "psnr", **{tier: condition}))
    gap = None if gaps is None else gaps["deploy" if tier == "standard" else "adapt"]
    start, remark = "non_engine", ""
    lacks = (
        "the native renderings are not comparable"
        if start in loaded
        else "the results have no native renderings"
    )
    if tier == "standard" and gaps is not None and (gap is None or gap.signed is None):
        start, gap = "dedicated", gaps["port"]
        remark = f" The comparison is with the dedicated tier of this run, because {lacks}."
    if gap is None or gap.signed is None:
        psnr = f"PSNR against the photographs is {number.value:.2f} dB"
        return Statement("UNKNOWN", use, f"{psnr}. The loss cannot be judged, because {lacks}.")
    before = numbers.number(Key(*place, start, "psnr"))
    reference = "our reference renderer" if REFERENCE in before.notes else "its native renderer"
    reference = "the dedicated tier" if start == "dedicated" else reference
    if before.value is not None and before.value < MIN_NATIVE_PSNR:
        low = f"{_capitalize(reference)} reaches only {before.value:.2f} dB PSNR against the photographs"
        text = f"{low}, which is too low for a comparison. This condition has {number.value:.2f} dB.{remark}"
        return Statement("UNKNOWN", use, text)

    # Compare the two sets of renderings directly. If image files are missing, compare the PSNR of both
    # conditions against the photographs.
    change = f"PSNR against the photographs {_describe_change(gap.signed, before.value, number.value)}"
    similarity = measure_similarity(loaded[start], loaded[condition])
    if similarity is None:
        mark, wording = next((mark, wording) for limit, mark, wording in _LOSSES if gap.signed < limit)
        return Statement(mark, use, f"{wording} {reference}; {change}.{remark}")
    mark, wording = next(
        (mark, wording) for least, mark, wording in _SIMILARITIES if similarity.psnr >= least
    )
    part = f" over {similarity.views} of {similarity.of} views" if similarity.views < similarity.of else ""
    between = f"{decibels(similarity.psnr)} between the two renderings{part}"
    return Statement(mark, use, f"{wording} {reference}: {between}. {change}.{remark}")


def _describe_change(loss: float, before: float | None, after: float) -> str:
    """Return "is 1.01 dB worse (23.01 to 22.00 dB)", "is 0.51 dB better (...)" or "shows no loss (...)"."""
    start = after + loss if before is None else before
    amount, first, last = format_change(loss, (start, after), METRICS["psnr"].decimals)
    change = f"is {amount} dB {'better' if loss < 0 else 'worse'}"
    if not float(format_digits(loss, METRICS["psnr"].decimals)):
        change = "shows no loss"
    return change if before is None else f"{change} ({first} to {last} dB)"


def _judge_speed(condition: str, record: Result) -> Statement:
    """Judge whether a condition renders at 60 or 30 frames per second."""
    use = f"Real time, {condition_title(condition)}"
    timing = record.timing
    if timing is None:
        reason = record.reasons.get("timing") or record.reason
        return Statement("UNKNOWN", use, f"Not timed{f': {reason.message}' if reason else ''}.")
    if not timing.has_device_times:
        return Statement("UNKNOWN", use, "The renderer does not measure device times.")
    longest = _format_milliseconds(timing.p95_ms)
    unsteady = why_unsteady(record) is not None
    rate = "unsteady frame rate" if unsteady else f"{timing.fps:.0f} frames per second on average"
    measured = f"95 % of the frames take at most {longest} ({rate})"
    if timing.p95_ms <= SMOOTH_MS:
        return Statement("YES", use, f"Holds 60 frames per second: {measured}.")
    if timing.device_kind != "gpu":
        device = timing.device_kind.upper()
        return Statement("UNKNOWN", use, f"On a {device} device, {measured}. Measure the times on a GPU.")
    if timing.p95_ms <= USABLE_MS:
        return Statement("WITH CARE", use, f"Holds 30 frames per second, but not 60: {measured}.")
    return Statement("NO", use, f"Does not hold 30 frames per second: {measured}.")


def _format_milliseconds(value: float) -> str:
    """Return a time as text, such as "16.2 ms".

    The text has enough decimals to distinguish the time from a limit, such as "16.69 ms".
    """
    # Add decimals until the printed time differs from both limits.
    for decimals in (1, 2, 3):
        printed = f"{value:.{decimals}f}"
        if printed not in (f"{limit:.{decimals}f}" for limit in (SMOOTH_MS, USABLE_MS)):
            break
    return f"{printed} ms"


def _judge_structure(record: Result | None) -> Statement:
    """Return the audit verdict on a mesh."""
    use = "Editing: subdivision, collision, UV unwrapping, printing"
    if record is None or record.audit is None:
        reason = None if record is None else record.reason
        why = "the mesh was not audited" if reason is None else reason.message
        return Statement("UNKNOWN", use, f"{_capitalize(why)}.")
    verdict = record.audit.verdict
    return Statement(_LEVELS[verdict.level], use, f"{_capitalize(verdict.sentence)}.")


def _judge_bake(condition: str, record: Result) -> Statement:
    """Return the audit verdict on a baked mesh, with its size and bake time."""
    label, structure = plain_text(condition.partition("/")[2]), _judge_structure(record)
    facts = ""
    if record.bake is not None and record.asset is not None:
        size = format_value("asset_size", record.asset.bytes)
        mesh = f"The mesh has {record.bake.faces:,} triangles and a size of {size} MiB"
        facts = f" {mesh}. The bake took {record.bake.seconds:.0f} s."
    why = f"{structure.why}{facts}"
    short = f"editing {condition_title(condition)}"
    return Statement(structure.mark, f"Editing the baked mesh ({label})", why, short)


def _make_notes(place: Place, numbers: Numbers, records: Mapping[str, Result]) -> Iterator[Statement]:
    """Yield notes on training, memory, size and accuracy. Notes are judgements without a mark."""
    texts = dict.fromkeys(text for record in records.values() for text in record.trained)
    if texts:
        yield Statement("NOTE", "Training", f"{_capitalize('; '.join(texts))}.")
    memory = [
        f"{condition_title(condition)}: {format_value('memory', value)} MiB"
        for condition in ("standard", "dedicated")
        if (value := numbers.value(Key(*place, condition, "memory"))) is not None
    ]
    sizes = [numbers.value(Key(*place, condition, "asset_size")) for condition in ("standard", "dedicated")]
    size = next((size for size in sizes if size is not None), None)
    if memory:
        yield Statement("NOTE", "Memory while rendering", f"{'; '.join(memory)}.")
    if size is not None:
        text = f"{format_value('asset_size', size)} MiB, the same for both tiers."
        yield Statement("NOTE", "Size on disk", text)
    chamfer = numbers.value(Key(*place, "non_engine", "chamfer"))
    if chamfer is not None:
        text = f"Chamfer distance to the reference scan: {chamfer:.2f} mm on average."
        yield Statement("NOTE", "Surface accuracy", text)


def _capitalize(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


class Similarity(NamedTuple):
    """The mean PSNR in dB between two sets of renderings.

    The comparison uses `views` of the `of` common views.
    """

    psnr: float
    views: int
    of: int


def measure_similarity(first: LoadedResult, second: LoadedResult) -> Similarity | None:
    """Return the PSNR between the renderings of two records.

    If image files are missing or have changed, return None.

    The PSNR of a view is at most 100 dB, which is the value for equal images.
    """
    others = {image.name: image for image in second.images}
    pairs = [(image, others[image.name]) for image in first.images if image.name in others]
    count = min(_MAX_VIEWS, len(pairs))
    compared = [pairs[number * len(pairs) // count] for number in range(count)]
    with ThreadPoolExecutor() as pool:
        values = list(pool.map(lambda pair: _compare_images(first, second, *pair), compared))
    known = [value for value in values if value is not None]
    if not known or len(known) < count:
        return None
    return Similarity(math.fsum(known) / count, count, len(pairs))


def _compare_images(
    first: LoadedResult, second: LoadedResult, image: ImageQuality, other: ImageQuality
) -> float | None:
    """Compare one image of each record, and return the PSNR in dB. If this is impossible, return None."""
    if image.sha256 == other.sha256:
        return PSNR_CAP
    files = first.file(image.file), second.file(other.file)
    if files[0] is None or files[1] is None or first.changed_file(image) or second.changed_file(other):
        return None
    try:
        return min(PSNR_CAP, metrics.psnr(metrics.read_image(files[0]), metrics.read_image(files[1])))
    except MsbError:
        return None

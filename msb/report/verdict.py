"""The verdict on one asset: what it can be used for, in plain words, each statement with its number."""

import math
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from msb import metrics
from msb.bench.records import BAKED, ImageQuality, Result
from msb.errors import MsbError
from msb.metrics.images import PSNR_CAP
from msb.metrics.likeness import ALIKE, NEARLY, decibels
from msb.report.collect import REFERENCE
from msb.report.metric_format import text
from msb.report.numbers import GapKey, Key, Numbers, condition_title, dataset_title, method_title, scene_title
from msb.report.results import Loaded, Place
from msb.report.table import NOT_SUPPORTED
from msb.report.tried import TriedTask, tried_tasks

Mark = Literal["YES", "WITH CARE", "NO", "UNKNOWN", "NOTE"]

# PSNR in dB: an own renderer's pictures below it have next to nothing in common with the photographs.
SHOWS_NOTHING = 15.0
# The least PSNR in dB between two renderings, its mark, and how it is said.
_ALIKE: tuple[tuple[float, Mark, str], ...] = (
    (ALIKE, "YES", "Looks as in"),
    (NEARLY, "WITH CARE", "Looks nearly as in"),
    (0.0, "NO", "Looks different from"),
)
# The loss of PSNR in dB, its mark and how it is said: less than 1 is hard to see, 3 is obvious.
_LOSSES: tuple[tuple[float, Mark, str], ...] = (
    (1.0, "YES", "Looks as in"),
    (3.0, "WITH CARE", "Visibly worse than in"),
    (math.inf, "NO", "Looks different from"),
)
# The P95 of a frame, in milliseconds, that still gives 60 or 30 frames a second.
SMOOTH_MS, USABLE_MS = 1000 / 60, 1000 / 30
# Views of which two renderings are compared, evenly spread: a whole benchmark is not to take minutes.
_MOST = 8
_LEVELS: dict[str, Mark] = {"ok": "YES", "limited": "WITH CARE", "bad": "NO"}


@dataclass(frozen=True)
class Statement:
    """Whether the asset can be used for `use`; `why` has the number that this follows from.

    `short` names the use in a table.
    """

    mark: Mark
    use: str
    why: str
    short: str = ""

    def to_dict(self) -> dict[str, str]:
        """Return it as JSON data."""
        return {"mark": self.mark, "use": self.use, "why": self.why}


@dataclass(frozen=True)
class Verdict:
    """The statements on one asset and scene, and the tasks that were tried on its mesh."""

    place: Place
    statements: tuple[Statement, ...]
    tried: tuple[TriedTask, ...] = ()

    @property
    def title(self) -> str:
        """The heading: method and scene."""
        dataset, scene, method = self.place
        return f"{method_title(method)} on {scene_title(scene)} ({dataset_title(dataset)})"

    def marks(self) -> list[tuple[Mark, list[str]]]:
        """Return the uses under each mark, worst first; notes do not count, and "all" stands for all uses."""
        order: tuple[Mark, ...] = ("NO", "WITH CARE", "UNKNOWN", "YES")
        named = [(mark, [one.short for one in self.statements if one.mark == mark]) for mark in order]
        marked = [(mark, uses) for mark, uses in named if uses]
        return [(marked[0][0], ["all"])] if len(marked) == 1 else marked


def judge(place: Place, loaded: Mapping[str, Loaded], numbers: Numbers) -> Verdict:
    """Return the verdict on the asset of `place`.

    Parameters
    ----------
    place : Place
    loaded : mapping of str to Loaded
        Condition -> record and its files.
    numbers : Numbers
        The numbers and gaps of the results, its scene's included.
    """
    records = {name: one.result for name, one in loaded.items()}
    variants = [name for name in numbers.in_place_of(place.dataset, "dedicated") if name in records]
    dedicated = ["dedicated", *variants]
    looks = {"standard": "A plain mesh in any engine (Standard)"}
    looks |= {name: f"A model with its own shaders ({condition_title(name)})" for name in dedicated}
    bakes = [name for name in numbers.in_place_of(place.dataset, BAKED) if name in records]
    looks |= {name: f"A plain asset made anew, in any engine ({condition_title(name)})" for name in bakes}
    able = {name for name, record in records.items() if record.status != "unsupported"}
    timed = [name for name in ("standard", *dedicated) if name in able]
    statements = [
        *(
            replace(_looks(place, numbers, name, use, loaded), short=condition_title(name))
            for name, use in looks.items()
        ),
        *(replace(_runs(name, records[name]), short=f"real time {condition_title(name)}") for name in timed),
        replace(_structure(records.get("exported_mesh")), short="editing"),
        *(_baked(name, records[name]) for name in bakes),
        *_notes(place, numbers, records),
    ]
    return Verdict(place, tuple(statements), tuple(tried_tasks(loaded.get("exported_mesh"), pictures=False)))


def _looks(
    place: Place, numbers: Numbers, condition: str, use: str, loaded: Mapping[str, Loaded]
) -> Statement:
    """Judge a condition's renderings by how much they look like Non-Engine's, where both files are there.

    Where they are not, the loss of PSNR to the photographs has to do. Without Non-Engine, Standard is held
    against Dedicated.
    """
    number = numbers.number(Key(*place, condition, "psnr"))
    if number.value is None:
        reason = number.reason or "not run"
        if number.absent == NOT_SUPPORTED:
            return Statement("NO", use, f"Not supported: {reason}.")
        return Statement("UNKNOWN", use, f"Not known: {reason}.")
    tier = "dedicated" if condition.startswith("dedicated") else "standard"
    gaps = numbers.gaps.get(GapKey(*place, "psnr", **{tier: condition}))
    gap = None if gaps is None else gaps["deploy" if tier == "standard" else "adapt"]
    start, why = "non_engine", ""
    lacks = (
        "the images of the official renderer cannot be compared"
        if start in loaded
        else "the protocol has no images of the official renderer"
    )
    if tier == "standard" and gaps is not None and (gap is None or gap.signed is None):
        start, gap = "dedicated", gaps["port"]
        why = f" Held against the dedicated tier of this run, as {lacks}."
    if gap is None or gap.signed is None:
        unknown = f"PSNR {number.value:.2f} dB; {lacks}, so there is nothing to judge it by."
        return Statement("UNKNOWN", use, unknown)
    before = numbers.number(Key(*place, start, "psnr"))
    own = "our reference of its own renderer" if REFERENCE in before.notes else "its own renderer"
    own = "the dedicated tier" if start == "dedicated" else own
    amount, verb = f"{abs(gap.signed):.2f}", "gains" if gap.signed < 0 else "loses"
    change = "loses nothing" if amount == "0.00" else f"{verb} {amount} dB"
    change += f" (PSNR {before.value:.2f} to {number.value:.2f} dB)"
    if before.value is not None and before.value < SHOWS_NOTHING:
        far = f"{_capital(own)} is at {before.value:.2f} dB to the photographs, too far to judge others by it"
        return Statement("UNKNOWN", use, f"{far} (PSNR here {number.value:.2f} dB).{why}")
    alike = likeness(loaded[start], loaded[condition])
    if alike is None:
        mark, how = next((mark, how) for least, mark, how in _LOSSES if gap.signed < least)
        said = change
    else:
        part = f" of {alike.views} of {alike.of} views" if alike.views < alike.of else ""
        mark, how = next((mark, how) for least, mark, how in _ALIKE if alike.psnr >= least)
        between = f"{decibels(alike.psnr)} between the two renderings{part}"
        said = f"{between}; to the photographs it {change}"
    return Statement(mark, use, f"{how} {own}: {said}.{why}")


def _runs(condition: str, record: Result) -> Statement:
    use = f"Real time, {condition_title(condition)}"
    timing = record.timing
    if timing is None:
        reason = record.reasons.get("timing") or record.reason
        return Statement("UNKNOWN", use, f"Not timed{f': {reason.message}' if reason else ''}.")
    longest, rate = _milliseconds(timing.p95_ms), f"{timing.fps:.0f} frames a second in all"
    numbers = f"95 % of the frames take at most {longest} ({rate})"
    if timing.p95_ms <= SMOOTH_MS:
        return Statement("YES", use, f"Holds 60 frames a second: {numbers}.")
    if timing.device_kind != "gpu":
        why = f"On a {timing.device_kind.upper()} device {numbers}; a GPU has to be measured."
        return Statement("UNKNOWN", use, why)
    if timing.p95_ms <= USABLE_MS:
        return Statement("WITH CARE", use, f"Holds 30 frames a second, not 60: {numbers}.")
    return Statement("NO", use, f"Does not hold 30 frames a second: {numbers}.")


def _milliseconds(value: float) -> str:
    """Return "16.69 ms" of 16.69, but "16.2 ms" of 16.21: a time is not printed as a limit that it is not."""
    for decimals in (1, 2, 3):
        printed = f"{value:.{decimals}f}"
        if printed not in (f"{limit:.{decimals}f}" for limit in (SMOOTH_MS, USABLE_MS)):
            break
    return f"{printed} ms"


def _structure(record: Result | None) -> Statement:
    use = "Editing: subdivision, collision, UV unwrapping, printing"
    if record is None or record.audit is None:
        reason = None if record is None else record.reason
        why = "the mesh was not audited" if reason is None else reason.message
        return Statement("UNKNOWN", use, f"Not known: {why}.")
    verdict = record.audit.verdict
    return Statement(_LEVELS[verdict.level], use, f"{_capital(verdict.sentence)}.")


def _baked(condition: str, record: Result) -> Statement:
    """Judge the structure of a bake, and say what it takes."""
    title, found = condition_title(condition), _structure(record)
    facts = ""
    if record.bake is not None and record.asset is not None:
        size = text("asset_size", record.asset.bytes)
        facts = f" {record.bake.faces:,} triangles, {size} MiB, made in {record.bake.seconds:.0f} s."
    why = f"{found.why}{facts}"
    return Statement(found.mark, f"Editing a plain asset made anew ({title})", why, f"editing {title}")


def _notes(place: Place, numbers: Numbers, records: Mapping[str, Result]) -> Iterator[Statement]:
    texts = dict.fromkeys(text for one in records.values() for text in one.trained)
    if texts:
        yield Statement("NOTE", "Training", f"{_capital('; '.join(texts))}.")
    taken = [
        f"{text('memory', value)} MiB {condition_title(condition)}"
        for condition in ("standard", "dedicated")
        if (value := numbers.value(Key(*place, condition, "memory"))) is not None
    ]
    sizes = [numbers.value(Key(*place, condition, "asset_size")) for condition in ("standard", "dedicated")]
    size = next((size for size in sizes if size is not None), None)
    if taken:
        yield Statement("NOTE", "Memory while drawing", f"{'; '.join(taken)}.")
    if size is not None:
        yield Statement("NOTE", "Size on disk", f"{text('asset_size', size)} MiB, the same for both.")
    chamfer = numbers.value(Key(*place, "non_engine", "chamfer"))
    if chamfer is not None:
        yield Statement("NOTE", "Measuring", f"The surface is {chamfer:.2f} mm from the scan, in the mean.")


def _capital(sentence: str) -> str:
    return sentence[:1].upper() + sentence[1:]


class Likeness(NamedTuple):
    """The mean PSNR between two sets of renderings in dB, and of how many views of how many it is."""

    psnr: float
    views: int
    of: int


def likeness(first: Loaded, second: Loaded) -> Likeness | None:
    """Return how alike the renderings of two records are; None unless their files are there and unchanged.

    The PSNR of a pair is capped at 100 dB, which equal images have.
    """
    others = {image.name: image for image in second.images}
    pairs = [(image, others[image.name]) for image in first.images if image.name in others]
    count = min(_MOST, len(pairs))
    chosen = [pairs[number * len(pairs) // count] for number in range(count)]
    with ThreadPoolExecutor() as pool:
        values = list(pool.map(lambda pair: _between(first, second, *pair), chosen))
    known = [value for value in values if value is not None]
    if not known or len(known) < count:
        return None
    return Likeness(math.fsum(known) / count, count, len(pairs))


def _between(first: Loaded, second: Loaded, one: ImageQuality, other: ImageQuality) -> float | None:
    if one.sha256 == other.sha256:
        return PSNR_CAP
    files = first.file(one.file), second.file(other.file)
    if files[0] is None or files[1] is None or first.changed(one) or second.changed(other):
        return None
    try:
        return min(PSNR_CAP, metrics.psnr(metrics.read_image(files[0]), metrics.read_image(files[1])))
    except MsbError:
        return None

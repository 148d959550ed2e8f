"""The verdict on one asset: what it can be used for, in plain words, each statement with its number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from msb.bench.gaps import PAIRS
from msb.report.collect import REFERENCE
from msb.report.metric_format import text
from msb.report.numbers import GapKey, Key, condition_title, dataset_title, method_title, scene_title

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from msb.bench.gaps import GapName
    from msb.bench.records import Result
    from msb.report.numbers import Numbers
    from msb.report.results import Place

Mark = Literal["YES", "WITH CARE", "NO", "UNKNOWN", "NOTE"]

SMALL_LOSS, LARGE_LOSS = 1.0, 3.0
"""Losses of PSNR in dB: a smaller one than the first is hard to see, one of the second is obvious."""
SMOOTH_MS, USABLE_MS = 1000 / 60, 1000 / 30
"""The P95 of a frame, in milliseconds, that still gives 60 or 30 frames a second."""
_LEVELS: dict[str, Mark] = {"ok": "YES", "limited": "WITH CARE", "bad": "NO"}


@dataclass(frozen=True)
class Statement:
    """Whether the asset can be used for `use`; `why` has the number that this follows from."""

    mark: Mark
    use: str
    why: str

    def to_dict(self) -> dict[str, str]:
        """Return it as JSON data."""
        return {"mark": self.mark, "use": self.use, "why": self.why}


@dataclass(frozen=True)
class Verdict:
    """The statements on one asset and scene."""

    place: Place
    statements: tuple[Statement, ...]

    @property
    def title(self) -> str:
        """The heading: method and scene."""
        dataset, scene, method = self.place
        return f"{method_title(method)} on {scene_title(scene)} ({dataset_title(dataset)})"

    def marks(self) -> list[tuple[Mark, int]]:
        """Return how often each mark stands, worst first; notes do not count."""
        order: tuple[Mark, ...] = ("NO", "WITH CARE", "UNKNOWN", "YES")
        counted = [(mark, sum(one.mark == mark for one in self.statements)) for mark in order]
        return [(mark, count) for mark, count in counted if count]


def judge(place: Place, records: Mapping[str, Result], numbers: Numbers) -> Verdict:
    """Return the verdict on the asset of `place`.

    Parameters
    ----------
    place : Place
    records : mapping of str to Result
        Condition -> record.
    numbers : Numbers
        The numbers and gaps of the results, its scene's included.
    """
    variants = [name for name in numbers.in_place_of(place.dataset, "dedicated") if name in records]
    dedicated = ["dedicated", *variants]
    statements = [
        _looks(place, numbers, "standard", "deploy", "A plain mesh in any engine (Standard)"),
        *(
            _looks(place, numbers, name, "adapt", f"A model with its own shaders ({condition_title(name)})")
            for name in dedicated
        ),
        *(
            _runs(condition, records[condition])
            for condition in ("standard", *dedicated)
            if _could_run(records.get(condition))
        ),
        *_structure(records),
        *_notes(place, numbers),
    ]
    return Verdict(place, tuple(statements))


def _looks(place: Place, numbers: Numbers, condition: str, name: GapName, use: str) -> Statement:
    number = numbers.number(Key(*place, condition, "psnr"))
    if number.value is None:
        mark: Mark = "NO" if number.absent == "N/A" else "UNKNOWN"
        return Statement(
            mark, use, f"{'Not supported' if mark == 'NO' else 'Not known'}: {number.reason or 'not run'}."
        )
    tier = "standard" if condition == "standard" else "dedicated"
    gaps = numbers.gaps.get(GapKey(*place, "psnr", **{tier: condition}))
    gap = None if gaps is None else gaps[name]
    if gap is None or gap.signed is None:
        return Statement(
            "UNKNOWN", use, f"PSNR {number.value:.2f} dB; there is nothing comparable to hold it against."
        )
    before = numbers.number(Key(*place, PAIRS[name][0], "psnr"))
    own = "our reference of its own renderer" if REFERENCE in before.notes else "its own renderer"
    values = f"{abs(gap.signed):.2f} dB (PSNR {before.value:.2f} to {number.value:.2f} dB)"
    if gap.signed < SMALL_LOSS:
        how = "loses" if gap.signed >= 0 else "gains"
        return Statement("YES", use, f"Looks as in {own}: {how} {values}.")
    if gap.signed < LARGE_LOSS:
        return Statement("WITH CARE", use, f"Visibly worse than in {own}: loses {values}.")
    return Statement("NO", use, f"Looks different from {own}: loses {values}.")


def _could_run(record: Result | None) -> bool:
    return record is not None and record.status != "unsupported"


def _runs(condition: str, record: Result) -> Statement:
    use = f"Real time, {condition_title(condition)}"
    timing = record.timing
    if timing is None:
        reason = record.reasons.get("timing") or record.reason
        return Statement("UNKNOWN", use, f"Not timed{f': {reason.message}' if reason else ''}.")
    numbers = (
        f"95 % of the frames take at most {timing.p95_ms:.1f} ms ({timing.fps:.0f} frames a second in all)"
    )
    if timing.p95_ms <= SMOOTH_MS:
        return Statement("YES", use, f"Holds 60 frames a second: {numbers}.")
    if timing.device_kind != "gpu":
        why = f"On a {timing.device_kind.upper()} device {numbers}; a GPU has to be measured."
        return Statement("UNKNOWN", use, why)
    if timing.p95_ms <= USABLE_MS:
        return Statement("WITH CARE", use, f"Holds 30 frames a second, not 60: {numbers}.")
    return Statement("NO", use, f"Does not hold 30 frames a second: {numbers}.")


def _structure(records: Mapping[str, Result]) -> Iterator[Statement]:
    use = "Editing: subdivision, collision, UV unwrapping, printing"
    record = records.get("exported_mesh")
    if record is None or record.audit is None:
        reason = (
            record.reason.message
            if record is not None and record.reason is not None
            else "the mesh was not audited"
        )
        yield Statement("UNKNOWN", use, f"Not known: {reason}.")
        return
    verdict: Any = record.audit.get("verdict")
    if isinstance(verdict, dict) and verdict.get("level") in _LEVELS:
        yield Statement(_LEVELS[verdict["level"]], use, f"{_capital(str(verdict.get('sentence')))}.")
    else:
        share = record.audit["metrics"].get("nonmanifold_vertex_ratio")
        why = "" if share is None else f": {100 * share:.0f} % of its vertices are non-manifold"
        yield Statement("UNKNOWN", use, f"The audit of this record holds no verdict{why}.")


def _notes(place: Place, numbers: Numbers) -> Iterator[Statement]:
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

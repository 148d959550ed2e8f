"""Findings on what a method loses from one condition to another: its gaps, and how they add up."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from msb.bench.gaps import PAIRS
from msb.report.collect import REFERENCE
from msb.report.finding import Case, Finding, sure
from msb.report.metric_format import SHOWN, digits, text
from msb.report.numbers import MEAN, Key, condition_title, dataset_title, method_title
from msb.report.safe_names import slug

if TYPE_CHECKING:
    from msb.bench.gaps import GapName, Gaps
    from msb.report.numbers import GapKey, Numbers

_NOTHING = 0.005
"""A difference of less than this many dB is printed as 0.00."""
_GAPS: dict[GapName, str] = {"adapt": "adaptation", "port": "portability", "deploy": "deployment"}


def gap_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the largest and the smallest of each gap in PSNR, and of the first one to each variant."""
    variants = dict.fromkeys(key.dedicated for key in numbers.gaps if key.dedicated != "dedicated")
    for dedicated in ("dedicated", *variants):
        for name, word in _GAPS.items():
            if dedicated != "dedicated" and name != "adapt":
                continue  # the rest of the way has to do with the standard tier, not with the variant
            cases = list(_gap_cases(numbers, name, dedicated))
            if cases:
                ends = (dedicated if end == "dedicated" else end for end in PAIRS[name])
                sentence = _gap_sentence(cases, word, *map(condition_title, ends))
                own = "" if name == "port" else _own_reference(numbers, cases)
                yield Finding(f"{name}_gap", f"{sentence}{own}.", f"gaps-{slug(max(cases).dataset)}")


def _gap_sentence(cases: list[Case], word: str, start: str, end: str) -> str:
    first, last = max(cases), min(cases)
    if max(abs(case.value) for case in cases) < _NOTHING:
        who = first.name if len(cases) == 1 else f"any of the {len(cases)} cases"
        return f"{start} to {end} changes the PSNR of {who} by less than {_NOTHING} dB"
    if first.value >= _NOTHING:
        sentence = f"{start} to {end} costs {first.name} {first.detail}"
    else:
        sentence = f"{start} to {end} loses nothing: {first.name} {first.detail}"
    if len(cases) > 1:
        sentence += f", the largest {word} gap of {len(cases)}"
        if first.value - last.value >= _NOTHING:
            sentence += f"; the smallest is {last.detail}, of {last.name}"
    return sentence


def _own_reference(numbers: Numbers, cases: list[Case]) -> str:
    """Return what is to be said where Non-Engine is no official rendering."""
    notes = [
        numbers.number(Key(case.dataset, MEAN, case.method, "non_engine", "psnr")).notes for case in cases
    ]
    if not any(REFERENCE in own for own in notes):
        return ""
    where = "Non-Engine" if all(REFERENCE in own for own in notes) else "some of Non-Engine"
    return f"; {where} is drawn by our own reference renderer here, not by the method's own code"


def _gap_cases(numbers: Numbers, name: GapName, dedicated: str) -> Iterator[Case]:
    for key, gaps in numbers.gaps.items():
        gap = gaps[name]
        if (key.scene, key.metric, key.standard, key.dedicated) != (MEAN, "psnr", "standard", dedicated):
            continue
        if gap.signed is None or gap.ends is None:
            continue
        values = " to ".join(f"{value:.2f}" for value in gap.ends)
        partial = f", over {gap.scenes} of {gap.expected} scenes" if gap.partial else ""
        gain = "a gain, " if gap.signed <= -_NOTHING else ""
        detail = f"{digits(gap.signed, 2)} dB ({gain}{values}{partial}){sure(gap.interval)}"
        yield Case(gap.signed, key.dataset, key.method, detail)


def monotone_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the cases in which Dedicated, or a variant of it, does not lie between the other two."""
    known = [
        (key, gaps)
        for key, gaps in numbers.gaps.items()
        if (key.scene, key.standard) == (MEAN, "standard") and gaps.monotone is not None
    ]
    broken: dict[tuple[str, str, str], list[tuple[GapKey, Gaps]]] = {}
    for key, gaps in known:
        if gaps.monotone is False:
            broken.setdefault((key.dataset, key.method, key.dedicated), []).append((key, gaps))
    if not known:
        return
    if not broken:
        sentence = (
            f"In all {len(known)} cases in which the three conditions can be compared, Dedicated lies "
            "between Non-Engine and Standard: the adaptation and portability gaps add up to the deployment "
            "gap."
        )
        yield Finding("monotone", sentence, f"gaps-{slug(known[0][0].dataset)}")
    for dedicated in dict.fromkeys(place[2] for place in broken):
        own = {place: cases for place, cases in broken.items() if place[2] == dedicated}
        yield _not_monotone(own, len({key[:3] for key, _ in known if key.dedicated == dedicated}))


def _not_monotone(broken: dict[tuple[str, str, str], list[tuple[GapKey, Gaps]]], known: int) -> Finding:
    """Return the finding on the largest excess through one tier or variant, and the names of the others."""

    def excess(place: tuple[str, str, str]) -> float:
        return broken[place][0][1].triangle_excess or 0.0

    first, *others = sorted(broken, key=excess, reverse=True)
    (dataset, method, dedicated), cases = first, broken[first]
    title, (key, gaps) = condition_title(dedicated), cases[0]
    better = (
        f"{title} is better than Non-Engine" if (gaps.adapt.signed or 0) < 0 else f"Standard beats {title}"
    )
    losses = "losses" if len(cases) == 1 else f"losses in {SHOWN[key.metric].title}"
    metrics = " and ".join(SHOWN[one.metric].title for one, _ in cases)
    signs = ", ".join(
        f"{name} {digits(gaps[name].signed or 0, SHOWN[key.metric].decimals, sign=True)}" for name in _GAPS
    )
    sentence = (
        f"{method_title(method)} on {dataset_title(dataset)} is not monotone in {metrics}: {better} "
        f"({losses}: {signs}), so adapt + port exceeds deploy by "
        f"{text(key.metric, gaps.triangle_excess or 0.0)}"
    )
    if others:
        names = ", ".join(
            f"{method_title(method)} on {dataset_title(dataset)}" for dataset, method, _ in others
        )
        sentence += f". {len(broken)} of {known} comparisons are not monotone; the others are {names}"
    return Finding("not_monotone", f"{sentence}.", f"gaps-{slug(dataset)}")

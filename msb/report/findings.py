"""The findings: what the numbers say in sentences, each with its numbers and the table they stand in."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

from msb.bench.aggregate import METRICS
from msb.bench.gaps import PAIRS
from msb.bench.intervals import excludes_zero, interval
from msb.report.collect import REFERENCE, SOUP
from msb.report.metric_format import SHOWN, text
from msb.report.numbers import MEAN, QUALITY, Key, condition_title, dataset_title, method_title
from msb.report.safe_names import slug
from msb.report.table import NOT_SUPPORTED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from msb.bench.gaps import GapName, Gaps
    from msb.report.numbers import GapKey, Numbers

_NOTHING = 0.005
"""A difference of less than this many dB is printed as 0.00."""
_GAPS: dict[GapName, str] = {"adapt": "adaptation", "port": "portability", "deploy": "deployment"}
_MOST = 10
"""Findings; more are not read."""
_MINOR = ("monotone", "same_ranking", "training", "unsupported")
"""Kinds of what is as one expects, or is no finding on deployment."""


@dataclass(frozen=True)
class Finding:
    """One sentence. `table` labels the table of its numbers; `kind` says what it is about."""

    kind: str
    sentence: str
    table: str

    def to_dict(self) -> dict[str, Any]:
        """Return it as JSON data."""
        return {"kind": self.kind, "sentence": self.sentence, "table": self.table}


class _Case(NamedTuple):
    value: float
    dataset: str
    method: str
    detail: str

    @property
    def name(self) -> str:
        return f"{method_title(self.method)} on {dataset_title(self.dataset)}"


def find(numbers: Numbers) -> list[Finding]:
    """Return at most ten findings, most important first. Where there are no numbers there are no findings."""
    found = [
        *_gap_findings(numbers),
        *_monotone_findings(numbers),
        *_ranking_findings(numbers),
        *_leader_findings(numbers),
        *_training_findings(numbers),
        *_speed_findings(numbers),
        *_structure_findings(numbers),
        *_unsupported_findings(numbers),
    ]
    # What did not change, and what there is not, comes last; else the order is that above.
    return sorted(found, key=lambda one: one.kind in _MINOR)[:_MOST]


def _gap_findings(numbers: Numbers) -> Iterator[Finding]:
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


def _gap_sentence(cases: list[_Case], word: str, start: str, end: str) -> str:
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


def _own_reference(numbers: Numbers, cases: list[_Case]) -> str:
    """Return what is to be said where Non-Engine is no official rendering."""
    notes = [
        numbers.number(Key(case.dataset, MEAN, case.method, "non_engine", "psnr")).notes for case in cases
    ]
    if not any(REFERENCE in own for own in notes):
        return ""
    where = "Non-Engine" if all(REFERENCE in own for own in notes) else "some of Non-Engine"
    return f"; {where} is drawn by our own reference renderer here, not by the method's own code"


def _gap_cases(numbers: Numbers, name: GapName, dedicated: str) -> Iterator[_Case]:
    for key, gaps in numbers.gaps.items():
        gap = gaps[name]
        if (key.scene, key.metric, key.standard, key.dedicated) != (MEAN, "psnr", "standard", dedicated):
            continue
        if gap.signed is None or gap.ends is None:
            continue
        values = " to ".join(f"{value:.2f}" for value in gap.ends)
        partial = f", over {gap.scenes} of {gap.expected} scenes" if gap.partial else ""
        gain = "a gain, " if gap.signed <= -_NOTHING else ""
        # A loss that rounds to nothing has no sign.
        sure = _sure(gap.significant)
        detail = f"{round(gap.signed, 2) + 0.0:.2f} dB ({gain}{values}{partial}){sure}"
        yield _Case(gap.signed, key.dataset, key.method, detail)


def _sure(significant: bool | None) -> str:
    """Return what is said of a difference's significance; nothing where nothing is known."""
    if significant is None:
        return ""
    return ", significant at 95 %" if significant else ", not significant at 95 %"


def _monotone_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the cases in which Dedicated, or a variant of it, does not lie between the other two."""
    known = [
        (key, gaps)
        for key, gaps in numbers.gaps.items()
        if (key.scene, key.standard) == (MEAN, "standard") and gaps.monotone is not None
    ]
    broken: dict[tuple[str, str, str], list[tuple[GapKey, Gaps]]] = {}
    for key, gaps in known:
        if gaps.monotone is False and (gaps.triangle_excess or 0.0) >= SHOWN[key.metric].last_digit:
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
    signs = ", ".join(f"{name} {text_of(key.metric, gaps[name].signed)}" for name in _GAPS)
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


def text_of(metric: str, value: float | None) -> str:
    """Return a signed loss as printed."""
    return "--" if value is None else f"{'+' if value >= 0 else '-'}{text(metric, abs(value))}"


def _ranking_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield where the order of the methods by PSNR changes from one condition to another, and where not."""
    same: list[str] = []
    label = ""
    for dataset in numbers.datasets():
        conditions = [name for name in numbers.conditions(dataset) if not name.startswith("standard/")]
        changes: dict[str, list[str]] = {}
        compared = 0
        for first, second in combinations(conditions, 2):
            if "/" in first or first.partition("/")[0] == second.partition("/")[0]:
                continue  # a variant is held against Non-Engine alone
            before, after = (
                _ranking(numbers, dataset, first, second),
                _ranking(numbers, dataset, second, first),
            )
            if len(before) < 2:
                continue
            compared += 1
            if swapped := _swapped(before, after):
                known = [_difference(numbers, dataset, c, *pair) for pair in swapped for c in (first, second)]
                both = [None not in ends and all(ends) for ends in zip(known[::2], known[1::2], strict=True)]
                sure = _sure(None if None in known else any(both))
                names = f"{condition_title(first)} and {condition_title(second)}{sure}"
                changes.setdefault(f"{_order(before)} becomes {_order(after)}", []).append(names)
        if changes:
            every = "; ".join(f"{', '.join(names)} ({order})" for order, names in changes.items())
            sentence = f"On {dataset_title(dataset)} the ranking by PSNR changes between {every}."
            yield Finding("ranking", sentence, f"renderer_comparison-{slug(dataset)}")
        elif compared:
            same.append(dataset_title(dataset))
            label = label or f"renderer_comparison-{slug(dataset)}"
    if same:
        sentence = f"On {', '.join(same)} the ranking by PSNR is the same under every condition."
        yield Finding("same_ranking", sentence, label)


def _leader_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield on which datasets another method leads by another metric: images against the surface, say."""
    found: list[str] = []
    table = ""
    for dataset in numbers.datasets():
        for condition in ("non_engine", "dedicated"):
            leaders = _leaders(numbers, dataset, condition)
            if len(leaders) < 2:
                continue
            each = ", ".join(
                f"{method_title(method)} by {' and '.join(by)}" for method, by in leaders.items()
            )
            found.append(f"on {dataset_title(dataset)} ({condition_title(condition)}) {each}")
            own = condition == "non_engine"
            table = table or ("native_summary" if own else f"renderer_comparison-{slug(dataset)}")
            break
    if found:
        yield Finding("leaders", f"No method leads by every metric: {'; '.join(found)}.", table)


def _leaders(numbers: Numbers, dataset: str, condition: str) -> dict[str, list[str]]:
    """Return method -> by what it leads; the Chamfer distance stands with the Non-Engine results."""
    leaders: dict[str, list[str]] = {}
    for metric in (*QUALITY, "chamfer"):
        best = _leader(numbers, dataset, "non_engine" if metric == "chamfer" else condition, metric)
        if best is not None:
            unit = f" {SHOWN[metric].unit}" if SHOWN[metric].unit in ("dB", "mm") else ""
            leaders.setdefault(best[0], []).append(f"{SHOWN[metric].title} {text(metric, best[1])}{unit}")
    return leaders


def _leader(numbers: Numbers, dataset: str, condition: str, metric: str) -> tuple[str, float] | None:
    """Return the best of at least two methods with whole means, and its value; None where two are equal."""
    found = {
        method: number.value
        for method in numbers.methods(dataset, condition)
        if (number := numbers.number(Key(dataset, MEAN, method, condition, metric))).value is not None
        and number.present == number.expected
    }
    ranked = sorted(found.items(), key=lambda one: one[1], reverse=METRICS[metric].better == "higher")
    if len(ranked) < 2 or abs(ranked[0][1] - ranked[1][1]) < SHOWN[metric].last_digit:
        return None
    return ranked[0]


def _training_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield how long the trainings took, the quickest and the longest of all means."""
    cases = [
        _Case(number.value, key.dataset, key.method, f"{text('train_seconds', number.value)} min")
        for key, number in numbers.values.items()
        if (key.scene, key.metric, key.source) == (MEAN, "train_seconds", "") and number.value is not None
    ]
    if not cases:
        return
    first, last = min(cases), max(cases)
    if last.value - first.value >= SHOWN["train_seconds"].last_digit:
        sentence = f"A training takes from {first.detail} ({first.name}) to {last.detail} ({last.name})."
        yield Finding("training", sentence, "native_summary")


def _ranking(numbers: Numbers, dataset: str, condition: str, other: str) -> list[tuple[str, float]]:
    """Return the methods that have whole means in both conditions, best in `condition` first."""
    found = []
    for method in numbers.methods(dataset, condition):
        both = [numbers.number(Key(dataset, MEAN, method, c, "psnr")) for c in (condition, other)]
        if both[0].value is not None and all(n.value is not None and n.present == n.expected for n in both):
            found.append((method, both[0].value))
    return sorted(found, key=lambda pair: -pair[1])


def _swapped(before: list[tuple[str, float]], after: list[tuple[str, float]]) -> list[tuple[str, str]]:
    """Return the pairs of methods of which the second overtakes the first, by what a table shows."""
    digit, values = SHOWN["psnr"].last_digit, dict(after)
    return [
        (better, worse)
        for (better, first), (worse, second) in combinations(before, 2)
        if first - second >= digit and values[worse] - values[better] >= digit
    ]


def _difference(numbers: Numbers, dataset: str, condition: str, one: str, other: str) -> bool | None:
    """Return whether the PSNR of two methods differs significantly, from the views that both have."""
    scenes = []
    for scene in numbers.scenes(dataset):
        values, others = (
            numbers.views.get(Key(dataset, scene, method, condition, "psnr"), {}) for method in (one, other)
        )
        if common := [values[view] - others[view] for view in values if view in others]:
            scenes.append(common)
    return excludes_zero(interval(scenes)) if scenes else None


def _order(ranking: list[tuple[str, float]]) -> str:
    return ", ".join(f"{method_title(method)} {value:.2f}" for method, value in ranking)


def _speed_findings(numbers: Numbers) -> Iterator[Finding]:
    for above, below, kind, what in (
        ("standard", "dedicated", "slowdown", "Standard is {low} to {high} times as fast as Dedicated"),
        (
            "dedicated",
            "non_engine",
            "against_native",
            "Dedicated runs at {low} to {high} times the frame rate of Non-Engine",
        ),
    ):
        cases = [
            _Case(ratio.value, key.dataset, key.method, f"{ratio.value:.1f}")
            for key, ratio in numbers.ratios.items()
            if (key.numerator, key.denominator) == (above, below) and ratio.value is not None
        ]
        if not cases:
            continue
        low, high = min(cases), max(cases)
        if len(cases) == 1:
            one = what.replace("{low} to {high}", low.detail)
            yield Finding(kind, f"{one} ({low.name}, by frame rate).", "slowdown")
        else:
            range_ = what.format(low=low.detail, high=high.detail)
            yield Finding(
                kind, f"{range_} (least {low.name}, most {high.name}; by mean frame rates).", "slowdown"
            )


def _structure_findings(numbers: Numbers) -> Iterator[Finding]:
    cases = [
        _Case(number.value, key.dataset, key.method, f"{100 * number.value:.0f} %")
        for key, number in numbers.values.items()
        if (key.scene, key.metric) == (MEAN, "nonmanifold_vertex_ratio")
        and number.value is not None
        and SOUP not in number.notes
    ]
    if not cases:
        return
    low, high = min(cases), max(cases)
    label = f"mesh_connectivity-{slug(high.dataset)}"
    if high.value == 0:
        yield Finding(
            "structure", f"None of the indexed meshes ({len(cases)} means) has a non-manifold vertex.", label
        )
        return
    pieces = numbers.value(Key(high.dataset, MEAN, high.method, "exported_mesh", "components"))
    sentence = f"{high.detail} of the vertices of {high.name} are non-manifold"
    if pieces is not None:
        count = text("components", pieces)
        sentence += f", in {count} {'piece' if count == '1' else 'pieces'}"
    if len(cases) > 1:
        sentence += f", the most of {len(cases)} indexed meshes; the least are {low.detail}, of {low.name}"
    yield Finding("structure", f"{sentence}.", label)


def _unsupported_findings(numbers: Numbers) -> Iterator[Finding]:
    names: dict[str, dict[str, None]] = {}
    first = ""
    for key, number in numbers.values.items():
        if (
            (key.scene, key.metric) == (MEAN, "psnr")
            and number.value is None
            and number.absent == NOT_SUPPORTED
        ):
            names.setdefault(method_title(key.method), {})[condition_title(key.condition)] = None
            first = first or key.dataset
    if names:
        each = "; ".join(f"{name} under {' and '.join(conditions)}" for name, conditions in names.items())
        yield Finding("unsupported", f"Not supported: {each}.", f"renderer_comparison-{slug(first)}")

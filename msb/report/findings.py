"""The findings: what the numbers say in sentences, each with its numbers and the table they stand in."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import accumulate, combinations
from typing import NamedTuple

from msb.bench.aggregate import METRICS
from msb.bench.gaps import PAIRS, GapName, Gaps
from msb.bench.intervals import Interval, excludes_zero, interval
from msb.bench.records import BAKED
from msb.report.collect import REFERENCE, SOUP
from msb.report.metric_format import digits, text
from msb.report.numbers import (
    MEAN,
    ON_CPU,
    QUALITY,
    GapKey,
    Key,
    Numbers,
    condition_title,
    dataset_title,
    method_title,
)
from msb.report.safe_names import plain_text, slug
from msb.report.table import NOT_SUPPORTED
from msb.report.tables.bakes import STEP_TITLES

# Findings; more are not read.
_MOST = 12
# Kinds of findings whose place no number of others takes.
_ALWAYS = ("slowdown", "engine_slowdown", "walk", "structure", "training", "unsupported")
# Kinds of what is as one expects, or is no finding on deployment.
_MINOR = ("monotone", "same_ranking", "training", "unsupported")
# A difference of less than this many dB is printed as 0.00.
_NOTHING = 0.005
# Metrics besides image quality that a method may lead by -> the condition whose number is the method's.
_COSTS = {
    "chamfer": "non_engine",
    "fps": "dedicated",
    "memory": "dedicated",
    "asset_size": "dedicated",
    "train_seconds": "non_engine",
    "train_memory": "non_engine",
}
_GAPS: dict[GapName, str] = {"adapt": "adaptation", "port": "portability", "deploy": "deployment"}


@dataclass(frozen=True)
class Finding:
    """One sentence. `table` labels the table of its numbers; `kind` says what it is about."""

    kind: str
    sentence: str
    table: str


class _Case(NamedTuple):
    """A number of a method on a dataset, in a sentence its `detail`; cases sort by their numbers."""

    value: float
    dataset: str
    method: str
    detail: str

    @property
    def name(self) -> str:
        """The method and the dataset, as titles."""
        return _name(self.dataset, self.method)


def _name(dataset: str, method: str) -> str:
    return f"{method_title(method)} on {dataset_title(dataset)}"


def _mean_cases(
    numbers: Numbers, metric: str, detail: Callable[[Key, float], str], without: str = ""
) -> list[_Case]:
    """Return all of our means of a metric with their `detail`, except those with the note `without`."""
    return [
        _Case(number.value, key.dataset, key.method, detail(key, number.value))
        for key, number in numbers.values.items()
        if (key.scene, key.metric, key.source) == (MEAN, metric, "")
        and number.value is not None
        and without not in number.notes
    ]


def _sure(difference: Interval | None) -> str:
    """Return what is said of a difference's significance, or why nothing is; nothing of bare numbers."""
    if difference is None:
        return ""
    if difference.p is None:
        return f", not tested: {difference.reason}"
    certain = "" if excludes_zero(difference) else "not "
    return f", {certain}significant at 95 % (t interval over {difference.over})"


def find(numbers: Numbers, first: Iterable[Finding] = ()) -> list[Finding]:
    """Return at most twelve findings, those in `first` and then the most important. No numbers, no findings.

    Those on speed and structure stay, whatever there is to be said of quality.
    """
    findings = [
        *first,
        *_gap_findings(numbers),
        *_split_findings(numbers),
        *_monotone_findings(numbers),
        *_ranking_findings(numbers),
        *_leader_findings(numbers),
        *_surface_findings(numbers),
        *_training_findings(numbers),
        *_speed_findings(numbers),
        *_walk_findings(numbers),
        *_structure_findings(numbers),
        *_unsupported_findings(numbers),
    ]
    # What did not change, and what there is not, comes last; else the order is that above.
    findings.sort(key=lambda one: one.kind in _MINOR)
    others = [one for one in findings if one.kind not in _ALWAYS]
    left_out = others[max(0, _MOST - (len(findings) - len(others))) :]
    return [one for one in findings if one not in left_out]


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
        detail = f"{digits(gap.signed, 2)} dB ({gain}{values}{partial}){_sure(gap.interval)}"
        yield _Case(gap.signed, key.dataset, key.method, detail)


def _split_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield what the largest loss from Dedicated to Standard is made of, and how much bakes give back."""
    whole = {
        key: split
        for key, split in numbers.splits.items()
        if (key.scene, key.metric) == (MEAN, "psnr")
        and split.total is not None
        and split.total.signed is not None
        and all(gap.signed is not None for gap in split.steps.values())
    }
    cases = []
    for key, split in whole.items():
        if split.total is not None and split.total.signed is not None:
            # A bake may be worse than the ceiling: the best of them counts.
            back = accumulate(gap.signed or 0.0 for name, gap in split.steps.items() if name != "blending")
            cases.append((split.total.signed, max(back), key))
    if not cases:
        return
    total, _, key = max(cases)
    split = whole[key]
    parts = []
    for name, gap in split.steps.items():
        names = [one for one, other in split.within.items() if other == name]
        title = " and ".join(STEP_TITLES[one].lower() for one in (*names, name))
        parts.append(f"{title} {digits(gap.signed or 0.0, 2)}")
    sentence = (
        f"The {digits(total, 2)} dB that {_name(key.dataset, key.method)} loses from Dedicated to Standard: "
        f"{', '.join(parts)}"
    )
    shares = [100 * back / lost for lost, back, _ in cases if lost >= _NOTHING]
    if len(shares) > 1:
        low, high = min(shares), max(shares)
        sentence += f"; baking gives {low:.0f} to {high:.0f} % of such a loss back, in {len(shares)} cases"
    elif shares:
        sentence += f"; baking gives {shares[0]:.0f} % of it back"
    yield Finding("loss_split", f"{sentence}.", f"loss_split-{slug(key.dataset)}")


def _monotone_findings(numbers: Numbers) -> Iterator[Finding]:
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
    gains = (gaps.adapt.signed or 0) < 0
    better = f"{title} is better than Non-Engine" if gains else f"Standard beats {title}"
    losses = "losses" if len(cases) == 1 else f"losses in {METRICS[key.metric].title}"
    metrics = " and ".join(METRICS[one.metric].title for one, _ in cases)
    signs = ", ".join(
        f"{name} {digits(gaps[name].signed or 0, METRICS[key.metric].decimals, sign=True)}" for name in _GAPS
    )
    sentence = (
        f"{_name(dataset, method)} is not monotone in {metrics}: {better} "
        f"({losses}: {signs}), so adapt + port exceeds deploy by "
        f"{text(key.metric, gaps.triangle_excess or 0.0)}"
    )
    if others:
        names = ", ".join(_name(*place[:2]) for place in others)
        sentence += f". {len(broken)} of {known} comparisons are not monotone; the others are {names}"
    return Finding("not_monotone", f"{sentence}.", f"gaps-{slug(dataset)}")


def _ranking_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield where the order of the methods by PSNR changes from one condition to another, and where not."""
    changed: dict[str, str] = {}
    same: dict[str, str] = {}
    for dataset in numbers.datasets():
        conditions = [
            name for name in numbers.conditions(dataset) if not name.startswith(("standard/", f"{BAKED}/"))
        ]
        changes: dict[str, list[str]] = {}
        moved: set[str] = set()
        compared = 0
        for first, second in combinations(conditions, 2):
            if "/" in first or first.partition("/")[0] == second.partition("/")[0]:
                continue  # a variant is held against Non-Engine alone
            before = _ranking(numbers, dataset, first, second)
            after = _ranking(numbers, dataset, second, first)
            if len(before) < 2:
                continue
            compared += 1
            if swapped := _swapped(before, after):
                certain = min((_swap(numbers, dataset, pair, (first, second)) for pair in swapped), key=_p)
                names = f"{condition_title(first)} and {condition_title(second)}"
                changes.setdefault(_sure(certain), []).append(names)
                moved |= {first, second}
        if changes:
            every = "; ".join(f"{', '.join(names)}{sure}" for sure, names in changes.items())
            orders: dict[str, list[str]] = {}
            for condition in filter(moved.__contains__, conditions):
                order = _order(_ordered(numbers, dataset, condition, "psnr"))
                orders.setdefault(order, []).append(condition_title(condition))
            each = "; ".join(f"{' and '.join(titles)}: {order}" for order, titles in orders.items())
            where = f"On {dataset_title(dataset)} the ranking by PSNR changes between"
            changed[dataset] = f"{where} {every} ({each})."
        elif compared:
            same[dataset] = dataset_title(dataset)
    sentences = [*changed.values()]
    if same:
        names = ", ".join(same.values())
        sentences.append(f"On {names} the ranking by PSNR is the same under every condition.")
    if sentences:
        label = f"renderer_comparison-{slug(next(iter({**changed, **same})))}"
        yield Finding("ranking" if changed else "same_ranking", " ".join(sentences), label)


def _leader_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield on which datasets another method leads by another metric: images against speed, say."""
    sentences: list[str] = []
    table = ""
    for dataset in numbers.datasets():
        for condition in ("non_engine", "dedicated"):
            leaders = _leaders(numbers, dataset, condition)
            if len(leaders) < 2:
                continue
            each = ", ".join(f"{method_title(method)} by {_listed(by)}" for method, by in leaders.items())
            sentences.append(f"on {dataset_title(dataset)} ({condition_title(condition)}) {each}")
            own = condition == "non_engine"
            table = table or ("native_summary" if own else f"renderer_comparison-{slug(dataset)}")
            break
    if sentences:
        yield Finding("leaders", f"No method leads by every metric: {'; '.join(sentences)}.", table)


def _leaders(numbers: Numbers, dataset: str, condition: str) -> dict[str, list[str]]:
    """Return method -> by what it leads; none if there is no image quality to compare."""
    leaders: dict[str, list[str]] = {}
    seen = any(_ordered(numbers, dataset, condition, metric) for metric in QUALITY)
    for metric in (*QUALITY, *_COSTS) if seen else ():
        of = _COSTS.get(metric, condition)
        best = _leader(numbers, dataset, of, metric)
        if best is not None:
            where = f"{condition_title(of)} " if of != condition and metric in ("fps", "memory") else ""
            what = f"{where}{METRICS[metric].title} {_with_unit(metric, best[1])}"
            leaders.setdefault(best[0], []).append(what)
    return leaders


def _with_unit(metric: str, value: float) -> str:
    shown = METRICS[metric]
    unit = f" {shown.unit}" if shown.unit in ("dB", "mm", "MiB") and shown.unit not in shown.title else ""
    return f"{text(metric, value)}{unit}"


def _listed(names: list[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _leader(numbers: Numbers, dataset: str, condition: str, metric: str) -> tuple[str, float] | None:
    """Return the best of at least two methods with whole means, and its value; None where two are equal."""
    ranked = _ordered(numbers, dataset, condition, metric)
    return ranked[0] if len(ranked) > 1 and _ahead(metric, ranked[0][1], ranked[1][1]) else None


def _ordered(numbers: Numbers, dataset: str, condition: str, metric: str) -> list[tuple[str, float]]:
    """Return the methods with whole means, best first; a rate of a CPU says as much of what else it did."""
    means = [
        (method, number.value)
        for method in numbers.methods(dataset)
        if (number := numbers.number(Key(dataset, MEAN, method, condition, metric))).value is not None
        and number.present == number.expected
        and not any(note.startswith(ON_CPU) for note in number.notes)
    ]
    return sorted(means, key=lambda one: one[1], reverse=METRICS[metric].better == "higher")


def _ahead(metric: str, value: float, other: float) -> bool:
    """Return whether `value` is better than `other` by what a table shows."""
    difference = value - other if METRICS[metric].better == "higher" else other - value
    return difference >= METRICS[metric].last_digit


def _surface_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield where the order of the methods by their images is another than that by their surfaces."""
    for dataset in numbers.datasets():
        surfaces = _ordered(numbers, dataset, "non_engine", "chamfer")
        orders = []
        for metric in ("psnr", "lpips"):
            images = _ordered(numbers, dataset, "non_engine", metric)
            both = dict(images).keys() & dict(surfaces).keys()
            first, second = ([one for one in order if one[0] in both] for order in (images, surfaces))
            if _swapped(first, second, metric, "chamfer"):
                orders.append(f"by {METRICS[metric].title} it is {_order(first, metric)}")
        if orders:
            orders.append(f"by {METRICS['chamfer'].title} {_order(surfaces, 'chamfer')}")
            where = f"On {dataset_title(dataset)} the order by images is not that by surfaces"
            yield Finding("surface_order", f"{where}: {'; '.join(orders)} mm.", "native_summary")


def _training_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield how long the trainings took, the quickest and the longest of all means."""
    cases = _mean_cases(numbers, "train_seconds", lambda _, value: f"{text('train_seconds', value)} min")
    if not cases:
        return
    first, last = min(cases), max(cases)
    if first.detail != last.detail:
        sentence = f"A training takes from {first.detail} ({first.name}) to {last.detail} ({last.name})."
        yield Finding("training", sentence, "native_summary")


def _ranking(numbers: Numbers, dataset: str, condition: str, other: str) -> list[tuple[str, float]]:
    """Return the methods that have whole means in both conditions, best in `condition` first."""
    there = dict(_ordered(numbers, dataset, other, "psnr"))
    return [one for one in _ordered(numbers, dataset, condition, "psnr") if one[0] in there]


def _swapped(
    before: list[tuple[str, float]], after: list[tuple[str, float]], metric: str = "psnr", then: str = "psnr"
) -> list[tuple[str, str]]:
    """Return the pairs of methods of which the second overtakes the first, by what a table shows.

    `before` are values of `metric`, best first, and `after` of `then`.
    """
    values = dict(after)
    return [
        (better, worse)
        for (better, first), (worse, second) in combinations(before, 2)
        if _ahead(metric, first, second) and _ahead(then, values[worse], values[better])
    ]


def _swap(numbers: Numbers, dataset: str, pair: tuple[str, str], conditions: tuple[str, str]) -> Interval:
    """Return the less certain of two methods' differences under two conditions: both must be there."""
    intervals = []
    for condition in conditions:
        scenes = []
        for scene in numbers.scenes(dataset):
            values, others = (
                numbers.views.get(Key(dataset, scene, method, condition, "psnr"), {}) for method in pair
            )
            if common := [values[view] - others[view] for view in values if view in others]:
                scenes.append(common)
        intervals.append(interval(scenes))
    return max(intervals, key=_p)


def _p(difference: Interval) -> float:
    return 2.0 if difference.p is None else difference.p


def _order(ranking: list[tuple[str, float]], metric: str = "psnr") -> str:
    return ", ".join(f"{method_title(method)} {text(metric, value)}" for method, value in ranking)


def _speed_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield how fast the tiers are beside each other, and beside the methods' own renderers."""
    pairs = dict.fromkeys((key.numerator, key.denominator) for key in numbers.ratios)
    for standard, dedicated in (
        ("standard", "dedicated"),
        ("dedicated", "non_engine"),
        *(pair for pair in pairs if "/" in pair[0]),  # two conditions of one engine, as in the paper
    ):
        cases = [
            _Case(ratio.value, key.dataset, key.method, f"{ratio.value:.1f}")
            for key, ratio in numbers.ratios.items()
            if (key.numerator, key.denominator) == (standard, dedicated) and ratio.value is not None
        ]
        if not cases:
            continue
        low, high = min(cases), max(cases)
        if len(cases) == 1:
            times, of = low.detail, f"{low.name}, by frame rate"
        else:
            times = f"{low.detail} to {high.detail}"
            of = f"least {low.name}, most {high.name}; by mean frame rates"
        engine = standard.partition("/")[2]
        if engine:
            kind = "engine_slowdown"
            sentence = f"Both drawn by {plain_text(engine)}, Standard is {times} times as fast as "
            sentence += f"{condition_title(dedicated)}{_engine_loss(numbers, standard, dedicated)}"
        elif standard == "standard":
            kind, sentence = "slowdown", f"Standard is {times} times as fast as Dedicated"
        else:
            kind = "against_native"
            sentence = f"Dedicated runs at {times} times the frame rate of Non-Engine"
        yield Finding(kind, f"{sentence} ({of}).", "slowdown")


def _engine_loss(numbers: Numbers, standard: str, dedicated: str) -> str:
    """Return what Standard costs in an engine that draws both conditions."""
    losses = [
        gaps.port.signed
        for key, gaps in numbers.gaps.items()
        if (key.scene, key.metric, key.standard, key.dedicated) == (MEAN, "psnr", standard, dedicated)
        and gaps.port.signed is not None
    ]
    shown = dict.fromkeys(digits(loss, 2) for loss in (min(losses), max(losses))) if losses else ()
    return f" and costs {' to '.join(shown)} dB of PSNR" if losses else ""


def _walk_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield what flickers most and least on walks off the path, and where most is missing."""

    def place(key: Key, _: float) -> str:
        return f"{_name(key.dataset, key.method)} under {condition_title(key.condition)}"

    if flicker := _mean_cases(numbers, "flicker", place):
        low, high, open_ = min(flicker), max(flicker), max(_mean_cases(numbers, "holes", place))
        sentence = f"Off the path {high.detail} flickers by {text('flicker', high.value)} levels of 255"
        if len(flicker) > 1:
            least = f"{low.detail} by {text('flicker', low.value)}, the least"
            sentence += f", the most of {len(flicker)} cases, and {least}"
        holes = text("holes", open_.value)
        sentence += f". Holes take at most {holes} % of what is seen of a model ({open_.detail})"
        yield Finding("walk", f"{sentence}.", f"walk-{slug(high.dataset)}")


def _structure_findings(numbers: Numbers) -> Iterator[Finding]:
    cases = _mean_cases(numbers, "nonmanifold_vertex_ratio", lambda _, share: f"{100 * share:.0f} %", SOUP)
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
    if len(cases) > 1 and low.detail == high.detail:
        sentence += f"; all {len(cases)} indexed meshes have the same share"
    elif len(cases) > 1:
        sentence += f", the most of {len(cases)} indexed meshes; the least are {low.detail}, of {low.name}"
    yield Finding("structure", f"{sentence}.", label)


def _unsupported_findings(numbers: Numbers) -> Iterator[Finding]:
    names: dict[str, dict[str, None]] = {}
    first = ""
    for key, number in numbers.values.items():
        absent = number.value is None and number.absent == NOT_SUPPORTED
        if absent and (key.scene, key.metric) == (MEAN, "psnr"):
            names.setdefault(method_title(key.method), {})[condition_title(key.condition)] = None
            first = first or key.dataset
    if names:
        each = "; ".join(f"{name} under {' and '.join(conditions)}" for name, conditions in names.items())
        yield Finding("unsupported", f"Not supported: {each}.", f"renderer_comparison-{slug(first)}")

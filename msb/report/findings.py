"""Findings: sentences about the numbers of a report, with the label of the table that holds them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, combinations
from typing import NamedTuple

from msb.bench.aggregate import METRICS
from msb.bench.gaps import PAIRS, Gap, GapName, Gaps
from msb.bench.intervals import Interval, excludes_zero
from msb.bench.records import BAKED
from msb.report.collect import REFERENCE, SOUP
from msb.report.metric_format import format_digits, format_value
from msb.report.numbers import (
    MEAN,
    QUALITY,
    GapKey,
    Key,
    Numbers,
    condition_title,
    dataset_title,
    method_title,
)
from msb.report.rankings import (
    find_swaps,
    format_ranking,
    is_ahead,
    most_certain_swap,
    rank_common_methods,
    rank_methods,
)
from msb.report.safe_names import plain_text, slug
from msb.report.table import NOT_SUPPORTED
from msb.report.tables.bakes import STEP_TITLES

# Maximum number of findings: readers skip longer lists.
_MAX_FINDINGS = 12
# Kinds of findings that are kept even if there are more than `_MAX_FINDINGS`.
_ALWAYS_KEPT = ("slowdown", "engine_slowdown", "walk", "structure", "training", "unsupported")
# Kinds of findings that come last: expected results, and results that are not about deployment.
_MINOR = ("monotone", "same_ranking", "training", "unsupported")
# A PSNR difference below this, in dB, prints as 0.00.
_MIN_DIFFERENCE = 0.005
# Further metrics that a method can lead -> condition of the comparison.
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
    """One or more sentences; `kind` is their topic, `table` the label of the table with the numbers."""

    kind: str
    sentence: str
    table: str


class _Case(NamedTuple):
    """A value of a method on a dataset, with its text for a sentence. Cases sort by value."""

    value: float
    dataset: str
    method: str
    detail: str

    @property
    def name(self) -> str:
        """The method and the dataset, such as "2DTS on DTU"."""
        return _name(self.dataset, self.method)


def _name(dataset: str, method: str) -> str:
    return f"{method_title(method)} on {dataset_title(dataset)}"


def _condition_name(condition: str) -> str:
    """Return the name of a condition within a sentence, such as "Dedicated" or "Dedicated (coarse)"."""
    title, _, variant = condition_title(condition).partition(", ")
    return f"{title} ({variant})" if variant else title


def _all_of(count: int, noun: str, plural: str = "s") -> str:
    """Return "the only case", "both cases" or "all 3 cases"; `noun` is in the singular."""
    if count == 1:
        return f"the only {noun}"
    return f"{'both' if count == 2 else f'all {count}'} {noun}{plural}"


def join_words(words: Sequence[str]) -> str:
    """Return "a", "a and b" or "a, b and c"."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _mean_cases(
    numbers: Numbers, metric: str, detail: Callable[[Key, float], str], without: str = ""
) -> list[_Case]:
    """Return all measured averages of a metric that do not have the note `without`."""
    return [
        _Case(number.value, key.dataset, key.method, detail(key, number.value))
        for key, number in numbers.values.items()
        if (key.scene, key.metric, key.source) == (MEAN, metric, "")
        and number.value is not None
        and without not in number.notes
    ]


def _significance(difference: Interval | None) -> str:
    """Return the result of the t test of a difference, or why it was not tested; "" for published values."""
    if difference is None:
        return ""
    if difference.p is None:
        return f"not tested: {difference.reason}"
    result = "p < 0.05" if excludes_zero(difference) else "not significant"
    return f"{result}, t test over {difference.over}"


def derive_findings(numbers: Numbers, first: Iterable[Finding] = ()) -> list[Finding]:
    """Return at most twelve findings, the most important first; `first` are further findings before them.

    Findings about speed and structure are kept in any case.
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
    # The sort is stable: minor findings move to the end, all others keep the order above.
    findings.sort(key=lambda finding: finding.kind in _MINOR)
    optional = [finding for finding in findings if finding.kind not in _ALWAYS_KEPT]
    dropped = optional[max(0, _MAX_FINDINGS - (len(findings) - len(optional))) :]
    return [finding for finding in findings if finding not in dropped]


def _gap_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the largest and smallest of each PSNR gap, and of the adaptation gap to each variant."""
    variants = dict.fromkeys(key.dedicated for key in numbers.gaps if key.dedicated != "dedicated")
    for dedicated in ("dedicated", *variants):
        for name, word in _GAPS.items():
            if dedicated != "dedicated" and name != "adapt":
                continue  # the other two gaps end at Standard, which variants do not change
            cases = list(_gap_cases(numbers, name, dedicated))
            if cases:
                ends = (dedicated if end == "dedicated" else end for end in PAIRS[name])
                sentence = _gap_sentence(cases, word, *map(_condition_name, ends))
                reference = "" if name == "port" else _reference_sentence(numbers, cases)
                table = f"gaps-{slug(max(cases).dataset)}"
                yield Finding(f"{name}_gap", sentence + reference, table)


def _gap_sentence(cases: list[_Case], word: str, start: str, end: str) -> str:
    """Return a sentence on the largest and the smallest of the gaps `cases` between two conditions."""
    first, last = max(cases), min(cases)
    if max(abs(case.value) for case in cases) < _MIN_DIFFERENCE:
        where = first.name if len(cases) == 1 else _all_of(len(cases), "case")
        return f"From {start} to {end}, PSNR changes by less than {_MIN_DIFFERENCE} dB ({where})."
    if len(cases) == 1:
        return f"From {start} to {end}, {first.name} {first.detail}."
    if first.value < _MIN_DIFFERENCE:
        sentence = (
            f"From {start} to {end}, PSNR falls in none of {len(cases)} cases: {first.name} {first.detail}."
        )
    else:
        extreme = f"{first.name} has the largest {word} gap of {len(cases)} cases: it {first.detail}"
        sentence = f"From {start} to {end}, {extreme}."
    if first.value - last.value >= _MIN_DIFFERENCE:
        sentence += f" At the other end, {last.name} {last.detail}."
    return sentence


def _reference_sentence(numbers: Numbers, cases: list[_Case]) -> str:
    """Return a sentence if Non-Engine was not rendered by the methods' own code, else ""."""
    notes = [
        numbers.number(Key(case.dataset, MEAN, case.method, "non_engine", "psnr")).notes for case in cases
    ]
    by_reference = [REFERENCE in of_case for of_case in notes]
    if not any(by_reference):
        return ""
    what = "Non-Engine" if all(by_reference) else "Part of Non-Engine"
    return f" {what} was rendered by our reference renderer, not by the method's own code."


def _gap_cases(numbers: Numbers, name: GapName, dedicated: str) -> Iterator[_Case]:
    """Yield the average PSNR gap of each method and dataset."""
    for key, gaps in numbers.gaps.items():
        gap = gaps[name]
        if (key.scene, key.metric, key.standard, key.dedicated) != (MEAN, "psnr", "standard", dedicated):
            continue
        if gap.signed is not None and gap.ends is not None:
            yield _Case(gap.signed, key.dataset, key.method, _describe_gap(gap, gap.signed, gap.ends))


def _describe_gap(gap: Gap, signed: float, ends: tuple[float, float]) -> str:
    """Return "loses 4.88 dB PSNR (28.16 to 23.28 dB)"; `signed` in dB is positive for a loss."""
    if abs(signed) < _MIN_DIFFERENCE:
        change = "keeps its PSNR"
    else:
        change = f"{'loses' if signed > 0 else 'gains'} {format_digits(abs(signed), 2)} dB PSNR"
    parts = [f"{ends[0]:.2f} to {ends[1]:.2f} dB"]
    parts += [f"mean over {gap.scenes} of {gap.expected} scenes"] if gap.partial else []
    parts += filter(None, [_significance(gap.interval)])
    return f"{change} ({'; '.join(parts)})"


def _split_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the parts of the largest loss from Dedicated to Standard, and the share that bakes recover."""
    cases = []
    for key, split in numbers.splits.items():
        steps = {name: gap.signed for name, gap in split.steps.items() if gap.signed is not None}
        if (key.scene, key.metric) != (MEAN, "psnr") or len(steps) < len(split.steps):
            continue
        if split.total is None or split.total.signed is None:
            continue
        # A bake may be worse than the ceiling: the best of the two counts.
        recovered = max(accumulate(loss for name, loss in steps.items() if name != "blending"))
        cases.append((split.total.signed, recovered, key))
    if not cases:
        return
    # Describe the parts of the largest loss.
    total, _, key = max(cases)
    split = numbers.splits[key]
    parts = []
    for name, gap in split.steps.items():
        # Steps without a bake between them are one part.
        names = [step for step, outer in split.within.items() if outer == name]
        title = " and ".join(STEP_TITLES[step].lower() for step in (*names, name))
        parts.append(f"{title} {format_digits(gap.signed or 0.0, 2)} dB")
    sentence = (
        f"{_name(key.dataset, key.method)} loses {format_digits(total, 2)} dB PSNR from Dedicated to "
        f"Standard: {', '.join(parts)}."
    )
    # State the recovered share of all losses, in percent.
    shares = [100 * recovered / lost for lost, recovered, _ in cases if lost >= _MIN_DIFFERENCE]
    if len(shares) > 1:
        low, high = min(shares), max(shares)
        sentence += f" Baking recovers {low:.0f} to {high:.0f} % of such losses ({len(shares)} cases)."
    elif shares:
        sentence += f" Baking recovers {shares[0]:.0f} % of this loss."
    yield Finding("loss_split", sentence, f"loss_split-{slug(key.dataset)}")


def _monotone_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the cases that are not monotone: Dedicated is not between Non-Engine and Standard."""
    comparable = [
        (key, gaps)
        for key, gaps in numbers.gaps.items()
        if (key.scene, key.standard) == (MEAN, "standard") and gaps.monotone is not None
    ]
    # (dataset, method, condition) -> the metrics that are not monotone
    broken: dict[tuple[str, str, str], list[tuple[GapKey, Gaps]]] = {}
    for key, gaps in comparable:
        if gaps.monotone is False:
            broken.setdefault((key.dataset, key.method, key.dedicated), []).append((key, gaps))
    if not comparable:
        return
    if not broken:
        sentence = (
            f"In {_all_of(len(comparable), 'comparable case')}, Dedicated lies between Non-Engine and "
            "Standard, so the adaptation and portability gaps add up to the deployment gap."
        )
        yield Finding("monotone", sentence, f"gaps-{slug(comparable[0][0].dataset)}")
    for dedicated in dict.fromkeys(place[2] for place in broken):
        of_variant = {place: cases for place, cases in broken.items() if place[2] == dedicated}
        total = len({key[:3] for key, _ in comparable if key.dedicated == dedicated})
        yield _not_monotone(of_variant, total)


def _not_monotone(broken: dict[tuple[str, str, str], list[tuple[GapKey, Gaps]]], total: int) -> Finding:
    """Return the finding on the case with the largest excess, with the names of the others.

    Parameters
    ----------
    broken : dict
        (dataset, method, condition) -> gaps of the metrics that are not monotone.
    total : int
        Number of comparable (dataset, method) pairs.
    """

    def excess(place: tuple[str, str, str]) -> float:
        return broken[place][0][1].triangle_excess or 0.0

    # The case with the largest excess is described by its first metric, the others are only named.
    first, *others = sorted(broken, key=excess, reverse=True)
    (dataset, method, dedicated), cases = first, broken[first]
    title, (key, gaps) = _condition_name(dedicated), cases[0]
    is_gain = (gaps.adapt.signed or 0) < 0
    better = f"{title} is better than Non-Engine" if is_gain else f"Standard is better than {title}"
    losses = "losses" if len(cases) == 1 else f"losses in {METRICS[key.metric].title}"
    metrics = join_words([METRICS[case.metric].title for case, _ in cases])
    decimals = METRICS[key.metric].decimals
    signs = ", ".join(
        f"{name} {format_digits(gaps[name].signed or 0, decimals, sign=True)}" for name in _GAPS
    )
    sentence = (
        f"Quality is not monotone for {_name(dataset, method)} ({metrics}): {better} ({losses}: {signs}). "
        "The adaptation and portability gaps together exceed the deployment gap by "
        f"{format_value(key.metric, gaps.triangle_excess or 0.0)}."
    )
    if others:
        names = ", ".join(_name(*place[:2]) for place in others)
        sentence += (
            f" In total {len(broken)} of {total} comparisons are not monotone; the others are {names}."
        )
    return Finding("not_monotone", sentence, f"gaps-{slug(dataset)}")


def _ranking_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield how the PSNR ranking of the methods changes between conditions, and where it does not."""
    changed: dict[str, str] = {}
    unchanged: dict[str, str] = {}
    for dataset in numbers.datasets():
        conditions = [
            name for name in numbers.conditions(dataset) if not name.startswith(("standard/", f"{BAKED}/"))
        ]
        # Significance -> pairs of conditions between which the ranking changes.
        changes: dict[str, list[str]] = {}
        moved: set[str] = set()
        compared = 0
        for first, second in combinations(conditions, 2):
            if "/" in first or first.partition("/")[0] == second.partition("/")[0]:
                continue  # a variant is only compared with Non-Engine
            before = rank_common_methods(numbers, dataset, first, second)
            after = rank_common_methods(numbers, dataset, second, first)
            if len(before) < 2:
                continue
            compared += 1
            if swapped := find_swaps(before, after):
                test = most_certain_swap(numbers, dataset, swapped, (first, second))
                pair_title = f"{_condition_name(first)} to {_condition_name(second)}"
                changes.setdefault(_significance(test), []).append(pair_title)
                moved |= {first, second}
        if changes:
            pairs = "; ".join(f"{join_words(names)} ({result})" for result, names in changes.items())
            # Conditions with equal rankings share an entry.
            orders: dict[str, list[str]] = {}
            for condition in filter(moved.__contains__, conditions):
                order = format_ranking(rank_methods(numbers, dataset, condition, "psnr"))
                orders.setdefault(order, []).append(_condition_name(condition))
            rankings = "; ".join(f"{join_words(titles)}: {order}" for order, titles in orders.items())
            where = f"On {dataset_title(dataset)}, the PSNR ranking of the methods changes from"
            changed[dataset] = f"{where} {pairs}. {rankings}."
        elif compared:
            unchanged[dataset] = dataset_title(dataset)
    sentences = [*changed.values()]
    if unchanged:
        names = join_words([*unchanged.values()])
        sentences.append(f"On {names}, the PSNR ranking of the methods is the same under every condition.")
    if sentences:
        label = f"renderer_comparison-{slug(next(iter({**changed, **unchanged})))}"
        yield Finding("ranking" if changed else "same_ranking", " ".join(sentences), label)


def _leader_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the best method in each metric for datasets without an overall best method."""
    sentences: list[str] = []
    table = ""
    for dataset in numbers.datasets():
        for condition in ("non_engine", "dedicated"):
            leaders = _find_leaders(numbers, dataset, condition)
            if len(leaders) < 2:
                continue
            parts = "; ".join(
                f"{method_title(method)} leads in {join_words(metrics)}"
                for method, metrics in leaders.items()
            )
            sentences.append(f"{dataset_title(dataset)} ({condition_title(condition)}): {parts}.")
            native = condition == "non_engine"
            table = table or ("native_summary" if native else f"renderer_comparison-{slug(dataset)}")
            break
    if sentences:
        yield Finding("leaders", f"No method leads in every metric. {' '.join(sentences)}", table)


def _find_leaders(numbers: Numbers, dataset: str, condition: str) -> dict[str, list[str]]:
    """Return method -> the metrics that it leads, with values; empty without image quality."""
    leaders: dict[str, list[str]] = {}
    has_images = any(rank_methods(numbers, dataset, condition, metric) for metric in QUALITY)
    for metric in (*QUALITY, *_COSTS) if has_images else ():
        of = _COSTS.get(metric, condition)
        ranked = rank_methods(numbers, dataset, of, metric)
        if len(ranked) > 1 and is_ahead(metric, ranked[0][1], ranked[1][1]):
            method, value = ranked[0]
            tier = f"{condition_title(of)} " if of != condition and metric in ("fps", "memory") else ""
            leaders.setdefault(method, []).append(f"{tier}{_format_with_unit(metric, value)}")
    return leaders


def _format_with_unit(metric: str, value: float) -> str:
    """Return a metric with a value and its unit, such as "Train time (15.4 min)"."""
    definition = METRICS[metric]
    unit = f" {definition.unit}" if definition.unit in ("dB", "mm", "MiB", "min") else ""
    return f"{definition.title.partition(' (')[0]} ({format_value(metric, value)}{unit})"


def _surface_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the datasets with different rankings by image quality and by Chamfer distance."""
    for dataset in numbers.datasets():
        surfaces = rank_methods(numbers, dataset, "non_engine", "chamfer")
        orders = []
        for metric in ("psnr", "lpips"):
            images = rank_methods(numbers, dataset, "non_engine", metric)
            both = dict(images).keys() & dict(surfaces).keys()
            first, second = ([item for item in order if item[0] in both] for order in (images, surfaces))
            if find_swaps(first, second, metric, "chamfer"):
                orders.append(f"{METRICS[metric].title}: {format_ranking(first, metric)}")
        if orders:
            orders.append(f"Chamfer distance in mm: {format_ranking(surfaces, 'chamfer')}")
            where = f"On {dataset_title(dataset)}, the methods rank differently by images and by surfaces"
            yield Finding("surface_order", f"{where}. {'; '.join(orders)}.", "native_summary")


def _training_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the shortest and the longest average training time."""
    cases = _mean_cases(
        numbers, "train_seconds", lambda _, value: f"{format_value('train_seconds', value)} min"
    )
    if not cases:
        return
    first, last = min(cases), max(cases)
    if first.detail != last.detail:
        sentence = f"Training takes {first.detail} ({first.name}) to {last.detail} ({last.name})."
        yield Finding("training", sentence, "native_summary")


def _speed_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield ratios of frame rates: Standard to Dedicated, Dedicated to Non-Engine, and within an engine."""
    pairs = dict.fromkeys((key.numerator, key.denominator) for key in numbers.ratios)
    for above, below in (
        ("standard", "dedicated"),
        ("dedicated", "non_engine"),
        *(pair for pair in pairs if "/" in pair[0]),
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
            times, where = low.detail, f" ({low.name})"
        elif low.detail == high.detail:
            times, where = low.detail, f" in {_all_of(len(cases), 'case')} (ratios of average frame rates)"
        else:
            times = f"{low.detail} ({low.name}) to {high.detail} ({high.name})"
            where = " (ratios of average frame rates)"
        engine = above.partition("/")[2]
        if engine:
            kind = "engine_slowdown"
            rates = (
                f"Within {plain_text(engine)}, Standard renders {times} times as many frames per second as"
            )
            sentence = f"{rates} {_condition_name(below)}{where}.{_engine_loss(numbers, above, below)}"
        elif above == "standard":
            kind = "slowdown"
            sentence = f"Standard renders {times} times as many frames per second as Dedicated{where}."
        else:
            kind = "against_native"
            sentence = f"Dedicated reaches {times} times the frame rate of Non-Engine{where}."
        yield Finding(kind, sentence, "slowdown")


def _engine_loss(numbers: Numbers, standard: str, dedicated: str) -> str:
    """Return a sentence on the PSNR loss of Standard in an engine that draws both tiers."""
    losses = [
        gaps.port.signed
        for key, gaps in numbers.gaps.items()
        if (key.scene, key.metric, key.standard, key.dedicated) == (MEAN, "psnr", standard, dedicated)
        and gaps.port.signed is not None
    ]
    if not losses:
        return ""
    ends = dict.fromkeys(format_digits(loss, 2) for loss in (min(losses), max(losses)))
    return f" Standard loses {' to '.join(ends)} dB PSNR there."


def _walk_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the most and the least flicker on walks, and the largest share of holes."""

    def place(key: Key, _: float) -> str:
        return f"{_name(key.dataset, key.method)} ({condition_title(key.condition)})"

    if flicker := _mean_cases(numbers, "flicker", place):
        low, high, most_holes = min(flicker), max(flicker), max(_mean_cases(numbers, "holes", place))
        level = format_value("flicker", high.value)
        if len(flicker) == 1:
            sentence = f"Away from the captured views, {high.detail} flickers by {level} of 255 levels."
        else:
            least = format_value("flicker", low.value)
            sentence = (
                f"Away from the captured views, flicker is worst for {high.detail}: {level} of 255 levels. "
                f"It is least for {low.detail}: {least} ({len(flicker)} cases)."
            )
        holes = format_value("holes", most_holes.value)
        sentence += f" Holes are largest for {most_holes.detail}: {holes} % of the visible surface."
        yield Finding("walk", sentence, f"walk-{slug(high.dataset)}")


def _structure_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the largest and smallest average share of non-manifold vertices of indexed meshes."""

    def percent(_: Key, share: float) -> str:
        return f"{100 * share:.0f} %" if share == 0 or share >= 0.01 else "less than 1 %"

    cases = _mean_cases(numbers, "nonmanifold_vertex_ratio", percent, SOUP)
    if not cases:
        return
    low, high = min(cases), max(cases)
    label = f"mesh_connectivity-{slug(high.dataset)}"
    if high.value == 0:
        meshes = {1: "The indexed mesh has no", 2: "Neither indexed mesh has"}
        start = meshes.get(len(cases), f"None of the {len(cases)} indexed meshes has")
        yield Finding("structure", f"{start} non-manifold vertices.", label)
        return
    components = numbers.value(Key(high.dataset, MEAN, high.method, "exported_mesh", "components"))
    sentence = f"{high.name} has {high.detail} non-manifold vertices"
    if components is not None:
        count = format_value("components", components)
        sentence += f" and {count} component{'' if count == '1' else 's'}"
    if len(cases) > 1 and low.detail == high.detail:
        all_meshes = _all_of(len(cases), "indexed mesh", "es")
        sentence += f"; the share of non-manifold vertices is the same for {all_meshes}"
    elif len(cases) > 1:
        sentence += (
            f". This is the largest share among {len(cases)} indexed meshes; the smallest is {low.detail} "
            f"({low.name})"
        )
    yield Finding("structure", f"{sentence}.", label)


def _unsupported_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the conditions that methods do not support."""
    # Method -> conditions; the finding links to the table of the first dataset.
    names: dict[str, dict[str, None]] = {}
    first = ""
    for key, number in numbers.values.items():
        absent = number.value is None and number.absent == NOT_SUPPORTED
        if absent and (key.scene, key.metric) == (MEAN, "psnr"):
            names.setdefault(method_title(key.method), {})[_condition_name(key.condition)] = None
            first = first or key.dataset
    if names:
        parts = [f"{name} under {join_words([*conditions])}" for name, conditions in names.items()]
        yield Finding(
            "unsupported", f"Not supported: {'; '.join(parts)}.", f"renderer_comparison-{slug(first)}"
        )

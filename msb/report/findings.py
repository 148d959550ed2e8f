"""Findings: sentences about the numbers of a report. Each finding names the table with its numbers."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, combinations
from typing import NamedTuple

from msb.bench.aggregate import METRICS
from msb.bench.gaps import PAIRS, Gap, GapName, Gaps
from msb.bench.intervals import Interval, excludes_zero
from msb.bench.records import BAKED
from msb.report.collect import REFERENCE, SOUP
from msb.report.metric_format import format_change, format_digits, format_value
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
from msb.report.rankings import (
    find_most_certain_swap,
    find_swaps,
    format_ranking,
    is_ahead,
    rank_common_methods,
    rank_methods,
)
from msb.report.safe_names import plain_text, slug
from msb.report.table import NOT_SUPPORTED
from msb.report.tables.bakes import STEP_TITLES

# Maximum number of findings, because readers skip longer lists.
_MAX_FINDINGS = 12
# Kinds of findings that are kept even if there are more than `_MAX_FINDINGS`.
_ALWAYS_KEPT = ("slowdown", "engine_slowdown", "walk", "structure", "training", "unsupported")
# Kinds of findings that are listed last. The findings of these kinds are expected, or do not concern
# deployment.
_MINOR = ("monotone", "same_ranking", "training", "unsupported")
# A PSNR difference below this value, in dB, is printed as 0.00.
_MIN_DIFFERENCE = 0.005
# Metrics of cost. For each metric, the condition under which methods are compared.
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
    """One or more sentences on the topic `kind`. `table` is the label of the table with the numbers."""

    kind: str
    sentence: str
    table: str


class _Case(NamedTuple):
    """A value of a method on a dataset, and a text that describes it. Cases are sorted by this value."""

    value: float
    dataset: str
    method: str
    detail: str

    @property
    def name(self) -> str:
        """The method and the dataset as text, such as "2DTS on DTU"."""
        return _format_pair(self.dataset, self.method)


def _format_pair(dataset: str, method: str) -> str:
    return f"{method_title(method)} on {dataset_title(dataset)}"


def _format_condition(condition: str) -> str:
    """Return the name of a condition for a sentence, such as "Dedicated" or "Dedicated (coarse)"."""
    title, _, variant = condition_title(condition).partition(", ")
    return f"{title} ({variant})" if variant else title


def _format_all(count: int, noun: str = "combination", of: str = "method and dataset") -> str:
    """Return "the only", "both" or "all 3", followed by a noun phrase."""
    if count == 1:
        return f"the only {noun} of {of}"
    return f"{'both' if count == 2 else f'all {count}'} {noun}s of {of}"


def join_words(words: Sequence[str]) -> str:
    """Return "a", "a and b" or "a, b and c"."""
    return " and ".join(filter(None, (", ".join(words[:-1]), words[-1])))


def _collect_means(
    numbers: Numbers, metric: str, detail: Callable[[Key, float], str], without: str = ""
) -> list[_Case]:
    """Return all measured averages of a metric. Averages that have the note `without` are omitted.

    The function `detail` returns the text for a value.
    """
    return [
        _Case(number.value, key.dataset, key.method, detail(key, number.value))
        for key, number in numbers.values.items()
        if (key.scene, key.metric, key.source) == (MEAN, metric, "")
        and number.value is not None
        and without not in number.notes
    ]


def _describe_significance(difference: Interval | None) -> str:
    """Return the result of the t test on a difference as text. Without a difference, return ""."""
    if difference is None:
        return ""
    if difference.p is None:
        return f"not tested: {difference.reason}"
    result = "p < 0.05" if excludes_zero(difference) else "not significant"
    return f"{result}, t test over {difference.over}"


def derive_findings(numbers: Numbers, first: Iterable[Finding] = ()) -> list[Finding]:
    """Return at most twelve findings, the most important finding first.

    `first` contains further findings that are placed before all others. Findings of the kinds in
    `_ALWAYS_KEPT` are never dropped.
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
    # Move minor findings to the end. The sort is stable, so other findings keep their order.
    findings.sort(key=lambda finding: finding.kind in _MINOR)
    optional = [finding for finding in findings if finding.kind not in _ALWAYS_KEPT]
    dropped = optional[max(0, _MAX_FINDINGS - (len(findings) - len(optional))) :]
    return [finding for finding in findings if finding not in dropped]


def _gap_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the largest and the smallest value of each PSNR gap.

    A variant has only an adaptation gap.
    """
    variants = dict.fromkeys(key.dedicated for key in numbers.gaps if key.dedicated != "dedicated")
    for dedicated in ("dedicated", *variants):
        for name, word in _GAPS.items():
            if dedicated != "dedicated" and name != "adapt":
                continue  # variants do not change the other two gaps
            cases = list(_gap_cases(numbers, name, dedicated))
            if cases:
                ends = (dedicated if end == "dedicated" else end for end in PAIRS[name])
                sentence = _describe_extremes(cases, word, *map(_format_condition, ends))
                reference = "" if name == "port" else _describe_reference(numbers, cases)
                table = f"gaps-{slug(max(cases).dataset)}"
                yield Finding(f"{name}_gap", sentence + reference, table)


def _describe_extremes(cases: list[_Case], word: str, start: str, end: str) -> str:
    """Return sentences on the largest and the smallest loss in `cases`."""
    first, last = max(cases), min(cases)
    count = f"{len(cases)} combinations of method and dataset"
    if max(abs(case.value) for case in cases) < _MIN_DIFFERENCE:
        where = first.name if len(cases) == 1 else _format_all(len(cases))
        return f"From {start} to {end}, PSNR changes by less than {_MIN_DIFFERENCE} dB ({where})."
    if len(cases) == 1:
        return f"From {start} to {end}, {first.name} {first.detail}."
    if first.value < _MIN_DIFFERENCE:
        sentence = f"From {start} to {end}, PSNR falls for none of {count}: {first.name} {first.detail}."
    else:
        extreme = f"{first.name} has the largest {word} gap"
        sentence = f"Among {count}, {extreme}: from {start} to {end}, it {first.detail}."
    if first.value - last.value >= _MIN_DIFFERENCE:
        sentence += f" The opposite extreme is {last.name}, which {last.detail}."
    return sentence


def _describe_reference(numbers: Numbers, cases: list[_Case]) -> str:
    """Return a sentence if our reference renderer made Non-Engine images, otherwise ""."""
    notes = [
        numbers.number(Key(case.dataset, MEAN, case.method, "non_engine", "psnr")).notes for case in cases
    ]
    by_reference = [REFERENCE in of_case for of_case in notes]
    if not any(by_reference):
        return ""
    which = "The" if all(by_reference) else "Some"
    return (
        f" {which} Non-Engine images were rendered by our reference renderer, not by the method's own code."
    )


def _gap_cases(numbers: Numbers, name: GapName, dedicated: str) -> Iterator[_Case]:
    """Yield the average PSNR gap of each method and dataset."""
    for key, gaps in numbers.gaps.items():
        gap = gaps[name]
        if (key.scene, key.metric, key.standard, key.dedicated) != (MEAN, "psnr", "standard", dedicated):
            continue
        if gap.signed is not None and gap.ends is not None:
            yield _Case(gap.signed, key.dataset, key.method, _describe_gap(gap, gap.signed, gap.ends))


def _describe_gap(gap: Gap, signed: float, ends: tuple[float, float]) -> str:
    """Return text such as "loses 4.88 dB PSNR (28.16 to 23.28 dB)" for the loss `signed` in dB."""
    amount, first, last = format_change(signed, ends, METRICS["psnr"].decimals)
    if abs(signed) < _MIN_DIFFERENCE:
        change = "keeps its PSNR"
    else:
        change = f"{'loses' if signed > 0 else 'gains'} {amount} dB PSNR"
    parts = [f"{first} to {last} dB"]
    parts += [f"mean over {gap.scenes} of {gap.expected} scenes"] if gap.partial else []
    parts += filter(None, [_describe_significance(gap.interval)])
    return f"{change} ({'; '.join(parts)})"


def _split_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the parts of the largest loss from Dedicated to Standard, and the loss that bakes recover."""
    cases = []
    for key, split in numbers.splits.items():
        steps = {name: gap.signed for name, gap in split.steps.items() if gap.signed is not None}
        if (key.scene, key.metric) != (MEAN, "psnr") or len(steps) < len(split.steps):
            continue
        if split.total is None or split.total.signed is None:
            continue
        # The fitted bake may be worse than the ceiling bake. Use the better bake to compute the recovered
        # loss in dB.
        recovered = max(accumulate(loss for name, loss in steps.items() if name != "blending"))
        cases.append((split.total.signed, recovered, key))
    if not cases:
        return
    # Describe the parts of the largest loss.
    total, _, key = max(cases)
    split = numbers.splits[key]
    parts = []
    for name, gap in split.steps.items():
        # If no bake separates two neighbouring parts of the loss, they form one part.
        names = [step for step, outer in split.within.items() if outer == name]
        title = " and ".join(STEP_TITLES[step].lower() for step in (*names, name))
        parts.append(f"{title} {format_digits(gap.signed or 0.0, 2)} dB")
    sentence = (
        f"{_format_pair(key.dataset, key.method)} loses {format_digits(total, 2)} dB PSNR from Dedicated to "
        f"Standard. The parts of this loss are {join_words(parts)}."
    )
    # State the fraction of all losses that bakes recover, in percent.
    shares = [100 * recovered / lost for lost, recovered, _ in cases if lost >= _MIN_DIFFERENCE]
    if len(shares) > 1:
        low, high = min(shares), max(shares)
        sentence += (
            f" For {len(shares)} combinations of method and dataset with such a loss, baking recovers "
            f"{low:.0f} to {high:.0f} % of the loss."
        )
    elif shares:
        sentence += f" Baking recovers {shares[0]:.0f} % of this loss."
    yield Finding("loss_split", sentence, f"loss_split-{slug(key.dataset)}")


def _monotone_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the cases in which the value of Dedicated is not between Non-Engine and Standard."""
    comparable = [
        (key, gaps)
        for key, gaps in numbers.gaps.items()
        if (key.scene, key.standard) == (MEAN, "standard") and gaps.monotone is not None
    ]
    # for each (dataset, method, condition), the metrics that are not monotone
    broken: dict[tuple[str, str, str], list[tuple[GapKey, Gaps]]] = {}
    for key, gaps in comparable:
        if gaps.monotone is False:
            broken.setdefault((key.dataset, key.method, key.dedicated), []).append((key, gaps))
    if not comparable:
        return
    if not broken:
        comparisons = _format_all(len(comparable), "comparison", "a method, a dataset and a metric")
        sentence = (
            f"In {comparisons}, the quality of Dedicated lies between Non-Engine and Standard, so the "
            "adaptation and portability gaps add up to the deployment gap."
        )
        yield Finding("monotone", sentence, f"gaps-{slug(comparable[0][0].dataset)}")
    for dedicated in dict.fromkeys(place[2] for place in broken):
        of_variant = {place: cases for place, cases in broken.items() if place[2] == dedicated}
        total = len({key[:3] for key, _ in comparable if key.dedicated == dedicated})
        yield _describe_not_monotone(of_variant, total)


def _describe_not_monotone(
    broken: dict[tuple[str, str, str], list[tuple[GapKey, Gaps]]], total: int
) -> Finding:
    """Return a finding that describes the case with the largest excess, and names all other cases.

    Parameters
    ----------
    broken : dict
        For each (dataset, method, condition), the gaps of the metrics that are not monotone. The condition is
        Dedicated or one of its variants.
    total : int
        Number of comparable (dataset, method) pairs.
    """

    def excess(place: tuple[str, str, str]) -> float:
        return broken[place][0][1].triangle_excess or 0.0

    # Describe the case with the largest excess by its first metric. All other cases are only named.
    first, *others = sorted(broken, key=excess, reverse=True)
    (dataset, method, dedicated), cases = first, broken[first]
    title, (key, gaps) = _format_condition(dedicated), cases[0]
    is_gain = (gaps.adapt.signed or 0) < 0
    better = f"{title} is better than Non-Engine" if is_gain else f"Standard is better than {title}"
    metrics = join_words([METRICS[case.metric].title for case, _ in cases])
    definition = METRICS[key.metric]
    unit = " dB" if definition.unit == "dB" else ""
    losses = ", ".join(
        f"{word} {format_digits(gaps[name].signed or 0, definition.decimals, sign=True)}{unit}"
        for name, word in _GAPS.items()
    )
    sentence = (
        f"Quality is not monotone for {_format_pair(dataset, method)} ({metrics}): {better}. The losses in "
        f"{definition.title} are {losses}. The adaptation and portability gaps together exceed the "
        f"deployment gap by {format_value(key.metric, gaps.triangle_excess or 0.0)}{unit}."
    )
    if others:
        names = ", ".join(_format_pair(*place[:2]) for place in others)
        sentence += (
            f" In total, quality is not monotone for {len(broken)} of {total} combinations of method and "
            f"dataset; the others are {names}."
        )
    return Finding("not_monotone", sentence, f"gaps-{slug(dataset)}")


def _ranking_findings(numbers: Numbers) -> Iterator[Finding]:
    """For each dataset, yield a finding on changes of the PSNR ranking between conditions."""
    changed: dict[str, str] = {}
    unchanged: dict[str, str] = {}
    for dataset in numbers.datasets():
        conditions = [
            name for name in numbers.conditions(dataset) if not name.startswith(("standard/", f"{BAKED}/"))
        ]
        # For each significance text, collect the pairs of conditions between which the ranking changes.
        changes: dict[str, list[str]] = {}
        moved: set[str] = set()  # conditions between which the ranking changes
        compared = 0
        for first, second in combinations(conditions, 2):
            if "/" in first or first.partition("/")[0] == second.partition("/")[0]:
                continue  # compare a variant only with Non-Engine
            before = rank_common_methods(numbers, dataset, first, second)
            after = rank_common_methods(numbers, dataset, second, first)
            if len(before) < 2:
                continue
            compared += 1
            if swapped := find_swaps(before, after):
                test = find_most_certain_swap(numbers, dataset, swapped, (first, second))
                pair_title = f"from {_format_condition(first)} to {_format_condition(second)}"
                changes.setdefault(_describe_significance(test), []).append(pair_title)
                moved |= {first, second}
        if changes:
            pairs = "; ".join(f"{join_words(names)} ({result})" for result, names in changes.items())
            # collect conditions with equal rankings
            orders: dict[str, list[str]] = {}
            for condition in filter(moved.__contains__, conditions):
                order = format_ranking(rank_methods(numbers, dataset, condition, "psnr"))
                orders.setdefault(order, []).append(_format_condition(condition))
            rankings = "; ".join(f"{order} under {join_words(titles)}" for order, titles in orders.items())
            where = f"On {dataset_title(dataset)}, the PSNR ranking of the methods changes"
            changed[dataset] = f"{where} {pairs}. The average PSNR in dB is {rankings}."
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
    """Yield the best method in each metric.

    If one method is best in every metric of a dataset, the dataset is skipped.
    """
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
            sentences.append(f"On {dataset_title(dataset)} ({condition_title(condition)}), {parts}.")
            native = condition == "non_engine"
            table = table or ("native_summary" if native else f"renderer_comparison-{slug(dataset)}")
            break
    if sentences:
        yield Finding("leaders", f"No method leads in every metric. {' '.join(sentences)}", table)


def _find_leaders(numbers: Numbers, dataset: str, condition: str) -> dict[str, list[str]]:
    """Return the metrics in which each method is best, with the values.

    The result is empty if no image quality was measured.
    """
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
    """Yield the datasets with different rankings of the methods by image quality and by Chamfer distance."""
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
            difference = "image quality and surface accuracy rank the methods differently"
            sentence = f"On {dataset_title(dataset)}, {difference}. {'; '.join(orders)}."
            yield Finding("surface_order", sentence, "native_summary")


def _training_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the shortest and the longest average training time."""
    cases = _collect_means(
        numbers, "train_seconds", lambda _, value: f"{format_value('train_seconds', value)} min"
    )
    if not cases:
        return
    first, last = min(cases), max(cases)
    if first.detail != last.detail:
        sentence = f"Training takes {first.detail} ({first.name}) to {last.detail} ({last.name}) on average."
        yield Finding("training", sentence, "native_summary")


def _speed_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield ratios of frame rates between conditions, and between the two tiers of one engine."""
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
            times, where = f"{low.detail} times", f" ({low.name})"
        elif low.detail == high.detail:
            times, where = f"{low.detail} times", f" for {_format_all(len(cases))}"
        else:
            times, where = f"{low.detail} times ({low.name}) to {high.detail} times ({high.name})", ""
        engine = above.partition("/")[2]
        if engine:
            kind = "engine_slowdown"
            rates = f"Within {plain_text(engine)}, the average frame rate of Standard is {times}"
            loss = _describe_engine_loss(numbers, above, below)
            sentence = f"{rates} that of {_format_condition(below)}{where}.{loss}"
        elif above == "standard":
            kind = "slowdown"
            sentence = f"The average frame rate of Standard is {times} that of Dedicated{where}."
        else:
            kind = "against_native"
            sentence = f"The average frame rate of Dedicated is {times} that of Non-Engine{where}."
        yield Finding(kind, sentence + _describe_cpu(numbers, cases, above), "slowdown")


def _describe_cpu(numbers: Numbers, cases: Sequence[_Case], condition: str) -> str:
    """Return a sentence if frame rates of a condition were measured on a CPU, otherwise ""."""
    rates = [numbers.number(Key(case.dataset, MEAN, case.method, condition, "fps")) for case in cases]
    on_cpu = [any(note.startswith(ON_CPU) for note in rate.notes) for rate in rates]
    if not any(on_cpu):
        return ""
    return f" {'The' if all(on_cpu) else 'Some'} frame rates were measured on a CPU."


def _describe_engine_loss(numbers: Numbers, standard: str, dedicated: str) -> str:
    """Return a sentence on the PSNR loss from Dedicated to Standard. One engine draws both tiers."""
    losses = [
        gaps.port.signed
        for key, gaps in numbers.gaps.items()
        if (key.scene, key.metric, key.standard, key.dedicated) == (MEAN, "psnr", standard, dedicated)
        and gaps.port.signed is not None
    ]
    if not losses:
        return ""
    ends = dict.fromkeys(format_digits(loss, 2) for loss in (min(losses), max(losses)))
    pair = f"From {_format_condition(dedicated)} to Standard in this engine"
    return f" {pair}, the PSNR loss is {' to '.join(ends)} dB."


def _walk_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the extremes of flicker on camera paths (walks), and the largest fraction of holes."""

    def describe_place(key: Key, _: float) -> str:
        return f"{_format_pair(key.dataset, key.method)} ({condition_title(key.condition)})"

    if flicker := _collect_means(numbers, "flicker", describe_place):
        low, high = min(flicker), max(flicker)
        most_holes = max(_collect_means(numbers, "holes", describe_place))
        level = format_value("flicker", high.value)
        if len(flicker) == 1:
            sentence = f"Away from the captured views, the flicker of {high.detail} is {level} of 255 levels."
        else:
            least = format_value("flicker", low.value)
            sentence = (
                f"Away from the captured views, flicker is strongest for {high.detail}, with {level} of 255 "
                f"levels, and weakest for {low.detail}, with {least} levels."
            )
        holes = format_value("holes", most_holes.value)
        sentence += (
            f" Holes are most frequent for {most_holes.detail}: {holes} % of the pixels that show the model "
            "or a hole."
        )
        yield Finding("walk", sentence, f"walk-{slug(high.dataset)}")


def _structure_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the largest and smallest average share of non-manifold vertices of indexed meshes."""

    def percent(_: Key, share: float) -> str:
        return f"{100 * share:.0f} %" if share == 0 or share >= 0.01 else "less than 1 %"

    cases = _collect_means(numbers, "nonmanifold_vertex_ratio", percent, SOUP)
    if not cases:
        return
    low, high = min(cases), max(cases)
    label = f"mesh_connectivity-{slug(high.dataset)}"
    if high.value == 0:
        names = f"{high.name} have" if len(cases) == 1 else f"{_format_all(len(cases))} have"
        yield Finding("structure", f"The indexed meshes of {names} no non-manifold vertices.", label)
        return
    components = numbers.value(Key(high.dataset, MEAN, high.method, "exported_mesh", "components"))
    sentence = f"{high.name} has on average {high.detail} non-manifold vertices"
    if components is not None:
        count = format_value("components", components)
        sentence += f" and {count} component{'' if count == '1' else 's'}"
    sentence += "."
    if len(cases) > 1 and low.detail == high.detail:
        same = _format_all(len(cases))
        sentence += f" The share of non-manifold vertices is the same for {same} with indexed meshes."
    elif len(cases) > 1:
        sentence += (
            f" This is the largest share among {len(cases)} combinations of method and dataset with indexed "
            f"meshes; the smallest is {low.detail} ({low.name})."
        )
    yield Finding("structure", sentence, label)


def _unsupported_findings(numbers: Numbers) -> Iterator[Finding]:
    """Yield the conditions that methods do not support."""
    # Collect the conditions of each method. The finding links to the table of the first dataset.
    names: dict[str, dict[str, None]] = {}
    first = ""
    for key, number in numbers.values.items():
        absent = number.value is None and number.absent == NOT_SUPPORTED
        if absent and (key.scene, key.metric) == (MEAN, "psnr"):
            names.setdefault(method_title(key.method), {})[_format_condition(key.condition)] = None
            first = first or key.dataset
    if names:
        parts = [f"{name} under {join_words([*conditions])}" for name, conditions in names.items()]
        sentence = f"Unsupported combinations of method and condition: {'; '.join(parts)}."
        yield Finding("unsupported", sentence, f"renderer_comparison-{slug(first)}")
